"""Cases 35 to 37: projected liquids in tanks, and bodies in a liquid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from phy124.boundaries import Boundary, Container, HalfSpace, Path
from phy124.forces import Gravity, ZoneForce
from phy124.liquid.immersed import ImmersedSolver
from phy124.liquid.mixed import MixedSolver
from phy124.liquid.solver import LiquidSolver
from phy124.materials import Fluid, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import MeanWork
from phy124.mpm import Model, State
from phy124.particles.lattice import lattice_of
from phy124.particles.solid import Solid
from phy124.schema.region import Region
from phy124.studies.validation.bodies import lattice
from phy124.studies.validation.stress.bodies import Array, host
from phy124.studies.validation.stress.case import Check, Setting, at_most, higher

if TYPE_CHECKING:
    from phy124.liquid import AnySolver

DX = 0.125
"""Grid spacing [m]."""
G = 9.81
"""Acceleration of gravity [m/s^2]."""
SIDE = 0.5
"""Side of the cubes that fall into a pool [m]."""
BODIES = (
    ("sponge", 100.0, 3e3),
    ("a hundredth of the density", 10.0, 1e3),
    ("stone", 2500.0, 1e5),
)
"""Name, density [kg/m^3] and Young's modulus [Pa] of each cube."""
TANK = Container(inside=Region(lower=(0, 0, 0), upper=(1, 1, 1e9)), contact="slip")
WATER = Fluid(density=1000.0)


def tanks(setting: Setting) -> list[Check]:
    """Check that a liquid stays in its tank and gains no energy."""
    still, pool = (), _block((0, 0, 0), (1, 1, 0.375))
    upwards = Region(lower=(0.25, 0.25, 0.0), upper=(0.75, 0.75, 0.5))
    blow = ZoneForce(place=upwards, a=(0.0, 0.0, 20.0))
    waves = HalfSpace(point=(0, 0, 0), normal=(1, 0, 0), contact="slip", motion=_swing())
    lower = Path(times=(0.0, 1.0), points=((0.0, 0.0, 0.0), (0.0, 0.0, -0.5)))
    lid = HalfSpace(point=(0, 0, 1), normal=(0, 0, -1), contact="slip", motion=lower)
    full = _block((0, 0, 0), (1, 1, 0.875))
    film, drop = _block((0, 0, 0), (1, 1, DX / 2)), np.array([[0.5, 0.5, 0.4]])
    checks = []
    for name, x, forces, walls, time, speed, energy, momentum in (
        ("fountain", pool, [blow], still, 20.0 if setting.long else 2.0, 12.0, 1e-3, 0.05),
        ("wave machine", pool, [], [waves], 60.0 if setting.long else 2.0, 6.0, 1e-3, 0.01),
        ("no room", full, [], [lid], 2.0, 4.0, 1e-3, 0.01),
        ("film of half a cell", film, [], still, 1.0, 0.05, 1e-3, 0.05),
        ("one particle", drop, [], still, 1.0, 0.01, 0.25, 1e-3),
    ):
        balance = Balance()
        solver = _liquid(setting, x, forces, [TANK, *walls], balance)
        fastest = _advance(solver, time, balance.compare)
        x = host(solver.state.x)
        out = -min(float(np.quantile(x, 0.001)), float(np.quantile(1 - x[:, :2], 0.001)))
        checks += [
            at_most(f"{name}: beyond the tank [cells]", out / DX, 0.25),
            at_most(f"{name}: largest speed, at last [m/s]", fastest, speed),
            at_most(f"{name}: energy without work", balance.energy, energy),
            at_most(f"{name}: momentum without impulse", balance.momentum, momentum),
        ]
    return checks


def bodies(setting: Setting) -> list[Check]:
    """Check that light, soft and heavy bodies gain no energy and do not sink too deep."""
    checks = []
    for name, density, E in BODIES:
        x, body = _block((0, 0, 0), (1, 1, 0.375)), _block((0.25, 0.25, 0.5), (0.75, 0.75, 1))
        solver = _join(setting, x, body, NeoHookean(density=density, E=E, nu=0.3, damping=5.0))
        energy = _energy(solver)
        _advance(solver, 6.0 if setting.long else 1.5)
        z = host(solver.state.x)[len(x) :, 2]
        bottom = 0.375 - density / 1000 * 0.5 * (1 - 0.25)
        checks += [
            at_most(f"{name}: energy over that at the start", _energy(solver) / energy, 1.0),
            at_most(f"{name}: sunk too deep [cells]", (max(bottom, 0) - z.min()) / DX, 1.5),
        ]
    return checks


def bodies_on_lattices(setting: Setting) -> list[Check]:
    """Check bodies on lattices like `bodies`, and the buoyancy of a stone on the floor.

    The bodies are damped, because phy124 simulates an undamped body with a hundredth of the
    liquid's density by MPM (`phy124.scene.lattices`).
    """
    checks = []
    for name, density, E in BODIES:
        solver = _immerse(setting, NeoHookean(density=density, E=E, nu=0.3, damping=5.0))
        start, energies = _energy(solver), [0.0]
        measure = partial(lambda solver, sums: sums.append(_energy(solver)), solver, energies)
        _advance(solver, 6.0 if setting.long else 1.5, measure)
        mine = solver.model.particles(1)
        x, bottom = host(solver.state.x)[mine], 0.375 - density / 1000 * SIDE * (1 - SIDE**2)
        checks += [
            at_most(
                f"{name}: largest energy over that at the start", np.max(energies) / start, 1.0
            ),
            at_most(f"{name}: sunk too deep [cells]", (max(bottom, 0) - x[:, 2].min()) / DX, 0.5),
        ]
        if density > WATER.density:
            solver.pairs.begin()
            _advance(solver, 1.0)
            lift = solver.pairs.wrenches(1.0)[0, 1].force[2] / (WATER.density * G * SIDE**3)
            checks.append(at_most(f"{name}: error of the mean buoyancy", abs(lift - 1), 0.1))
    return checks


def _swing() -> Path:
    times = np.linspace(0, 60, 601)
    return Path(
        times=tuple(times.tolist()),
        points=tuple((0.05 * (1 - np.cos(5 * t)), 0.0, 0.0) for t in times.tolist()),
    )


def _block(low: Sequence[float], high: Sequence[float]) -> Array:
    """Return positions [P,3], m, of particles in a box, with 8 in each cell."""
    counts = [round(2 * (b - a) / DX) for a, b in zip(low, high, strict=True)]
    return lattice(counts, DX / 2, low)


def _model(setting: Setting, x: Array, materials: list[Any], **options: Any) -> Model:
    volume = np.full(len(x), DX**3 / 8)
    return Model.of(x, volume, materials, dx=DX, **options, **setting.options)


class Balance(MeanWork):
    """Compares a liquid's energy and momentum with the work and impulse of forces and walls."""

    energy = momentum = 0.0
    """Largest unexplained energy, relative to the work that lifts the liquid by half a metre. The
    largest unexplained momentum is relative to all impulses.
    """

    def follow(self, solver: LiquidSolver) -> None:
        """Start the comparison with the current state."""
        self.bind(solver)
        self.open(solver.clock)
        self._solver, self._first = solver, diagnose(solver)

    def compare(self) -> None:
        """Compare the current state with the first state."""
        now, first = diagnose(self._solver), self._first
        exchange = self.total(self._solver.clock, now.middle - first.middle)
        lift = 0.5 * G * self._solver.model.total_mass
        gain = now.energy - first.energy - exchange.work
        missing = float(np.linalg.norm(now.momentum - exchange.impulse))
        self.energy = higher(self.energy, gain / lift)
        self.momentum = higher(self.momentum, missing / exchange.moved)


def _liquid(
    setting: Setting, x: Array, forces: list[Any], walls: list[Boundary], balance: Balance
) -> LiquidSolver:
    model = _model(setting, x, [WATER])
    named = [(f"wall_{index}", wall) for index, wall in enumerate(walls)]
    options = {"forces": [Gravity(), *forces], "boundaries": named, "accumulators": [balance]}
    solver = LiquidSolver(model, State.of(model), **options, threads=1)
    balance.follow(solver)
    return solver


def _join(setting: Setting, water: Array, body: Array, material: NeoHookean) -> MixedSolver:
    number = np.repeat([0, 1], [len(water), len(body)])
    named = {"material": number, "body": number, "wet": [0], "names": ("water", "body")}
    model = _model(setting, np.concatenate([water, body]), [WATER, material], **named)
    pull, walls = [Gravity()], [("tank", TANK)]
    options = {"forces": pull, "on_liquid": pull, "boundaries": [TANK], "walls": walls}
    return MixedSolver(model, State.of(model), **options, threads=1)


def _immerse(setting: Setting, material: NeoHookean) -> ImmersedSolver:
    solid = Solid(np.array([4, 4, 8]), DX / 2, np.ones((8, 8, 8), np.float32))
    cube = lattice_of(solid, density=material.density, dx=DX)
    assert cube.surface is not None
    water = _block((0, 0, 0), (1, 1, 0.375))
    number = np.repeat([0, 1], [len(water), len(cube)])
    volume = np.concatenate([np.full(len(water), DX**3 / 8), cube.volume])
    named = {"material": number, "body": number, "wet": [0], "names": ("water", "body")}
    x = np.concatenate([water, cube.x.astype(float)])
    model = Model.of(x, volume, [WATER, material], dx=DX, **named, **setting.options)
    surface = cube.surface + np.array([0, 0, 0, 0, 0, 0, 1, 0])
    walls = {"boundaries": [TANK], "walls": [("tank", TANK)]}
    options = {"forces": [Gravity()], **walls, "copies": cube.copies, "threads": 1}
    return ImmersedSolver(model, surface, State.of(model), **options)


def _advance(solver: AnySolver, time: float, after: Callable[[], object] = lambda: None) -> float:
    """Call `after` after each frame; return the largest speed in the last quarter [m/s]."""
    fastest, frames, start = 0.0, round(24 * time), solver.clock.time
    for frame in range(frames):
        solver.advance(start + (frame + 1) / 24)
        after()
        if frame >= 3 * frames // 4:
            fastest = higher(fastest, np.linalg.norm(host(solver.state.v), axis=1).max())
    return fastest


def _energy(solver: AnySolver) -> float:
    """Return the kinetic and potential energy relative to the floor [J]."""
    mass, x, v = (host(a) for a in (solver.model.mass, solver.state.x, solver.state.v))
    return float(mass @ (G * x[:, 2] + (v**2).sum(axis=1) / 2))
