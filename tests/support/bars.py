"""A bar that is pulled at both ends, and the closed form of its stretch."""

import numpy as np

from phy124.forces import TotalForce, Wind
from phy124.materials import NeoHookean
from phy124.schema.region import Region
from phy124.studies.validation.bodies import lattice, make_solver

DX = 1 / 16
E = 1e5
WIDTH = 4 * DX
PULL = 0.01 * E * WIDTH**2
"""Force that stretches the stiffest bar by 1 % [N]."""
AT = np.array([0.25, 0.75])
"""Positions of two marks, away from the ends, between which the bar is measured [m]."""


def bar() -> np.ndarray:
    """Return a bar of length 1 m along z, with two particles per cell and axis."""
    return lattice((8, 8, 32), DX / 2)


def pulled(fraction: np.ndarray | None) -> np.ndarray:
    """Return the positions of the marks [m] after both ends were pulled and the bar has come to
    rest."""
    x = bar()
    ends = [Region(upper=(9, 9, 2 * DX)), Region(lower=(-9, -9, 1 - 2 * DX))]
    pull = [TotalForce(f=(0, 0, f), region=at) for f, at in zip((-PULL, PULL), ends, strict=True)]
    # Damping comes first, because it would otherwise reduce the kick of the same substep.
    forces = [Wind(v=(0, 0, 0), rate=15.0), *pull]
    volume = np.full(len(x), (DX / 2) ** 3)
    law = [NeoHookean(E=E, nu=0.0)]
    s = make_solver(x, volume, law, dx=DX, forces=forces, stiffness=fraction, precision="float64")
    s.advance(1.5)
    assert np.abs(s.state.v.numpy()).max() < 1e-4
    layer = x[:, 2].reshape(-1, 32).mean(axis=0)
    return np.interp(AT, layer, s.state.x.numpy()[:, 2].reshape(-1, 32).mean(axis=0))


def stretch(fraction: np.ndarray) -> np.ndarray:
    """Return the stretch s: mu (s - 1/s) = force / area, where mu = fraction * E / 2 (nu = 0)."""
    load = PULL / WIDTH**2 / (fraction * E)
    return load + np.sqrt(load**2 + 1)


def length(fraction) -> float:
    """Return the distance of the marks in equilibrium: the integral of the stretch."""
    z = np.linspace(*AT, 20_001)
    s = stretch(fraction(z))
    return float(((s[1:] + s[:-1]) / 2 * np.diff(z)).sum())
