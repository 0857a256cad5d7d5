"""Density and viscosity at each face if there are several liquids."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.mpm import Model

VISCOSITY = 2
"""Index of the viscosity among a fluid's parameters."""


class Mixture:
    """Density and viscosity of the liquids in a run, relative to reference values."""

    def __init__(self, model: Model) -> None:
        self._model = model
        mass, volume = (np.asarray(a.numpy(), np.float64) for a in (model.mass, model.volume))
        viscosities = _viscosities(model)
        self.density = float(mass.sum() / volume.sum())
        """Mean density of the liquids [kg/m^3]."""
        self.viscosity = float(viscosities.max())
        """Largest viscosity of the liquids [Pa s]."""
        self.lightest = float((mass / volume).min())
        """Smallest density of a liquid [kg/m^3]."""
        self.differ = [_differ(mass / volume), _differ(viscosities)]
        """Whether the densities differ, and whether the viscosities differ."""
        each = mass / self.density, volume * viscosities / max(self.viscosity, 1e-300)
        self.weights = [
            model.array(values, model.real)
            for values, differ in zip(each, self.differ, strict=True)
            if differ
        ]
        """Volume of each particle times relative density, and times relative viscosity; only for
        properties that differ.
        """

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


def _differ(values: NDArray) -> bool:
    return float(np.ptp(values)) > 1e-4 * float(np.abs(values).max())


def _viscosities(model: Model) -> NDArray[np.float64]:
    values = np.zeros(len(model))
    for group in model.groups:
        values[group.particles] = group.theta.numpy()[:, VISCOSITY]
    return values
