"""Stiffness fields: a Young's modulus that varies continuously inside an object.

A field multiplies the material's Young's modulus E at each particle by a fraction. The first
parameters of every law are proportional to E.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from phy124.imaging.painted import Canvas, sample_brightness
from phy124.mpm.tracks import Table
from phy124.schema.bounds import FileName
from phy124.schema.section import Section

MINIMUM = 1e-4
"""Smallest factor on E; with this factor, waves are a hundred times slower."""
Fraction = Annotated[float, Field(ge=MINIMUM, le=1)]


class _Field(Section):
    """Base class of all stiffness fields."""

    def fractions(self, x: NDArray, means: NDArray, canvas: Canvas) -> NDArray[np.float64]:
        """Return the fraction of E at each particle [P].

        Args:
            x: Particles at rest [P,3], m.
            means: Centres of the object's Gaussians [N,3], m.
            canvas: The front of the object, over which pictures are painted.

        Raises:
            InputError: If a file cannot be used.
        """
        raise NotImplementedError


class Gradient(_Field):
    """A fraction of E that varies linearly between the ends of the object, as in a plant."""

    kind: Literal["gradient"] = "gradient"
    axis: Literal["x", "y", "z"] = "z"
    """Axis along which the stiffness varies."""
    first: Fraction = 1.0
    """Fraction of E at the lowest end of the axis."""
    last: Fraction = 0.1
    """Fraction of E at the highest end of the axis."""

    def fractions(self, x: NDArray, means: NDArray, canvas: Canvas) -> NDArray[np.float64]:
        """Return the fraction of E at each particle [P]; it varies linearly along an axis of the
        object.
        """
        axis = "xyz".index(self.axis)
        ends = [means[:, axis].min(), means[:, axis].max()]
        return np.interp(x[:, axis].astype(np.float64), ends, [self.first, self.last])


class Picture(_Field):
    """A fraction of E that is defined by a grey image over the object's image; white is stiff."""

    kind: Literal["picture"] = "picture"
    file: FileName = Field(examples=["stiff.png"])
    """File of a grey picture that shows the object from the front."""
    black: Fraction = 0.1
    """Fraction of E at black pixels."""
    white: Fraction = 1.0
    """Fraction of E at white pixels."""

    def fractions(self, x: NDArray, means: NDArray, canvas: Canvas) -> NDArray[np.float64]:
        """Return the fraction of E at each particle [P]; it is linear in the grey value of the
        picture.
        """
        grey = sample_brightness(x, self.file, canvas, field="stiffness.file")
        return self.black + grey * (self.white - self.black)


AnyStiffness = Annotated[Gradient | Picture, Field(discriminator="kind")]
SOFTEST, STIFFEST = 0.01, 100.0
"""Smallest and largest factor on E in a profile over time."""


def check_profile(profile: Table) -> None:
    """Check that all factors of a profile over time are between `SOFTEST` and `STIFFEST`.

    Raises:
        ValueError: If a factor is outside this range.
    """
    factors = profile.table()[1]
    if not (factors.min() >= SOFTEST and factors.max() <= STIFFEST):
        range_ = f"from {factors.min():g} to {factors.max():g}"
        raise ValueError(
            f"factors {range_} are outside the range {SOFTEST:g} to {STIFFEST:g}; choose factors "
            "in this range"
        )
