"""A clamped beam that is bent step by step, slowly enough to be at rest at each step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from phy124.boundaries import Held
from phy124.forces import Force
from phy124.materials import NeoHookean
from phy124.mpm import Model, Solver
from phy124.mpm.tracks import Keyframes
from phy124.schema.region import Region
from phy124.studies.validation.experiments.experiment import Quantity, Values
from phy124.studies.validation.experiments.symmetry import plane, sheet

LENGTH, THICKNESS = 1.2, 0.1
"""Of the beam, m. It is one particle wide, in a plane: with nu = 0 nothing varies across it."""
E, DENSITY = 1e6, 1000.0
STIFFNESS = E * THICKNESS**3 / 12
"""E I per metre of width [N m]."""
SOFTER = 0.96 * (THICKNESS / LENGTH) ** 2
"""By how much such a beam gives way more than a slender one, since it shears as well
(Timoshenko: 0.8 (1 + nu) * 1.2 (h / L)^2)."""
PER_AXIS = 4
"""Particles per cell and axis. With 2, as scenes have, a beam that has moved through some cells is
too soft by another tenth."""
TOO_SOFT = (
    "Too soft by some per cent on every grid once it is bent through several cells; where its tip "
    "moves through two (PL²/EI = 0.2) it is right. The stress balances the load, but F has lost "
    "part of the bending: the affine fit that it follows is not the gradient of the motion. At "
    "PL²/EI = 1 the positions are bent by 7, 13 and 29 % more than F says with 8, 4 and 2 "
    "particles per cell and axis (2 cells across), and the drop is 1.9, 5.8 and 14 % too large. "
    "With accuracy.gradient = spline, which takes the true gradient, these are 0, 1 and 9 %, and "
    "the drop is off by -0.4, 0.8 and 7.3 %."
)
REST = 1.6
"""Time for each load, in periods of the beam's first swing."""
PIECES = 40
"""How often per period it is slowed down."""

Bending = Callable[[float, Keyframes, Region], Force]
"""Makes a force from the width of the beam [m], its profile, and the region of the beam's end."""


def band(loads: Sequence[float], drops: Sequence[float], name: str) -> tuple[Quantity, ...]:
    """The tip's drop at each load: at least that of a slender beam, at most with its shear twice.

    Args:
        loads: Dimensionless loads.
        drops: Drops of the tip at these loads, over the length.
        name: Symbol of the load.
    """
    return tuple(
        Quantity(f"{name} = {load:g}", drop, drop, drop * (1 + 2 * SOFTER), load)
        for load, drop in zip(loads, drops, strict=True)
    )


def first_frequency() -> float:
    """Of a clamped slender beam, rad/s: 1.875^2 sqrt(E I / rho A L^4)."""
    return 1.8751**2 * math.sqrt(STIFFNESS / (DENSITY * THICKNESS)) / LENGTH**2


def drops(
    cells: int, loads: Sequence[float], bending: Bending, *, stiffer: float = 1.0,
    gradient: str = "affine",
) -> Values:  # fmt: skip
    """Drop of the end of the beam at rest at each load, over its length.

    Args:
        cells: Cells across its thickness.
        loads: Factors of the force, growing.
        bending: Makes the force at the factor 1.
        stiffer: Factor on E, for the control.
        gradient: Where stress and strain come from, as for `Model.of`.
    """
    dx = THICKNESS / cells
    spacing, clamped = dx / PER_AXIS, 3 * PER_AXIS
    # The last cell of particles is around the end of the beam, where its load acts.
    counts = (round(LENGTH / spacing) + clamped + PER_AXIS // 2, PER_AXIS * cells)
    x = sheet(counts, spacing, (-clamped * spacing, 0, 0))
    end = Region(lower=(LENGTH - dx / 2 - 1e-9, -1, -1), upper=(LENGTH + dx / 2 + 1e-9, 1, 1))
    hold = REST * 2 * math.pi / first_frequency()
    force = bending(dx, _steps(loads, hold), end)
    model = Model.of(
        x, np.full(len(x), spacing**2 * dx), [NeoHookean(E=stiffer * E, nu=0.0, density=DENSITY)],
        dx=dx, origin=(0, 0, 0.25 * dx), gradient=gradient,
    )  # fmt: skip
    clamp = Held(lower=(-1, -1, -1), upper=(0.0, 1, 1))
    solver = Solver(model, forces=[force], boundaries=[clamp, plane()], threads=1)
    tip, found = end.contains(model.rest), []
    for load in range(1, len(loads) + 1):
        _settle(solver, load * hold)
        sunk = (model.rest - solver.state.x.numpy())[tip, 2].mean()
        found.append(float(sunk) / LENGTH)
    return tuple(found)


def _steps(loads: Sequence[float], hold: float) -> Keyframes:
    """Each load is reached in a third of its time and held for the rest."""
    times, factors = [0.0], [0.0]
    for number, load in enumerate(loads):
        times += [(number + 1 / 3) * hold, (number + 1) * hold]
        factors += [load, load]
    return Keyframes(times=tuple(times), factors=tuple(factors))


def _settle(solver: Solver, until: float) -> None:
    """Go on with drag in proportion to speed, just enough that the beam does not swing."""
    omega = first_frequency()
    piece = 2 * math.pi / omega / PIECES
    slower = math.exp(-2 * omega * piece)
    while solver.clock.time < until - 1e-9:
        solver.advance(min(solver.clock.time + piece, until))
        solver.state.v.assign(solver.state.v.numpy() * slower)
        solver.state.C.assign(solver.state.C.numpy() * slower)
