"""Stiffness: Young's modulus that varies continuously inside one object.

Every law's first parameters are proportional to E, so a field of factors multiplies them particle
by particle: E(x) = share(x) E, with E the material's. Kernels then read a row of parameters per
particle; a scene without such a field has one row for all.
"""

from __future__ import annotations

import os
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import KDTree

from phy124.bounds import FileName
from phy124.errors import InputError
from phy124.imaging.painted import Crop, brightness
from phy124.section import Section

MINIMUM = 1e-4
"""Smallest factor; waves are then a hundred times slower."""
Fraction = Annotated[float, Field(ge=MINIMUM, le=1)]


class _Field(Section):
    """What all fields of stiffness have."""

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
        grey = brightness(x, self.file, crop, field="stiffness.file")
        return self.black + grey * (self.white - self.black)


class Listed(_Field):
    """Given by a file with a factor for each Gaussian; points between follow the nearest one."""

    kind: Literal["array"] = "array"
    file: FileName = Field(
        examples=["shares.npy"],
        description="NumPy file (.npy) of fractions of E, one per Gaussian.",
    )

    def fractions(self, x: NDArray, means: NDArray, crop: Crop) -> NDArray[np.float64]:
        """Factor of the nearest Gaussian.

        Raises:
            InputError: If the file cannot be read or does not fit the object.
        """
        try:
            listed = np.load(os.fspath(self.file), allow_pickle=False)
            listed = np.asarray(listed, dtype=np.float64)
        except (OSError, ValueError, EOFError, TypeError) as error:
            limit = f"it cannot be read ({error})."
            raise InputError(
                "stiffness.file", self.file, limit, "Give numbers saved by numpy.save."
            ) from None
        if listed.shape != (len(means),):
            raise InputError(
                "stiffness.file", self.file,
                f"it holds an array {listed.shape}, the object has {len(means)} Gaussians.",
                "Give one fraction per Gaussian of the gaussians.ply that a run writes.",
            )  # fmt: skip
        if not ((listed >= MINIMUM) & (listed <= 1)).all():
            raise InputError(
                "stiffness.file", self.file, f"a fraction is outside {MINIMUM:g} to 1.",
                "Divide by the largest value and give that to the material's E.",
            )  # fmt: skip
        return listed[KDTree(means).query(x)[1]]


AnyStiffness = Annotated[Gradient | Picture | Listed, Field(discriminator="kind")]
