"""A depth map of the picture, as any monocular depth network writes it."""

from __future__ import annotations

from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field

from phy124.errors import InputError
from phy124.imaging.decoding import MAX_PIXELS
from phy124.imaging.image import open_levels
from phy124.io.opening import obstacle
from phy124.schema.section import Section

ASPECT = 0.02
"""How much width to height may differ from the picture's, as a fraction."""


class DepthMap(Section):
    """Which depth map to use, and how it is meant."""

    depth: Path | None = Field(
        default=None,
        description="Depth map of the picture, from any network: a grey PNG of 8 or 16 bits, or a "
        ".npy file; gives the front of what relief makes its shape.",
    )
    near: Literal["white", "black"] = Field(
        default="white",
        description="What is near in the depth map: white (large values, as MiDaS and Depth "
        "Anything write them) or black (as in metres).",
    )

    def given_to(self, generator: Any, name: str) -> Any:
        """The generator, told of this depth map if there is one.

        Raises:
            InputError: If it cannot use one, or the file cannot be used.
        """
        if self.depth is None:
            return generator
        if "depth" not in signature(generator).parameters:
            limit = f"{name} does not use one."
            raise InputError("depth", self.depth, limit, "Leave it out, or choose relief.")
        values = read(self.depth)
        return partial(generator, depth=values if self.near == "white" else -values)


def read(path: Path) -> NDArray[np.float32]:
    """Values [H,W] of a depth map.

    Raises:
        InputError: If it is missing, broken, no single picture, or not finite.
    """
    values = _array(path) if path.suffix.lower() == ".npy" else open_levels(path, field="depth")
    if values.ndim != 2 or min(values.shape) < 2 or values.dtype.kind not in "fiu":
        limit = f"It holds {values.dtype} values of shape {values.shape}."
        raise InputError("depth", path, limit, "Save one number per pixel, [height, width].")
    if not np.isfinite(values).all():
        limit = "Some of its values are not finite."
        raise InputError("depth", path, limit, "Replace them, by the farthest value say.")
    return values.astype(np.float32)


def fitted(depth: NDArray, width: int, height: int) -> NDArray[np.float32]:
    """A depth map [H,W] in the size of the picture.

    Raises:
        InputError: If it has other proportions.
    """
    rows, columns = depth.shape
    if abs(columns * height / (rows * width) - 1) > ASPECT:
        limit = f"It has {columns} x {rows} pixels, the picture {width} x {height}."
        raise InputError("depth", "map", limit, "Give the depth map of the whole picture.")
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
        limit = f"It is no array ({error})."
        raise InputError("depth", path, limit, "Save it with numpy.save.") from error
    return np.squeeze(values)
