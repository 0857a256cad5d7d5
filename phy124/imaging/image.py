"""Opens images upright and within size limits, and recentres them for the networks.

Images are straight (not premultiplied) RGBA in sRGB with 8 bits per channel. A separate process
decodes the files (`decoding.py`).
"""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from stat import S_ISREG

import numpy as np
from numpy.typing import NDArray
from PIL import Image, features

from phy124.errors import InputError
from phy124.imaging import codecs
from phy124.imaging.decoding import (
    COPY,
    Purpose,
    Unusable,
    check_size,
    decode,
    explain_unidentified,
)
from phy124.imaging.header import Size, read_kind, read_size
from phy124.io.opening import obstacle, stand_in
from phy124.runtime import isolated
from phy124.runtime.installation import install_command

MAX_BYTES = 50_000_000
MIN_SIDE = 8
LOOK_SIDE = 320
"""Longest side to which an image is reduced if it is segmented without a network [pixels]."""
FAINT = 3
"""An image is blank if all its colour values differ by less than this number."""
WORK_SIDE = 2048
"""Longest side to which images are reduced [pixels]; generators cannot use more detail."""
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
FORMATS = ("PNG", "JPEG", "WEBP", "AVIF")
ANY_FORMAT = (*FORMATS, "GIF", "BMP", "TIFF", "PPM")
"""Formats accepted for masks and maps, in addition to HEIC."""
PHOTOGRAPH = Purpose(FORMATS, MIN_SIDE)
MEMORY = 2 << 30
DEADLINE = isolated.Deadline(30.0)
"""Time limit for decoding an image. A photograph of 12 million pixels takes one second."""


def open_image(
    path: str | os.PathLike[str], *, field: str = "image", deadline: isolated.Deadline = DEADLINE
) -> Image.Image:
    """Open a photograph upright, as RGBA in sRGB, with sides of at most `WORK_SIDE` pixels.

    If the file is an animation, only the first frame is used. The `info` of the result contains the
    number of `frames`, the `size` of the upright image before it was reduced, and `notes` about
    ignored parts of the file.

    Args:
        path: The image file, or a pipe.
        field: Name of the image in error messages.
        deadline: Time limit for decoding (at most `DEADLINE`), which can also be used to cancel it.

    Raises:
        InputError: If the file is missing, too large, of an unsupported format, or damaged.
    """
    return _open(path, field, PHOTOGRAPH, deadline)


def open_mask(
    path: str | os.PathLike[str], *, field: str = "mask", minimum: int = MIN_SIDE
) -> Image.Image:
    """Open a mask or map like `open_image`, in more formats and without the colour profile.

    Raises:
        InputError: If the file is missing, too large, of an unsupported format, or damaged.
    """
    return _open(path, field, Purpose(ANY_FORMAT, minimum, colours=False), DEADLINE)


def open_levels(path: str | os.PathLike[str], *, field: str) -> NDArray[np.float32 | np.uint8]:
    """Open an image upright with all its grey levels [H,W], reduced to at most `WORK_SIDE` pixels.

    Raises:
        InputError: If the file is missing, too large, of an unsupported format, or damaged.
    """
    purpose = Purpose(ANY_FORMAT, MIN_SIDE, colours=False, deep=True)
    return np.asarray(_open(path, field, purpose, DEADLINE))


def read_picture_size(path: str | os.PathLike[str], *, field: str = "image") -> Size:
    """Return the width and height of a photograph from its header.

    Raises:
        InputError: If the file is missing, too large, of an unsupported format, or has a damaged
            header.
    """
    try:
        return _read_stated_size(_read(Path(path)), FORMATS)
    except Unusable as error:
        raise InputError(field, path, *error.args) from None


def original_size(image: Image.Image) -> tuple[int, int]:
    """Return the width and height before the image was reduced."""
    return image.info.get("size", image.size)


def reduce_size(shape: tuple[int, ...], longest: int, least: int = 1) -> Size:
    """Return the width and height at which no side of an image [H,W,...] exceeds `longest`."""
    height, width = shape[:2]
    scale = min(1.0, longest / max(height, width))
    return max(least, round(width * scale)), max(least, round(height * scale))


def shrink(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reduce an image [H,W,3] so that its longest side has at most `LOOK_SIDE` pixels."""
    import cv2

    size = reduce_size(rgb.shape, LOOK_SIDE, 8)
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def is_blank(rgb: NDArray[np.uint8]) -> bool:
    """Whether all pixels of an image [H,W,3] have nearly the same colour."""
    return int(np.ptp(shrink(rgb), axis=(0, 1)).max()) < FAINT


def normalise(
    image: NDArray, mean: Sequence[float] = MEAN, std: Sequence[float] = STD
) -> NDArray[np.float32]:
    """Return an image [H,W,3], 0..1, as a network's input [1,3,H,W]: (image - mean) / std."""
    normal = (image - np.array(mean)) / np.array(std)
    return np.ascontiguousarray(normal.transpose(2, 0, 1)[None], np.float32)


def recenter(image: NDArray, mask: NDArray, *, border_ratio: float = 0.2) -> NDArray:
    """Centre the object, which is marked by a mask, in a square image.

    Every pixel is equal to the result of LGM's program (Tang et al. 2024, kiui `recenter`). As in
    LGM, the bounding box does not include the last row and column, and numbers are truncated to
    integers.

    Args:
        image: Image [H,W,3] or [H,W,4], uint8 or float in 0..1.
        mask: Mask [H,W], nonzero on the object.
        border_ratio: Fraction of the square's side that stays free.

    Returns:
        Image [S,S,C] of the same type, S = max(H, W); the free part is white (C = 3) or transparent
            black (C = 4).

    Raises:
        InputError: If the mask covers less than two pixels along an axis.
    """
    import cv2

    values = image.astype(np.float32) / 255 if image.dtype == np.uint8 else image
    size, channels = max(image.shape[:2]), image.shape[2]
    rows, columns = np.nonzero(mask)
    if not len(rows) or rows.min() == rows.max() or columns.min() == columns.max():
        remedy = "Use a picture that shows a larger part of the object."
        raise InputError(
            "mask", "empty", "The mask contains no object that could be centred.", remedy
        )
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


def _open(
    path: str | os.PathLike[str], field: str, purpose: Purpose, deadline: isolated.Deadline
) -> Image.Image:
    path = Path(path)
    try:
        data = _read(path)
        if purpose is PHOTOGRAPH or read_kind(data):
            # These formats are refused before a process is started; the decoder checks the other
            # formats.
            check_size(_read_stated_size(data, purpose.formats), purpose.minimum)
        limit = deadline._replace(seconds=min(deadline.seconds, DEADLINE.seconds))
        made = isolated.run(decode, data, purpose, WORK_SIDE, deadline=limit, memory=MEMORY)
    except Unusable as error:
        raise InputError(field, path, *error.args) from None
    except MemoryError:
        limit = f"Decoding it takes more than {MEMORY >> 30} GB of memory."
        raise InputError(field, path, limit, "Reduce the size of the picture.") from None
    except isolated.Unfinished as error:
        why = str(error).partition(" (")[0]
        raise InputError(field, path, f"The file is broken: decoding it {why}.", COPY) from error
    made.picture.info = {"frames": made.frames, "size": made.size, "notes": made.notes}
    return made.picture


def _read(path: Path) -> bytes:
    try:
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            if S_ISREG(status.st_mode):
                _check_bytes(status.st_size)
            data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: the path contains a NUL byte
        words = obstacle(path) or (f"it cannot be read ({error}).", "Copy the file again.")
        raise _refusal(*words) from None
    _check_bytes(len(data))
    if words := stand_in(data):
        raise _refusal(*words)
    return data


def _refusal(limit: str, remedy: str) -> Unusable:
    return Unusable(limit[0].upper() + limit[1:], remedy)


def _check_bytes(size: int) -> None:
    if size == 0:
        raise Unusable("It is empty (0 bytes).", COPY)
    if size > MAX_BYTES:
        limit = f"It has {size / 1e6:.0f} MB; the limit is {MAX_BYTES / 1e6:.0f} MB."
        raise Unusable(limit, "Save the picture as JPEG, or reduce it.")


def _read_stated_size(data: bytes, formats: tuple[str, ...]) -> Size:
    kind = read_kind(data)
    if kind is None:
        raise explain_unidentified(data, formats)
    if kind == "HEIC" and not codecs.can_read_heic():
        remedy = f"Install it ({install_command('heic')}), or save the picture as JPEG."
        raise Unusable("The file is a HEIC picture, which requires the package pi-heif.", remedy)
    if kind == "AVIF" and not can_read_avif():
        limit = "It is an AVIF picture, which this installation of Pillow cannot read."
        raise Unusable(limit, "Install Pillow 11.3 or later, or save the picture as JPEG.")
    try:
        return read_size(data)
    except ValueError as error:
        raise Unusable(f"The file is broken or cut short ({error}).", COPY) from None


def can_read_avif() -> bool:
    """Whether the installed version of Pillow can read AVIF."""
    with warnings.catch_warnings():
        # Pillow before 11.3 warns that it does not know this feature
        warnings.simplefilter("ignore")
        return bool(features.check("avif"))
