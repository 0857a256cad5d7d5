"""What a visitor's object is made of: a picture, or a file of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from phy124.errors import InputError
from phy124.imaging.objects import Point
from phy124.io.dialect import Axes


@dataclass(frozen=True)
class Cutout:
    """A picture with its object cut out."""

    path: str
    picture: str
    """The uploaded picture in a format that browsers can show."""
    doubts: tuple[str, ...] = ()
    """Reasons to doubt that the right object was found; shown once."""
    by: str = ""
    """What cut it out, for a sentence."""
    pick: Point | None = None
    """The place on it that was clicked."""


@dataclass(frozen=True)
class GaussianFile:
    """A file of Gaussians that has been read (`demo.gaussian_files`)."""

    path: str
    """The Gaussians that are kept of it, as a PLY in its own axes."""
    format: str
    """What its format is called."""
    count: int
    """Number of Gaussians in `path`."""
    axes: Axes
    """Which of its axes most likely point up and to the front."""
    notes: tuple[str, ...] = ()
    """What was left out, as sentences."""

    @property
    def pictures(self) -> Path:
        """The folder with a picture of each orientation, by `way`."""
        return Path(self.path).parent

    @property
    def picture(self) -> str:
        """The picture of the most likely orientation."""
        return str(self.pictures / way(self.axes.up, self.axes.front))


def way(up: str, front: str) -> str:
    """Name of the picture of an orientation."""
    return f"{up}_{front}.webp"


Source = Cutout | GaussianFile


def is_there(source: Source | None) -> bool:
    """Whether there is a source, and its file has not been removed."""
    return source is not None and Path(source.path).exists()


def missing(source: Source | None) -> InputError:
    """The error of a request without a picture, or with one whose file has been removed."""
    if source is None:
        return InputError("image", "none", "There is no picture yet.", "Choose one first.")
    limit = "Your picture is no longer kept here."
    return InputError("image", "gone", limit, "Choose it once more.")
