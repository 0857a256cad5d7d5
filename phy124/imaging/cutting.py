"""Declares the options for segmenting the object of an image."""

from pathlib import Path
from typing import Any

from pydantic import Field

from phy124.errors import InputError
from phy124.imaging.cutout import METHODS
from phy124.imaging.objects import Point
from phy124.schema.section import Section


class Cutting(Section):
    """Options for segmenting the object of an image."""

    foreground: str = Field(
        default="auto", description=f"Method that segments the object: auto, {', '.join(METHODS)}."
    )
    mask: Path | None = None
    """Mask of the same size as the picture, white where the object is; the mask replaces the
    automatic cut-out.
    """
    pick: str | None = None
    """A point on the object to cut out, if the picture shows several objects: X,Y as fractions of
    width and height.
    """

    @property
    def point(self) -> Point | None:
        """The selected point, as fractions of width and height; None if no point was selected.

        Raises:
            InputError: If `pick` is not two numbers.
        """
        if self.pick is None:
            return None
        try:
            x, y = map(float, self.pick.split(","))
        except ValueError:
            limit, remedy = (
                "It is not a point in the picture.",
                "Give two fractions such as 0.3,0.5.",
            )
            raise InputError("pick", self.pick, limit, remedy) from None
        return x, y

    def arguments(self) -> dict[str, Any]:
        """Return the options as keyword arguments for `phy124.pipeline.make_gaussians`."""
        return {"method": self.foreground, "mask": self.mask, "pick": self.point}
