"""TIFF, for masks and maps, of whose metadata nothing but the orientation is read."""

from __future__ import annotations

import io
from contextlib import suppress

from PIL.TiffImagePlugin import TiffImageFile

BEGINNINGS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF."""


def opened(data: bytes) -> TiffImageFile:
    """The first picture, not decoded yet."""
    picture = PlainTiff(io.BytesIO(data))
    with suppress(Exception):  # Of many types, if EXIF is damaged.
        picture.getexif()  # is kept for later: once decoded, the file is closed
    return picture


class PlainTiff(TiffImageFile):
    """A TIFF as stored: Pillow would turn it, and read EXIF for that, which may be damaged."""

    def load_end(self) -> None:
        """Does nothing after decoding."""
