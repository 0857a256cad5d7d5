"""Declares the options of a fit: observations, object, scene, and the values to fit."""

from __future__ import annotations

import os
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator

from phy124.errors import InputError
from phy124.scene.files import read_toml
from phy124.schema.refusals import validate
from phy124.schema.section import Section
from phy124.studies.sweep.declaration import LogUniform, Uniform

SETTINGS = ("accuracy", "checks", "seed", "time", "view")
"""Fields of a scene that describe the computation and the pictures, not the observed motion."""
DECADE = 10.0
"""Smallest ratio of a range's ends at which the range is sampled logarithmically."""


def parse_range(data: Any) -> Any:
    """Convert text such as 1e4..1e6 to the plain data of a range; return other data unchanged.

    Raises:
        ValueError: The text does not describe a range.
    """
    if not isinstance(data, str):
        return data
    try:
        low, high = (float(end) for end in data.split(".."))
    except ValueError:
        raise ValueError("it is not a range. Write, for example, 1e4..1e6.") from None
    if not low < high:
        raise ValueError(f"{low:g} is not smaller than {high:g}. Give the smaller number first.")
    log = low > 0 and high >= DECADE * low
    return {"log_uniform" if log else "uniform": (low, high)}


def _kind(data: Any) -> str:
    """Return the tag of a range; the type with the tag "even" also refuses invalid data."""
    log = isinstance(data, LogUniform) or (isinstance(data, dict) and "log_uniform" in data)
    return "log" if log else "even"


Range = Annotated[
    Annotated[
        Annotated[LogUniform, Tag("log")] | Annotated[Uniform, Tag("even")], Discriminator(_kind)
    ],
    BeforeValidator(parse_range),
]
Cells = Annotated[int, Field(ge=4, le=256)]


class Fit(Section):
    """The options of a fit: the values to fit, and the observations."""

    target: str
    """Observations of the motion: a clip or its folder, a .csv file of tracked points, or a video
    or a folder of pictures.
    """
    object: str | None = None
    """Picture or file of Gaussians, or a clip whose first frame shows the object at rest. Default:
    the object of the target, if the target is a clip.
    """
    scene: str | None = None
    """Preset or .toml file of the scene. Default: the scene of the clip if there is one, otherwise
    press.
    """
    set: dict[str, Any] = Field(default={})
    """Other values to set in the scene, by dotted path."""
    find: dict[str, Range] = Field(min_length=1, max_length=8)
    """Ranges of the values to fit: dotted path in the scene -> range, such as "1e4..1e6"."""
    forces: str | None = None
    """A .csv file of measured forces on walls, with columns time, wall, fx, fy, fz."""
    side: str = "front"
    """View or camera from which the pixels or the video were recorded."""
    fps: float | None = Field(default=None, gt=0, le=1000)
    """Frames per second of a video or folder [1/s]. Default: the rate in the file if it has one,
    otherwise the rate of the scene.
    """
    align: bool = False
    """Align the video's first frame with the object at rest; use this if the camera is unknown."""
    gaussians: int | None = Field(default=None, ge=1)
    """Maximum number of Gaussians of the object."""
    grids: tuple[Cells, ...] = Field(default=(16, 24), min_length=1, max_length=4)
    """Number of cells across the object on each grid. The first grid is used for the search, and
    further grids refine the result.
    """
    seconds: float = Field(default=300.0, ge=1, le=1e7)
    """Maximum duration of the fit [s]."""
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    """Seed of the random numbers that the search and the bootstrap of the intervals use."""

    @field_validator("find")
    @classmethod
    def _observable(cls, find: dict[str, Range]) -> dict[str, Range]:
        for path in find:
            if path.partition(".")[0] in SETTINGS:
                raise ValueError(
                    f"{path} is a setting of the run, not a property of the observed motion; "
                    "choose a value of a material, a force, a boundary or an object"
                )
        return find

    @field_validator("grids")
    @classmethod
    def _finer(cls, grids: tuple[int, ...]) -> tuple[int, ...]:
        if list(grids) != sorted(set(grids)):
            raise ValueError("each grid must be finer than the one before it; sort the grids")
        return grids

    @classmethod
    def from_data(cls, data: dict[str, Any], source: str = "fit") -> Fit:
        """Validate plain data and return the options.

        Raises:
            InputError: The data declares no fit; the message names field, value, limit and remedy.
        """
        return validate(cls, data, source)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> dict[str, Any]:
        """Read the plain data of a fit from a file.

        Raises:
            InputError: The file is missing or is not valid TOML.
        """
        return read_toml(path, "fit")


def parse_ranges(texts: tuple[str, ...]) -> dict[str, str]:
    """Split texts such as material.E=1e4..1e6 into paths and ranges.

    Raises:
        InputError: A text does not have this form, or a path occurs twice.
    """
    ranges: dict[str, str] = {}
    for text in texts:
        path, equals, limits = (part.strip() for part in text.partition("="))
        if not (path and equals):
            limit = "it is not PATH=LEAST..LARGEST."
            raise InputError("find", text, limit, "Write, for example, material.E=1e4..1e6.")
        if path in ranges:
            raise InputError("find", text, f"{path} occurs twice.", "Give each path once.")
        ranges[path] = limits
    return ranges
