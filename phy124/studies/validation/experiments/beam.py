"""Experiments: large deflections of cantilevers, under a weight at the tip or under gravity.

The exact shape is Euler's elastica. The beam comes to rest under each load.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import SupportsFloat

import numpy as np

from phy124.boundaries import Held
from phy124.forces import Force, Gravity, TotalForce
from phy124.lattice.solver import LatticeSolver
from phy124.materials import NeoHookean
from phy124.mpm import Solver
from phy124.mpm.tracks import Keyframes
from phy124.particles.solid import Solid
from phy124.schema.region import Region
from phy124.studies.validation.bodies import make_lattice_solver, make_solver, plane, sheet
from phy124.studies.validation.experiments.experiment import (
    Experiment,
    Quantity,
    Values,
    find_root,
    repeat_with_mpm,
)

LENGTH, THICKNESS = 1.2, 0.1
"""Size of the beam [m]. The beam is one particle wide, because with nu = 0, nothing varies across
the width.
"""
E, DENSITY = 1e6, 1000.0
STIFFNESS = E * THICKNESS**3 / 12
"""Bending stiffness E I per metre of width [N m]."""
TIP_SHEAR, OWN_SHEAR = 0.6, 0.8
"""Increase of the tip deflection by shear, relative to that by bending, divided by (h / L)^2.

The increase by Timoshenko's theory is `3 E I / (k G A L^2) = 0.6 (1 + nu) (h / L)^2` for a weight
at the tip, and `4 E I / (k G A L^2) = 0.8 (1 + nu) (h / L)^2` for the beam's own weight. The shear
coefficient k is 5 / 6, and nu is zero.
"""
PER_AXIS = 4
"""Particles per cell and axis; with 2, a beam that moves by several cells is 10 % softer."""
TOO_SOFT = (
    "Beams are a few per cent too soft on every grid if their tip moves by several cells. If the "
    "tip moves by only two cells (PL²/EI = 0.2), the deflection is 0.6 % too large. The stress "
    "balances the load, but the bending in F is too small, because F follows an affine fit of the "
    "motion instead of the motion's gradient. The following figures are for PL²/EI = 1, for 2 "
    "cells across the thickness, and for 8, 4 and 2 particles per cell and axis. The bending "
    "computed from positions exceeds the bending computed from F by 7, 13 and 29 %, and the "
    "deflection is 1.5, 5.4 and 14 % larger than that of the elastica with this beam's shear. "
    "With accuracy.gradient = spline, the bending from positions exceeds that from F by only 0, 1 "
    "and 9 %, and the error of the deflection is -0.8, 0.4 and 6.9 %."
)
REST = 1.6
"""Duration of each load, in periods of the first bending mode."""
PIECES = 40
"""Velocities are reduced on average this many times in each period of the first mode."""
GOLDEN = (math.sqrt(5) - 1) / 2
"""Inverse golden ratio; its multiples, modulo 1, never repeat."""

Bending = Callable[[float, Keyframes, Region], Force]
"""A function that returns a force for the beam's width [m], a time profile and the region of the
tip.
"""
TIP_LOADS = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""Dimensionless weights at the tip, P L^2 / E I."""
TIP_LOAD = "PL²/EI"
"""Symbol of these weights."""
OWN_LOADS = (2.0, 8.0, 20.0)
"""Dimensionless strengths of gravity, rho g A L^3 / E I."""


def elastica_drop(load: float) -> float:
    """Return the tip deflection / length for a weight at the tip, P L^2 / E I.

    Elliptic integrals (Bisshopp and Drucker 1945).
    """
    from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

    def start(m: float) -> float:
        return float(np.arcsin(1 / np.sqrt(2 * m)))

    def residual(m: float) -> float:
        return float(ellipk(m) - ellipkinc(start(m), m) - np.sqrt(load))

    m = find_root(residual, 0.5, 1 - 1e-12)
    return float(1 - 2 / np.sqrt(load) * (ellipe(m) - ellipeinc(start(m), m)))


def heavy_elastica_drop(load: float) -> float:
    """Return the tip deflection / length for a beam under its own weight, rho g A L^3 / E I.

    Shooting method for `theta'' = -load (1 - s) cos theta`.
    """
    from scipy.integrate import solve_ivp

    def end(bend: float) -> list[float]:
        def slope(s: float, y: list[float]) -> list[float]:
            return [y[1], -load * (1 - s) * np.cos(y[0]), np.sin(y[0])]

        ends = solve_ivp(slope, (0, 1), [0.0, bend, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
        return ends.tolist()

    return float(end(find_root(lambda bend: end(bend)[1], 0.0, load / 2))[2])


def load_tip(width: float, profile: Keyframes, end: Region) -> Force:
    """Return a load P, in units of `E I / L^2`, at the tip of a beam `width` [m] wide."""
    unit = STIFFNESS * width / LENGTH**2
    return TotalForce(f=(0, 0, -unit), region=end, profile=profile)


def load_all(width: float, profile: Keyframes, end: Region) -> Force:
    """Return gravity on the whole beam, in units of `E I / (rho A L^3)`."""
    unit = STIFFNESS / (DENSITY * THICKNESS * LENGTH**3)
    return Gravity(g=(0, 0, -unit), profile=profile)


def make_band(
    loads: Sequence[float],
    exact: Callable[[float], float],
    name: str,
    *,
    shear: float,
    stretch: float,
) -> tuple[Quantity, ...]:
    """Return the published tip deflection and its band for each load.

    The lower end of the band is the deflection without shear. The upper end adds the effect of the
    tension, and twice the effect of the beam's shear.

    Args:
        loads: Dimensionless loads.
        exact: Function that returns a slender beam's tip deflection / length for a load.
        name: Symbol of the load.
        shear: Increase of the deflection by shear, divided by (h / L)^2.
        stretch: Mean tension that stretches the hanging beam, as a fraction of the load.
    """
    square = (THICKNESS / LENGTH) ** 2
    highs = [1 + (2 * shear + stretch / 12 * load) * square for load in loads]
    return tuple(
        Quantity(f"{name} = {load:g}", drop, drop, drop * high, load)
        for load, drop, high in zip(loads, map(exact, loads), highs, strict=True)
    )


def first_frequency() -> float:
    """Return a slender beam's lowest frequency: `1.875^2 sqrt(E I / (rho A L^4))` [rad/s]."""
    return 1.8751**2 * math.sqrt(STIFFNESS / (DENSITY * THICKNESS)) / LENGTH**2


def measure_particle_drops(
    cells: int,
    loads: Sequence[float],
    bending: Bending,
    *,
    stiffer: float = 1.0,
    gradient: str = "affine",
) -> Values:
    """Measure the tip deflection at rest for each load, relative to the length.

    Args:
        cells: Cells across the beam's thickness.
        loads: Factors of the force, in ascending order.
        bending: Makes the force.
        stiffer: Factor on E, for the control.
        gradient: An option of `Model.of`.
    """
    dx = THICKNESS / cells
    spacing, clamped = dx / PER_AXIS, 3 * PER_AXIS
    # The load acts on the last cell of particles; the cell's centre is the end of the beam.
    counts = (round(LENGTH / spacing) + clamped + PER_AXIS // 2, PER_AXIS * cells)
    x = sheet(counts, spacing, (-clamped * spacing, 0, 0))
    end = _end_region(LENGTH, dx)
    rubber = NeoHookean(E=stiffer * E, nu=0.0, density=DENSITY)
    clamp = Held(lower=(-1, -1, -1), upper=(0.0, 1, 1))
    solver = make_solver(
        x,
        spacing**2 * dx,
        [rubber],
        dx=dx,
        origin=(0, 0, 0.25 * dx),
        gradient=gradient,
        forces=[bending(dx, _steps(loads), end)],
        boundaries=[clamp, plane()],
        threads=1,
    )
    rest = solver.model.rest
    tip = end.contains(rest)
    return _load(solver, loads, lambda: np.mean((rest - solver.state.x.numpy())[tip, 2]))


def measure_drops(
    cells: int,
    loads: Sequence[float],
    bending: Bending,
    *,
    stiffer: float = 1.0,
    beyond: float = 0.0,
) -> Values:
    """Measure the tip deflections with the lattice solver, for a beam as wide as it is thick.

    Args:
        cells: Cells across the beam's thickness.
        loads: Factors of the force, in ascending order.
        bending: Makes the force.
        stiffer: Factor on E, for the control.
        beyond: Length of the solid beyond the beam's end [cells], so that a load acts on a cell
            around the end.
    """
    dx = THICKNESS / cells
    root, clamped = beyond * dx, 3
    counts = round(2 * (LENGTH / dx + 2 * beyond + clamped)), 2 * cells, 2 * cells
    solid = Solid(np.array([-2 * clamped, 0, 0]), dx / 2, np.ones(counts, np.float32))
    at = root + LENGTH
    force = bending(THICKNESS, _steps(loads), _end_region(at, dx))
    rubber = NeoHookean(E=stiffer * E, nu=0.0, density=DENSITY)
    clamp = Held(lower=(-1, -1, -1), upper=(root, 1, 1))
    solver = make_lattice_solver(solid, dx, rubber, forces=[force], boundaries=[clamp], threads=1)
    rest = solver.model.rest
    away = rest[:, 0] - at
    tip = away > -1.5 * dx

    def sag() -> float:
        solver.follow()
        return np.polyfit(away[tip], (rest - solver.state.x.numpy())[tip, 2], 1)[1]

    return _load(solver, loads, sag)


def _name_loads(deviations: Mapping[float, float]) -> dict[str, float]:
    """Return the deviations for loads at the tip, by the names of the quantities."""
    return {f"{TIP_LOAD} = {load:g}": deviation for load, deviation in deviations.items()}


def _end_region(at: float, dx: float) -> Region:
    return Region(lower=(at - dx / 2 - 1e-9, -1, -1), upper=(at + dx / 2 + 1e-9, 1, 1))


def _steps(loads: Sequence[float]) -> Keyframes:
    """Return factors that rise to each load during the first third of its duration."""
    hold = _duration_of_load()
    times, factors = [0.0], [0.0]
    for number, load in enumerate(loads):
        times += [(number + 1 / 3) * hold, (number + 1) * hold]
        factors += [load, load]
    return Keyframes(times=tuple(times), factors=tuple(factors))


def _load(
    solver: Solver | LatticeSolver, loads: Sequence[float], sag: Callable[[], SupportsFloat]
) -> Values:
    drops = []
    for number in range(1, len(loads) + 1):
        _settle(solver, number * _duration_of_load())
        drops.append(float(sag()) / LENGTH)
    return tuple(drops)


def _duration_of_load() -> float:
    return REST * 2 * math.pi / first_frequency()


def _settle(solver: Solver | LatticeSolver, until: float) -> None:
    omega, number = first_frequency(), 0
    while solver.clock.time < until - 1e-9:
        before, number = solver.clock.time, number + 1
        # Velocities are half a substep behind positions. With equal intervals between velocity
        # reductions, fast vibrations could therefore be in resonance and grow.
        piece = (0.75 + 0.5 * (number * GOLDEN % 1)) * 2 * math.pi / omega / PIECES
        solver.advance(min(before + piece, until))
        slower = math.exp(-2 * omega * (solver.clock.time - before))
        rates = (
            [solver.nodes_state.v]
            if isinstance(solver, LatticeSolver)
            else [solver.state.v, solver.state.C]
        )
        for rate in rates:
            rate.assign(rate.numpy() * slower)


_tip_exact = partial(make_band, TIP_LOADS, elastica_drop, TIP_LOAD, shear=TIP_SHEAR, stretch=1.0)
_weight_exact = partial(
    make_band, OWN_LOADS, heavy_elastica_drop, "ρgAL³/EI", shear=OWN_SHEAR, stretch=0.5
)
_particle_tip = partial(measure_particle_drops, loads=TIP_LOADS, bending=load_tip)
_particle_weight = partial(measure_particle_drops, loads=OWN_LOADS, bending=load_all)
_tip = partial(measure_drops, loads=TIP_LOADS, bending=load_tip, beyond=0.5)
_weight = partial(measure_drops, loads=OWN_LOADS, bending=load_all)

ELASTICA = Experiment(
    name="elastica",
    title="Elastica: a dead weight on the end of a cantilever",
    source="Euler's elastica by elliptic integrals, as tabulated by Bisshopp and Drucker 1945",
    measured="The experiment measures the tip deflection at rest, divided by the length, for "
    "seven weights P. The linear theory of small bending overestimates the deflection by 11 % at "
    "PL²/EI = 1, and by 311 % at PL²/EI = 10.",
    band="from the deflection without shear to the deflection with twice this beam's shear and "
    "the stretch of a hanging beam; the beam is 12 times as long as thick",
    published=_tip_exact,
    run=_tip,
    control=partial(_tip, stiffer=1.2),
    mistake="E is 20 % too large",
    grids=(2, 3, 4),
    across="the thickness",
    axis="P L² / E I",
    unit="drop / length",
    seconds=50,
)
MPM_ELASTICA = repeat_with_mpm(
    ELASTICA,
    _particle_tip,
    partial(_particle_tip, stiffer=1.2),
    seconds=110,
    known=_name_loads(
        {0.2: 0.012, 0.5: 0.041, 1.0: 0.048, 2.0: 0.036, 3.0: 0.025, 5.0: 0.019, 10.0: 0.017}
    ),
    reason=TOO_SOFT,
)
SPLINE_ELASTICA = replace(
    MPM_ELASTICA,
    name="elastica-spline",
    title="Elastica with strain from the gradients of the weights",
    measured='The experiment repeats `elastica-mpm` with accuracy.gradient = "spline" instead of '
    '"affine".',
    run=partial(_particle_tip, gradient="spline"),
    control=partial(_particle_tip, stiffer=1.2, gradient="spline"),
    seconds=210,
    known=_name_loads({0.2: -0.008}),
    reason="Few cells make the beam slightly too stiff, and few particles make it slightly too "
    "soft. With 8 particles per cell and axis, the deflection at the smallest load is 1.5, 1.2 "
    "and 1.1 % smaller than that of the elastica with this beam's shear, on 2, 3 and 4 cells, so "
    "the error converges. With 4 particles per cell and axis, the error from few cells and the "
    "error from few particles cancel. The extrapolation cannot detect that these errors cancel.",
)
HEAVY_ELASTICA = replace(
    ELASTICA,
    name="heavy-elastica",
    title="Heavy elastica: a cantilever under its own weight",
    source="the angle θ of the beam at the arc length s L, from θ'' = −β (1 − s) cos θ with β = "
    "ρgAL³/EI, integrated numerically",
    measured="The experiment measures the tip deflection at rest, divided by the length, for "
    "three strengths of gravity.",
    published=_weight_exact,
    run=_weight,
    control=partial(_weight, stiffer=1.4),
    mistake="E is 40 % too large",
    axis="ρ g A L³ / E I",
    quick=True,
    seconds=10,
)
MPM_HEAVY_ELASTICA = repeat_with_mpm(
    replace(HEAVY_ELASTICA, quick=False),
    _particle_weight,
    partial(_particle_weight, stiffer=1.4),
    seconds=50,
)
