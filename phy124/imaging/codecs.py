"""Opens PNG, TIFF and HEIC without the metadata around the pixels, whose damage would stop Pillow.

HEIC, the format of many phones, is decoded by libheif (package pi-heif).
"""

from __future__ import annotations

import io
import struct
import zlib
from contextlib import suppress
from importlib.util import find_spec

from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

TIFF_BEGINNINGS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF."""
PNG_START = 8
"""Bytes of a PNG before its first chunk."""
CHUNK_FRAME = 12
"""Bytes of a PNG chunk besides its content: length, kind and checksum."""
TRANSPARENCY = b"tRNS"
"""The one chunk that readers may skip and that changes the pixels."""
USEFUL = (b"iCCP", b"eXIf", b"acTL", b"fcTL")
"""Chunks that readers may skip and that are read here; their checksum is corrected."""


def strip_png(data: bytes) -> bytes:
    """Return the same PNG with only the chunks of its pixels and those that are read.

    Pillow checks every chunk, and refuses a picture if one that it does not need is damaged.
    """
    kept, place = [data[:PNG_START]], PNG_START
    while place < len(data):
        end = place + CHUNK_FRAME + int.from_bytes(data[place : place + 4], "big")
        kind, chunk = data[place + 4 : place + 8], data[place:end]
        if kind == TRANSPARENCY or not kind[:1].islower():  # No reader may skip capital letters.
            kept.append(chunk)
        elif kind in USEFUL:
            kept += [chunk[:-4], struct.pack(">I", zlib.crc32(chunk[4:-4]))]
        place = len(data) if kind == b"IEND" else end
    return b"".join(kept)


class PlainTiff(TiffImageFile):
    """A TIFF as stored: Pillow would turn it, and read EXIF for that, which may be damaged."""

    def load_end(self) -> None:
        """Do nothing after decoding."""


def open_tiff(data: bytes) -> TiffImageFile:
    """Open the first picture of a TIFF; it is not decoded yet."""
    picture = PlainTiff(io.BytesIO(data))
    with suppress(Exception):  # Damaged EXIF raises many types.
        picture.getexif()  # Pillow keeps it; after decoding the file is closed.
    return picture


def can_read_heic() -> bool:
    """Return whether the package that reads HEIC is installed."""
    return find_spec("pi_heif") is not None


def open_heic(data: bytes) -> Image.Image:
    """Open a HEIC picture, turned as the file's header states; libheif ignores EXIF for that.

    Raises:
        Exception: Of any type, if the file is damaged.
    """
    import pi_heif

    file = pi_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=True)
    picture = file.to_pillow()
    picture.info.pop("exif", None)
    picture.info.pop("xmp", None)
    return picture
