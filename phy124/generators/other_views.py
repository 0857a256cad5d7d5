"""What is known of an object beside its front: further pictures, its depth, its lustre."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from phy124.errors import InputError
from phy124.imaging.cutout import Cutout
from phy124.schema.section import Section


class OtherViews(Section):
    """What is known of the object beside its picture from the front."""

    side: Path | None = Field(
        default=None,
        description="Picture of the same object from one side, level with it: relief then makes it "
        "as deep as that shows, and as high parts deep or thin.",
    )
    facing: Literal["left", "right"] = Field(
        default="left",
        description="Where the object's front is in the picture from the side: left (as view "
        "`right` shows it) or right.",
    )
    back: Path | None = Field(
        default=None,
        description="Picture of the same object from straight behind; relief paints its back so.",
    )
    thickness: float | None = Field(
        default=None,
        ge=0.05,
        le=4.0,
        description="Depth of the object, relative to what relief guesses: 0.6 makes a fish flat.",
    )

    highlights: Literal["keep", "remove"] = Field(
        default="keep",
        description="Highlights of the pictures: keep (relief paints them on the object, with "
        "which they turn) or remove.",
    )

    @property
    def pictures(self) -> dict[str, Path]:
        """The files that were given, by option."""
        files = {"side": self.side, "back": self.back}
        return {name: path for name, path in files.items() if path is not None}

    def given_to(self, generator: Any, name: str, cut: Callable[[str, Path], Cutout]) -> Any:
        """The generator, told of all this.

        Args:
            generator: The generator.
            name: What it is called.
            cut: Opens the picture of an option and cuts the object out.

        Raises:
            InputError: If the generator cannot use it, or a picture cannot be used.
        """
        known = signature(generator).parameters
        given: dict[str, Any] = dict(self.pictures)
        if self.thickness is not None:
            given["thickness"] = self.thickness
        if self.highlights == "remove":
            given["highlights"] = self.highlights
        for field, value in given.items():
            if field not in known:
                limit = f"{name} does not use it."
                raise InputError(field, value, limit, "Leave it out, or choose relief.")
        cuts = {field: cut(field, path).picture for field, path in self.pictures.items()}
        facing = {"facing": self.facing} if self.side else {}
        return partial(generator, **{**given, **cuts, **facing}) if given else generator
