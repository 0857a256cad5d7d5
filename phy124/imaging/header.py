"""Reads the format and the size of an image from its header, without decoding it.

The code is plain Python with bounded loops, so it can safely read untrusted files in any process.
"""

import re
import struct

KINDS = ("PNG", "JPEG", "WEBP", "AVIF", "HEIC")
"""Names of the formats in Pillow, except for HEIC."""
HEVC = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs")
AV1 = (b"avif", b"avis")
GENERAL = (b"mif1", b"msf1")
"""HEIC and AVIF files may both have these brands; their compatible brands differ."""
MOST_BRANDS = 64
HEAD = 16 + 4 * MOST_BRANDS
"""Number of bytes at the start of a file that identify its format."""
MOST_SEGMENTS = 100_000
"""Largest number of searched segments; photographs have up to a few hundred."""
SEGMENT = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])", re.DOTALL)
"""The bytes 00 and D0 to D7 belong to the image data.

The pattern matches only the last of several FF bytes, because a search for FF+ could take quadratic
time.
"""
SIZES = frozenset({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
EXTENT = re.compile(rb"ispe\0{4}(.{8})", re.DOTALL)
"""Pattern of the width and height in HEIC and AVIF files."""
Size = tuple[int, int]


def read_kind(data: bytes) -> str | None:
    """Return the format of an image, which is one of `KINDS`, or None."""
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return "PNG"
    if data[:3] == b"\xff\xd8\xff":
        return "JPEG"
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return "WEBP"
    return _read_brand(data) if data[4:8] == b"ftyp" else None


def _read_brand(data: bytes) -> str | None:
    """Return None if the file is a video."""
    major, end = data[8:12], min(int.from_bytes(data[:4], "big"), HEAD)
    others = [data[place : place + 4] for place in range(16, end, 4)]
    if major in AV1 or (major in GENERAL and any(brand in AV1 for brand in others)):
        return "AVIF"
    return "HEIC" if major in (*HEVC, *GENERAL) else None


def read_size(data: bytes) -> Size:
    """Return the width and height of the largest image that the header states.

    Raises:
        ValueError: If the format is unknown, or the header contains no size.
    """
    readers = {"PNG": _png, "JPEG": _jpeg, "WEBP": _webp, "HEIC": _largest, "AVIF": _largest}
    try:
        size = readers[read_kind(data) or ""](data)
    except (LookupError, struct.error):
        size = None
    if size is None:
        raise ValueError("the header does not state the size")
    return size


def _png(data: bytes) -> Size | None:
    return struct.unpack(">II", data[16:24]) if data[12:16] == b"IHDR" else None


def _jpeg(data: bytes) -> Size | None:
    place = 2
    for _ in range(MOST_SEGMENTS):
        segment = SEGMENT.search(data, place)
        if segment is None:
            return None
        start = segment.end()
        if segment[1][0] in SIZES:
            height, width = struct.unpack(">HH", data[start + 3 : start + 7])
            return width, height
        place = start + int.from_bytes(data[start : start + 2], "big")
    return None


def _webp(data: bytes) -> Size | None:
    kind = data[12:16]
    if kind == b"VP8X" and len(data) >= 30:
        width, height = data[24:27], data[27:30]
        return int.from_bytes(width, "little") + 1, int.from_bytes(height, "little") + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack("<I", data[21:25])
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack("<HH", data[26:30])
        return width & 0x3FFF, height & 0x3FFF
    return None


def _largest(data: bytes) -> Size | None:
    stated = (struct.unpack(">II", match[1]) for match in EXTENT.finditer(data))
    return max(stated, key=lambda size: size[0] * size[1], default=None)
