"""Stiffness: Young's modulus that varies continuously inside one object.

Every law's first parameters are proportional to E, so a field of factors multiplies them particle
by particle: E(x) = share(x) E, with E the material's. Kernels then read a row of parameters per
particle; a scene without such a field has one row for all. A fraction per Gaussian is a column of a
file of properties (phy124/properties).
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from phy124.imaging.painted import Crop, sample_brightness
from phy124.mpm.tracks import Table
from phy124.schema.bounds import FileName
from phy124.schema.section import Section

MINIMUM = 1e-4
"""Smallest factor; waves are then a hundred times slower."""
Fraction = Annotated[float, Field(ge=MINIMUM, le=1)]


class _Field(Section):
    """Base class of all fields of stiffness."""

    def fractions(self, x: NDArray, means: NDArray, crop: Crop) -> NDArray[np.float64]:
        """Fraction of E at each particle [P].

        Args:
            x: Particles at rest [P,3], m.
            means: The object's Gaussians [N,3], m.
            crop: Where the object is in the picture it was made from.

        Raises:
            InputError: a file cannot be used.
        """
        raise NotImplementedError


class Gradient(_Field):
    """Linear from one end of the object to the other: grown wood, a tail, a root."""

    kind: Literal["gradient"] = "gradient"
    axis: Literal["x", "y", "z"] = Field(default="z", description="Direction in which it varies.")
    first: Fraction = Field(default=1.0, description="Fraction of E at the lowest end of the axis.")
    last: Fraction = Field(default=0.1, description="Fraction of E at the highest end of the axis.")

    def fractions(self, x: NDArray, means: NDArray, crop: Crop) -> NDArray[np.float64]:
        """Linear between the object's ends."""
        along = np.asarray(x, dtype=np.float64)[:, "xyz".index(self.axis)]
        return np.interp(along, [along.min(), along.max()], [self.first, self.last])


class Picture(_Field):
    """Given by a grey picture painted over the object's picture: white is stiff, black is soft."""

    kind: Literal["picture"] = "picture"
    file: FileName = Field(
        examples=["stiff.png"],
        description="Grey picture file, seen from the front.",
    )
    black: Fraction = Field(default=0.1, description="Fraction of E where it is black.")
    white: Fraction = Field(default=1.0, description="Fraction of E where it is white.")

    def fractions(self, x: NDArray, means: NDArray, crop: Crop) -> NDArray[np.float64]:
        """Linear in the grey value."""
        grey = sample_brightness(x, self.file, crop, field="stiffness.file")
        return self.black + grey * (self.white - self.black)


AnyStiffness = Annotated[Gradient | Picture, Field(discriminator="kind")]
SOFTEST, STIFFEST = 0.01, 100.0
"""Factors on E over time."""


def check_profile(profile: Table) -> None:
    """Check that all factors of a profile over time can be used.

    Raises:
        ValueError: One is too small or too large.
    """
    factors = profile.table()[1]
    if not (factors.min() >= SOFTEST and factors.max() <= STIFFEST):
        range_ = f"from {factors.min():g} to {factors.max():g}"
        raise ValueError(
            f"factors {range_} are beyond {SOFTEST:g} to {STIFFEST:g}; choose them between"
        )
