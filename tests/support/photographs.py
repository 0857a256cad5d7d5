"""Makes files of photographs with EXIF tags, colour profiles, or several pictures."""

import io
import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageCms

ORIENTATION, SHORT = 0x0112, 3


class Entry(NamedTuple):
    """An EXIF tag with its stored bytes, which type and count may contradict."""

    tag: int
    type: int
    count: int
    data: bytes


def upright(orientation: int) -> Entry:
    """Return the tag for an orientation."""
    return Entry(ORIENTATION, SHORT, 1, struct.pack("<H", orientation))


def exif_of(entries: Iterable[Entry]) -> bytes:
    """Return EXIF data with some tags, in little-endian order."""
    entries = sorted(entries)
    place = 8 + 2 + 12 * len(entries) + 4
    table, rest = struct.pack("<H", len(entries)), b""
    for tag, kind, count, data in entries:
        value = data.ljust(4, b"\0") if len(data) <= 4 else struct.pack("<I", place + len(rest))
        rest += data if len(data) > 4 else b""
        table += struct.pack("<HHI", tag, kind, count) + value
    return b"Exif\0\0II*\0" + struct.pack("<I", 8) + table + bytes(4) + rest


def file_of(picture: Image.Image, kind: str, **options: object) -> bytes:
    """Return the bytes of a picture that was saved as PNG, JPEG, ..."""
    with io.BytesIO() as file:
        picture.save(file, kind, **options)
        return file.getvalue()


def with_segment(jpeg: bytes, marker: int, data: bytes) -> bytes:
    """Return a JPEG with an additional segment at its start."""
    return jpeg[:2] + bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data + jpeg[2:]


def tiff_of(grey: np.ndarray, *entries: Entry) -> bytes:
    """Return a TIFF of grey levels [H,W], 8 bits, with additional tags."""
    height, width = grey.shape
    said = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 278: height, 279: grey.size}
    plain = [Entry(tag, 4, 1, struct.pack("<I", value)) for tag, value in said.items()]
    start = len(exif_of([*plain, Entry(273, 4, 1, bytes(4)), *entries])) - 6
    place = Entry(273, 4, 1, struct.pack("<I", start))
    return exif_of([*plain, place, *entries])[6:] + grey.tobytes()


def segment_of(jpeg: bytes, start: bytes) -> bytes:
    """Return the data of the first segment of a JPEG that begins with these bytes."""
    place = jpeg.index(start)
    return jpeg[place : place + int.from_bytes(jpeg[place - 2 : place], "big") - 2]


def fixed(value: float) -> bytes:
    """Encode a number as ICC profiles do, in steps of 1 / 65536."""
    return struct.pack(">i", round(value * 65536))


def profile(space: str, tags: dict[str, bytes]) -> bytes:
    """Return an ICC profile (version 2.4) of a display or, for CMYK, of a printer.

    Args:
        space: "RGB ", "GRAY" or "CMYK".
        tags: The data of each tag.
    """
    table, body, place = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for name, data in tags.items():
        table += name.encode() + struct.pack(">II", place + len(body), len(data))
        body += data.ljust(-(-len(data) // 4) * 4, b"\0")
    kind, linked = ("prtr", "Lab ") if space == "CMYK" else ("mntr", "XYZ ")
    head = bytes(8) + b"\x02\x40\0\0" + (kind + space + linked).encode() + bytes(12) + b"acsp"
    head = head.ljust(68, b"\0") + fixed(0.9642) + fixed(1.0) + fixed(0.8249)
    head = head.ljust(128, b"\0")
    data = head + table + body
    return struct.pack(">I", len(data)) + data[4:]


def curve(gamma: float) -> bytes:
    """Return a tone curve that is a power function."""
    return b"curv" + bytes(4) + struct.pack(">IH", 1, round(gamma * 256))


DISPLAY_P3 = np.array(
    [[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]]
)
"""Primaries of Display P3, adapted to D50."""


def display_p3() -> bytes:
    """Return the profile Display P3 with the tone curve of sRGB, as in files of phones."""
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    count = int.from_bytes(srgb[128:132], "big")
    table = [struct.unpack(">4sII", srgb[132 + 12 * i : 144 + 12 * i]) for i in range(count)]
    tags = {name.decode(): srgb[place : place + size] for name, place, size in table}
    for name, column in zip("rgb", DISPLAY_P3.T, strict=True):
        tags[f"{name}XYZ"] = b"XYZ " + bytes(4) + b"".join(map(fixed, column))
    return profile("RGB ", {name: tags[name] for name in tags if name[1:] in ("XYZ", "TRC")})


def grey_profile(gamma: float) -> bytes:
    """Return a grey profile whose tone curve is a power function."""
    white = b"XYZ " + bytes(4) + fixed(0.9642) + fixed(1.0) + fixed(0.8249)
    return profile("GRAY", {"kTRC": curve(gamma), "wtpt": white})


def cmyk_profile() -> bytes:
    """Return a CMYK profile in which only black ink darkens: L = 100 (1 - K)."""
    corners = [
        (0 if index & 1 else 255, 128, 128) for index in range(16)
    ]  # the last channel, K, varies fastest
    grid = bytes(value for corner in corners for value in corner)
    line = bytes(range(256))
    table = b"mft1" + bytes(4) + bytes([4, 3, 2, 0])
    table += b"".join(map(fixed, np.eye(3).ravel())) + line * 4 + grid + line * 3
    return profile("CMYK", {"A2B0": table})


def heic_with(heic: bytes, profile: bytes, exif: bytes) -> bytes:
    """Return the photograph `support.hostile.PHONE` with a colour profile and other EXIF data."""
    old = heic.index(b"colrnclx") - 4
    size = int.from_bytes(heic[old : old + 4], "big")
    new = struct.pack(">I", 12 + len(profile)) + b"colrprof" + profile
    more = len(new) - size
    data = bytearray(heic[:old] + new + heic[old + size :])
    for box in (b"meta", b"iprp", b"ipco"):
        place = heic.index(box) - 4
        longer = int.from_bytes(data[place : place + 4], "big") + more
        data[place : place + 4] = struct.pack(">I", longer)
    first = heic.index(b"iloc") + 16  # offset of the first of two items of 18 bytes each
    start = int.from_bytes(data[first : first + 4], "big") + more
    data[first : first + 4] = struct.pack(">I", start)
    content = struct.pack(">I", 6) + exif
    second = first + 18
    data[second : second + 4] = struct.pack(">I", len(data))
    data[second + 10 : second + 14] = struct.pack(">I", len(content))
    return bytes(data) + content
