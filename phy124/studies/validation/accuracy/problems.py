"""Defines problems with known solutions, and measures the solver's error.

Bars and columns are one particle thick. This is sufficient, because nothing varies across a bar
with nu = 0 or a column with fixed sides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Ground, HalfSpace
from phy124.forces import Gravity
from phy124.kernels.arguments import types
from phy124.kernels.forces import make_vortex
from phy124.lattice.solver import LatticeSolver
from phy124.materials import Fluid, NeoHookean
from phy124.mpm import Grid, Model, Solver, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.studies.validation.bodies import (
    block,
    host,
    lattice,
    make_solver,
    plane,
    record,
    turning,
)

if TYPE_CHECKING:
    import warp as wp


Array = NDArray[np.float64]
GRAVITY = 9.81
FLOOR_NODE = 0.75
"""Depth of the lowest nodes below the floor [cells], as in all simulations."""


def angular_momentum(solver: Solver | LatticeSolver) -> Array:
    """Return the angular momentum [3], kg m^2/s, that APIC conserves exactly.

    This is the sum of `m (x cross v + dx^2/4 axial(C))` over all particles.
    """
    m, x = host(solver.model.mass)[:, None], host(solver.state.x)
    v, C = host(solver.state.v), host(solver.state.C)
    axial = np.stack(
        [C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], axis=1
    )
    return (m * (np.cross(x, v) + solver.model.dx**2 / 4 * axial)).sum(axis=0)


# --- free fall -----------------------------------------------------------------------------------


def fall(position: Array, velocity: Array, time: float) -> Array:
    """Return the exact positions: `x + v t`, minus `g t^2 / 2` along z."""
    return position + velocity * time - np.array([0, 0, GRAVITY * time**2 / 2])


def free_fall(*, precision: str = "float64", time: float = 0.2, device: str = "cpu") -> float:
    """Return the largest position error of a thrown body, divided by the largest displacement."""
    x, v = block(8, 0.4) + np.array([0, 0, 1]), np.array([1.0, 0.5, 2.0])
    options = {"v": np.tile(v, (len(x), 1)), "dx": 0.1, "precision": precision, "device": device}
    solver = make_solver(x, 0.05**3, [NeoHookean(E=1e4)], forces=[Gravity()], **options)
    solver.advance(time)
    error = solver.state.x.numpy() - fall(x, v, time)
    return float(np.abs(error).max() / np.linalg.norm(fall(x, v, time) - x, axis=1).max())


# --- rigid spin ----------------------------------------------------------------------------------


def spin(turns: float, *, precision: str = "float64", device: str = "cpu") -> tuple[float, float]:
    """Return the relative changes of angular momentum and energy of a freely rotating cube."""
    dx, omega = 0.1, 9.0
    x = block(8, 4 * dx)
    options = {"dx": dx, "precision": precision, "device": device}
    stiff = NeoHookean(E=2e5, nu=0.3)
    solver = make_solver(x, (dx / 2) ** 3, [stiff], **turning(x, (0, 0, omega)), **options)
    momentum, energy = angular_momentum(solver), _kinetic(solver)
    solver.advance(turns * 2 * math.pi / omega)
    change = np.linalg.norm(angular_momentum(solver) - momentum) / np.linalg.norm(momentum)
    return float(change), abs(_kinetic(solver) / energy - 1)


def _kinetic(solver: Solver) -> float:
    """Return the kinetic energy [J], including the part that APIC stores in C."""
    m, v, C = host(solver.model.mass), host(solver.state.v), host(solver.state.C)
    return float((m * ((v**2).sum(1) + solver.model.dx**2 / 4 * (C**2).sum((1, 2)))).sum() / 2)


# --- vibrating bar -------------------------------------------------------------------------------


def bar_frequency(E: float, density: float, length: float) -> float:
    """Return the frequency of a free bar's first mode, `pi / L sqrt(E / rho)` [rad/s]."""
    return math.pi / length * math.sqrt(E / density)


def vibrating_bar(cells: int, device: str = "cpu") -> float:
    """Return the signed relative error of the frequency of a free bar's first mode."""
    E, density, length, strain = 1e4, 1000.0, 1.0, 1e-6
    dx = length / cells
    x = _column(cells, dx)
    z = x[:, 2]
    wave = math.pi / length
    exact, speed = bar_frequency(E, density, length), math.sqrt(E / density)
    v, C = np.zeros_like(x), np.zeros((len(x), 3, 3))
    v[:, 2] = strain * speed * np.cos(wave * z)
    C[:, 2, 2] = -strain * speed * wave * np.sin(wave * z)
    material = NeoHookean(E=E, nu=0.0, density=density)
    options = {"dx": dx, "precision": "float64", "device": device}
    solver = make_solver(x, dx**3 / 2, [material], v=v, C=C, **options)
    period, times, modes = 2 * math.pi / exact, [0.0], [0.0]

    def record() -> None:
        times.append(solver.clock.time)
        modes.append(float((np.cos(wave * z) * (solver.state.x.numpy()[:, 2] - z)).sum()))

    solver.advance(1.1 * period, after=record)
    return _zero_crossing(times, modes, period) ** -1 * period - 1


def _column(cells: int, dx: float) -> Array:
    """Return the positions [P,3], m, of a row of particles on the z axis, 2 per cell."""
    return lattice((1, 1, 2 * cells), dx / 2) * [0.0, 0, 1]


def _zero_crossing(times: Sequence[float], values: Sequence[float], near: float) -> float:
    """Return the time [s] closest to `near` at which a smooth signal crosses zero upwards."""
    t, y = np.array(times), np.array(values)
    rising = np.flatnonzero((y[1:] > 0) & (y[:-1] <= 0) & (t[1:] > near / 2))
    at = int(rising[np.abs(t[rising] - near).argmin()])
    span = slice(max(at - 1, 0), at + 3)
    # A cubic fit of time as a function of the signal is far more precise than linear interpolation.
    return float(np.polyval(np.polyfit(y[span] / np.abs(y).max(), t[span], 3), 0.0))


# --- generalised vortex --------------------------------------------------------------------------


@dataclass(frozen=True)
class Vortex:
    """A ring with a manufactured motion (Kamojjala et al. 2015).

    In one second, each circle in the ring rotates forwards and back.
    """

    amplitude: float = 0.1
    inner: float = 0.75
    outer: float = 1.25
    material: NeoHookean = NeoHookean(E=1000.0, nu=0.3, density=1000.0)  # noqa: RUF009

    def angle(self, radius: Array, time: float) -> Array:
        """Return the exact angles [rad] by which circles of these radii [m] have rotated."""
        s = (radius - (self.inner + self.outer) / 2) / (self.outer - self.inner)
        rise = self.amplitude * (1 - math.cos(2 * math.pi * time)) / 2
        return (1 - 8 * s**2 + 16 * s**4) * rise

    def position(self, x: Array, time: float) -> Array:
        """Return the exact positions [P,3] at a time [s]; `x` are the initial positions."""
        turn = self.angle(np.hypot(x[:, 0], x[:, 1]), time)
        cosine, sine = np.cos(turn), np.sin(turn)
        columns = (cosine * x[:, 0] - sine * x[:, 1], sine * x[:, 0] + cosine * x[:, 1], x[:, 2])
        return np.stack(columns, axis=1)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return a solver stage that applies the body force of the exact motion."""
        stiffness = self.material.lame[0] / self.material.density
        middle, width = (self.inner + self.outer) / 2, self.outer - self.inner
        ring = types(model.real).vec4(middle, width, self.amplitude, stiffness)
        kernel = make_vortex(model.real)

        def record(grid: Grid) -> wp.Launch | None:
            inputs = [ring, tracks.clock, state.x]
            return model.launch(kernel, len(model), inputs, [state.v])

        return [Stage("vortex", record)]


def vortex(
    cells: int, *, time: float = 0.5, problem: Vortex | None = None, device: str = "cpu"
) -> float:
    """Return the RMS position error of the ring divided by the RMS displacement.

    Args:
        cells: Number of cells across the ring's outer diameter.
        time: Duration of the motion [s].
        problem: The ring; None: the ring with the default values.
        device: Warp device.
    """
    problem = problem or Vortex()
    dx = 2 * problem.outer / cells
    spacing, corner = dx / 4, (-problem.outer, -problem.outer, 0)
    x = lattice((4 * cells, 4 * cells, 1), spacing, corner) * [1.0, 1, 0]
    radius = np.hypot(x[:, 0], x[:, 1])
    x = x[(radius > problem.inner) & (radius < problem.outer)]
    options = {"dx": dx, "precision": "float64", "forces": [problem], "device": device}
    solver = make_solver(x, spacing**2 * dx, [problem.material], **options)
    solver.advance(time)
    exact = problem.position(x, time)
    return float(_rms(solver.state.x.numpy() - exact) / _rms(exact - x))


def _rms(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


# --- hydrostatic column --------------------------------------------------------------------------


def column_pressure(depth: Array, density: float) -> Array:
    """Return the pressure rho g h [Pa] at depths h [m] in a column at rest."""
    return density * GRAVITY * depth


def hydrostatic_column(cells: int, device: str = "cpu") -> dict[str, float]:
    """Return the errors of the pressure in a column at rest, relative to rho g h at the base.

    `mean` is the error of the mean pressure. This error is proportional to dx, and arises in the
    cells at the floor; the floor lies between two planes of nodes. `inside` is the RMS error more
    than three cells above the floor.
    """
    height, material = 1.0, Fluid()
    dx = height / cells
    x = _column(cells, dx)
    side = HalfSpace(point=(1e3, 0, 0), normal=(1.0, 0, 0), contact="slip")
    solver = make_solver(
        x,
        dx**3 / 2,
        [material],
        dx=dx,
        origin=(0, 0, -FLOOR_NODE * dx),
        precision="float64",
        device=device,
        forces=[Gravity()],
        boundaries=[Ground(contact="slip"), side, plane()],
    )
    _settle(solver, height / material.wave_speed())
    J, z = np.linalg.det(host(solver.state.F)), x[:, 2]
    pressure = material.bulk_modulus / material.gamma * (J**-material.gamma - 1)
    foot = float(column_pressure(np.array(height), material.density))
    error = (pressure - column_pressure(height - z, material.density)) / foot
    return {"mean": abs(float(error.mean())), "inside": _rms(error[z > 3 * dx, None])}


def _settle(solver: Solver, crossing: float) -> None:
    """Apply kinetic damping: set velocities to zero at twelve maxima of the kinetic energy.

    `crossing` is the time in which a wave crosses the column [s].
    """
    stops, last = 0, 0.0
    while stops < 12:
        solver.advance(solver.clock.time + crossing / 20)
        now = _kinetic(solver)
        if now < last:
            solver.state.v.zero_()
            solver.state.C.zero_()
            stops, now = stops + 1, 0.0
        last = now


# --- bouncing ball -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bounce:
    """A soft ball that falls on a smooth floor; results on several grids are compared."""

    diameter: float = 0.4
    drop: float = 0.2
    material: NeoHookean = NeoHookean(E=5e4, nu=0.3)  # noqa: RUF009
    seconds: float = 0.5
    frames: int = 20

    def particles(self, spacing: float) -> Array:
        """Return the initial positions [P,3], m."""
        counts = (round(self.diameter / spacing),) * 3
        cube = lattice(counts, spacing, (-self.diameter / 2,) * 3)
        inside = (cube**2).sum(axis=1) < (self.diameter / 2) ** 2
        return np.asarray(cube[inside] + [[0, 0, self.drop + self.diameter / 2]], float)

    def run(self, cells: int, spacing: float, device: str = "cpu") -> Array:
        """Return the positions [T,P,3], m, of the ball with `cells` cells across it."""
        x, dx = self.particles(spacing), self.diameter / cells
        world = {"forces": [Gravity()], "boundaries": [Ground(friction=0.0)], "device": device}
        origin = (0, 0, -FLOOR_NODE * dx)
        solver = make_solver(x, spacing**3, [self.material], dx=dx, origin=origin, **world)
        times = self.seconds * np.arange(1, self.frames + 1) / self.frames
        return record(solver, times, lambda: host(solver.state.x))


def bouncing_ball(cells: Sequence[int], device: str = "cpu") -> list[Array]:
    """Return the positions [T,P,3], m, for each number of cells across the ball.

    All grids have the same particles, two per cell and axis on the finest grid.
    """
    problem = Bounce()
    spacing = problem.diameter / (2 * max(cells))
    return [problem.run(each, spacing, device) for each in cells]
