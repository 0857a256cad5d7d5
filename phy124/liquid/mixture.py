"""Density and viscosity at each face if there are several liquids; forces between liquids."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.contacts import SUMS
from phy124.mpm import Model

VISCOSITY = 2
"""Index of the viscosity among a fluid's parameters."""


class Mixture:
    """Density and viscosity of the liquids in a run, relative to reference values."""

    def __init__(self, model: Model, runs: Sequence[slice] = (), workers: int = 1) -> None:
        """Compute densities and viscosities; `runs` are the slices of the liquids' particles."""
        self._model = model
        mass, volume = (np.asarray(a.numpy(), np.float64) for a in (model.mass, model.volume))
        viscosities = _viscosities(model)
        self.density = float(mass.sum() / volume.sum())
        """Mean density of the liquids [kg/m^3]."""
        self.viscosity = float(viscosities.max())
        """Largest viscosity of the liquids [Pa s]."""
        self.differ = [_differ(mass / volume), _differ(viscosities)]
        """Whether the densities differ, and whether the viscosities differ."""
        each = mass / self.density, volume * viscosities / max(self.viscosity, 1e-300)
        self.weights = [
            model.array(values, model.real)
            for values, differ in zip(each, self.differ, strict=True)
            if differ
        ]
        """The volume of each particle times its relative density, and the volume times its relative
        viscosity. A property that is equal for all liquids is omitted. Then the volumes of each
        liquid follow; if there are two liquids, only the volumes of the second liquid.
        """
        self.pairs = list(combinations(range(len(runs)), 2))
        self.sums = wp.zeros(
            (workers, len(self.pairs), SUMS), dtype=wp.float64, device=model.device
        )
        """Impulse and moment of the first liquid on the second, for each pair [W,pairs,6]."""
        numbers = np.arange(len(volume))
        parts = runs[1:] if len(runs) <= 2 else runs
        for run in parts:
            part = np.where((numbers >= run.start) & (numbers < run.stop), volume, 0.0)
            self.weights.append(model.array(part, model.real))

    def fit(self, count: int) -> None:
        """Allocate the arrays for a window with `count` cells."""
        model = self._model
        kind = types(model.real).vec4
        self.uniform = wp.full(count, kind(1.0, 1.0, 1.0, 1.0), dtype=kind, device=model.device)
        """The value 1 in every cell, for properties that do not differ."""
        self.mixed = [wp.zeros_like(self.uniform) for _ in self.weights]
        """Averages in each cell of the properties in `weights`."""
        mixed = iter(self.mixed)
        self.densities, self.viscosities = (
            next(mixed) if differ else self.uniform for differ in self.differ
        )
        none = wp.zeros(0, dtype=kind, device=model.device)
        self.fractions = [none, *mixed] if len(self.pairs) == 1 else list(mixed)
        """Fractions of each liquid in each cell; the first of two liquids has no array."""

    def take_impulses(self) -> NDArray[np.float64]:
        """Return the sum of all workers' impulses and moments for each pair [pairs,6], and reset
        the sums.
        """
        total = np.array(self.sums.numpy(), np.float64).sum(axis=0)
        self.sums.zero_()
        return total


def _differ(values: NDArray) -> bool:
    return float(np.ptp(values)) > 1e-4 * float(np.abs(values).max())


def _viscosities(model: Model) -> NDArray[np.float64]:
    values = np.zeros(len(model))
    for group in model.groups:
        values[group.particles] = group.theta.numpy()[:, VISCOSITY]
    return values
