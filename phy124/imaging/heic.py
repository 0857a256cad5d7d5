"""Photographs in HEIC, the format of many phones, decoded by libheif (package pi-heif)."""

from __future__ import annotations

import io
from importlib.util import find_spec

from PIL import Image


def is_readable() -> bool:
    """Whether the package that reads HEIC is installed."""
    return find_spec("pi_heif") is not None


def opened(data: bytes) -> Image.Image:
    """The picture, turned as the file's own header states; libheif does not look at EXIF for it.

    Raises:
        Exception: Of any type, if the file is damaged.
    """
    import pi_heif

    file = pi_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=True)
    picture = file.to_pillow()
    picture.info.pop("exif", None)
    picture.info.pop("xmp", None)
    return picture
