"""Optional inputs besides the front image: a depth map, and images of other sides."""

import os
from collections.abc import Callable
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field, field_validator

from phy124.errors import InputError
from phy124.imaging.cutout import Cutout
from phy124.imaging.decoding import MAX_PIXELS
from phy124.imaging.depth import NETWORKS, DepthNetwork, choose_network
from phy124.imaging.image import open_levels
from phy124.io.opening import obstacle
from phy124.schema.section import Section
from phy124.weights.store import require

RANGE = (1e-18, 1e18)
"""Range of the largest value of a depth map for computations with float32 numbers."""
ASPECT = 0.02
"""Largest relative difference between the aspect ratios of a depth map and its image."""


class DepthMap(Section):
    """Options that determine the depth of the object's front."""

    depth: str = "auto"
    """Depth of the picture, from which relief shapes the object's front: auto (moge2 or
    depth-anything, if the weights are present), moge2, depth-anything, off, or a file with a depth
    map (grey PNG of 8 or 16 bits, or .npy).
    """
    near: Literal["white", "black"] = "white"
    """Brightness of near surfaces in the depth map: white (large values are near, as in MiDaS and
    Depth Anything) or black (small values are near, as in depths in metres).
    """

    @field_validator("depth", mode="before")
    @classmethod
    def _accept_paths(cls, value: Any) -> Any:
        return str(value) if isinstance(value, os.PathLike) else value

    @property
    def path(self) -> Path | None:
        """Path of the depth map; None if a network estimates the depth, or if no depth is used."""
        return None if self.depth in ("auto", "off", *NETWORKS) else Path(self.depth)

    def bind(self, generator: Any, name: str) -> Any:
        """Return a generator that uses the depth map, or a network if the depth is to be estimated.

        Raises:
            InputError: If the generator cannot use a depth map, or the file of the map is unusable,
                or `near` is given without a file.
        """
        if self.path is None and self.near != "white":
            limit = "It describes a depth map from a file, but there is none."
            raise InputError("near", self.near, limit, "Set depth to the file, or remove near.")
        usable = "depth" in signature(generator).parameters
        if self.depth == "off":
            return generator
        if self.depth == "auto":
            network = choose_network() if usable else None
            return generator if network is None else partial(generator, depth=network)
        if not usable:
            limit = f"{name} does not use a depth map."
            raise InputError("depth", self.depth, limit, "Remove this option, or choose relief.")
        if self.path is None:
            require(self.depth)
            return partial(generator, depth=DepthNetwork(self.depth))
        values = read_depth(self.path)
        return partial(generator, depth=values if self.near == "white" else -values)


def read_depth(path: Path) -> NDArray[np.float32]:
    """Read a depth map [H,W] from its file.

    If the values are outside `RANGE`, they are divided by the largest value.

    Raises:
        InputError: If the file is missing or damaged, is not a single image, or contains values
            that are not finite.
    """
    values = _array(path) if path.suffix.lower() == ".npy" else open_levels(path, field="depth")
    if values.ndim != 2 or min(values.shape) < 2 or values.dtype.kind not in "fiu":
        limit = f"It contains values of type {values.dtype} in an array of shape {values.shape}."
        raise InputError(
            "depth", path, limit, "Save one number per pixel, as an array [height, width]."
        )
    if not np.isfinite(values).all():
        limit = "Some of its values are not finite."
        raise InputError(
            "depth", path, limit, "Replace values that are not finite by the largest depth."
        )
    values = values.astype(np.float64)
    largest = float(np.abs(values).max())
    if largest > 0 and not RANGE[0] < largest < RANGE[1]:
        values /= largest
    return values.astype(np.float32)


def fit_to_picture(depth: NDArray, width: int, height: int) -> NDArray[np.float32]:
    """Resize a depth map to the size of an image; return [H,W].

    Raises:
        InputError: If the aspect ratios of map and image differ.
    """
    rows, columns = depth.shape
    if abs(columns * height / (rows * width) - 1) > ASPECT:
        limit = f"It has {columns} x {rows} pixels, but the picture has {width} x {height}."
        raise InputError("depth", "map", limit, "Give a depth map that covers the whole picture.")
    small = Image.fromarray(np.ascontiguousarray(depth, np.float32))
    return np.asarray(small.resize((width, height), Image.Resampling.BILINEAR))


def _array(path: Path) -> NDArray:
    if hindrance := obstacle(path):
        raise InputError("depth", path, *hindrance)
    try:
        if path.stat().st_size > 8 * MAX_PIXELS:
            raise ValueError("it is too large")
        values = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        limit = f"It is not an array ({error})."
        raise InputError("depth", path, limit, "Save it with numpy.save.") from error
    return np.squeeze(values)


class OtherViews(Section):
    """Options for images of other sides, the look of the back, the shape and highlights."""

    side: Path | None = None
    """Picture of the same object, seen from one side at the object's height. From this picture,
    relief determines how deep the object is at each height.
    """
    facing: Literal["left", "right"] = "left"
    """Direction in which the object's front points in the picture from the side: left (as in view
    `right`) or right.
    """
    back: Path | None = None
    """Picture of the same object, taken from straight behind, for the back of the object."""
    back_look: Literal["auto", "mirror", "plain"] = "auto"
    """Colours of the back if there is no picture of the back: mirror (the mirrored front, for an
    object seen from its side), plain (the materials of the front without its features) or auto
    (plain if the outline is symmetric, otherwise mirror). It has no effect on vessels, rings,
    boxes and tables that relief recognises.
    """
    thickness: float | None = Field(default=None, ge=0.05, le=4.0)
    """Factor by which the depth that relief guesses is multiplied, such as 0.6 for a flat fish."""
    shape: Literal["auto", "round", "upright", "flat"] = "auto"
    """Kind of object, if relief guesses it wrongly: round (as deep as its parts are wide, such as
    an animal), upright (round when seen from above, such as a cup or a lamp), flat (a thin sheet,
    such as a leaf or a shirt) or auto (as the picture shows).
    """
    photo_elevation: float | None = Field(default=None, ge=0.0, le=80.0)
    """Angle above the horizontal from which the picture was taken [degrees], such as 25 for an
    object on a table. relief turns the object upright by this angle. Default: estimated for a
    vessel, a ring or a box, and 0 for other objects.
    """
    highlights: Literal["keep", "remove"] = "keep"
    """Treatment of highlights in the pictures: keep (highlights are painted on the object and move
    with it) or remove.
    """

    @property
    def pictures(self) -> dict[str, Path]:
        """Paths of the images, by the name of the option."""
        files = {"side": self.side, "back": self.back}
        return {name: path for name, path in files.items() if path is not None}

    def bind(self, generator: Any, name: str, cut: Callable[[str, Path], Cutout]) -> Any:
        """Return a generator that uses these images and options.

        Args:
            generator: The generator that gets the inputs.
            name: Name of the generator, for messages.
            cut: Function that opens an option's image and removes the background.

        Raises:
            InputError: If the generator does not support an input, or an image is unusable, or
                `facing` is given without `side`.
        """
        if self.side is None and self.facing != "left":
            limit = "It describes the picture from the side, but there is none."
            raise InputError("facing", self.facing, limit, "Set side, or remove facing.")
        known = signature(generator).parameters
        options: dict[str, Any] = dict(self.pictures)
        choices = self.model_dump(exclude_defaults=True, exclude={*options, "facing"})
        options.update(choices)
        for field, value in options.items():
            if field not in known:
                limit = f"{name} does not use it."
                raise InputError(field, value, limit, "Remove this option, or choose relief.")
        cuts = {field: cut(field, path).picture for field, path in self.pictures.items()}
        facing = {"facing": self.facing} if self.side else {}
        return partial(generator, **{**options, **cuts, **facing}) if options else generator
