"""Photographs in HEIC, as phones take them.

They are decoded by libheif (package pi-heif, extra `heic`) in a process of its own: it is native
code on a stranger's data, and a fault or an endless loop in it costs no more than one picture.
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
"""How such files call themselves, in bytes 8 to 11."""
EXTENT = re.compile(rb"ispe\0{4}(.{8})", re.DOTALL)
"""Width and height of one of the pictures in the file; what it decodes to must not be larger."""
DEADLINE = isolated.Deadline(30.0)
"""A photograph of 12 million pixels takes one second."""
MEMORY = 2 << 30
"""Most memory for decoding, bytes."""


def is_heic(path: str | os.PathLike[str]) -> bool:
    """Whether a file says in its first bytes that it is one."""
    with open(path, "rb") as file:
        head = file.read(12)
    return head[4:8] == b"ftyp" and head[8:] in BRANDS


def is_readable() -> bool:
    """Whether the package that reads them is installed."""
    return find_spec("pi_heif") is not None


def size_of(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Width and height of the largest picture that the header names; nothing is decoded.

    Raises:
        ValueError: It names none.
    """
    with open(path, "rb") as file:
        named = [struct.unpack(">II", found[1]) for found in EXTENT.finditer(file.read())]
    if not named:
        raise ValueError("its header names no picture")
    return max(named, key=lambda size: size[0] * size[1])


def decode(path: str | os.PathLike[str], side: int) -> tuple[Image.Image, tuple[int, int]]:
    """The upright picture in RGBA, no longer than `side`, and the size that it had.

    Whoever calls it has looked at `size_of`.

    Raises:
        ValueError: The file cannot be decoded.
    """
    try:
        return isolated.run(_decoded, os.fspath(path), side, deadline=DEADLINE)
    except (isolated.Unfinished, RuntimeError, MemoryError, OSError) as error:
        raise ValueError(f"decoding failed: {str(error).strip()}") from error


def _decoded(path: str, side: int) -> tuple[Image.Image, tuple[int, int]]:
    """In the process of its own."""
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
