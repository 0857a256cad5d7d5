"""Photographs in HEIC, the format of many phones.

They are decoded by libheif (package pi-heif, extra `heic`) in a separate process: it is native code
that reads untrusted data, so that a crash or an endless loop affects one picture only.
"""

from __future__ import annotations

import os
import re
import struct
from contextlib import suppress
from importlib.util import find_spec

from PIL import Image, ImageOps

from phy124.runtime import isolated

BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1")
"""Brands that identify such files, in bytes 8 to 11."""
EXTENT = re.compile(rb"ispe\0{4}(.{8})", re.DOTALL)
"""Width and height of a picture in the file; the decoded picture must not be larger."""
DEADLINE = isolated.Deadline(30.0)
"""Time limit of decoding, s; a photograph of 12 million pixels takes one second."""
MEMORY = 2 << 30
"""Memory limit of decoding, bytes."""


def is_heic(path: str | os.PathLike[str]) -> bool:
    """Whether the first bytes of a file say that it is HEIC."""
    with open(path, "rb") as file:
        head = file.read(12)
    return head[4:8] == b"ftyp" and head[8:] in BRANDS


def is_readable() -> bool:
    """Whether the package that reads HEIC is installed."""
    return find_spec("pi_heif") is not None


def size_of(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Width and height of the largest picture named in the header; nothing is decoded.

    Raises:
        ValueError: If the header names no picture.
    """
    with open(path, "rb") as file:
        named = [struct.unpack(">II", found[1]) for found in EXTENT.finditer(file.read())]
    if not named:
        raise ValueError("its header names no picture")
    return max(named, key=lambda size: size[0] * size[1])


def decode(path: str | os.PathLike[str], side: int) -> tuple[Image.Image, tuple[int, int]]:
    """The upright picture in RGBA, no longer than `side`, and its original size.

    The caller must have checked `size_of` first.

    Raises:
        ValueError: If the file cannot be decoded.
    """
    try:
        return isolated.run(_decoded, os.fspath(path), side, deadline=DEADLINE)
    except (isolated.Unfinished, RuntimeError, MemoryError, OSError) as error:
        raise ValueError(f"decoding failed: {str(error).strip()}") from error


def _decoded(path: str, side: int) -> tuple[Image.Image, tuple[int, int]]:
    """The part of `decode` that runs in the separate process."""
    import pi_heif

    with suppress(ImportError, OSError, ValueError):  # not on every platform
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    Image.MAX_IMAGE_PIXELS = None
    pi_heif.register_heif_opener(thumbnails=False, depth_images=False, aux_images=False)
    with Image.open(path, formats=("HEIF",)) as opened:
        picture = ImageOps.exif_transpose(opened).convert("RGBA")
    size, picture.info = picture.size, {}
    picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    return picture, size
