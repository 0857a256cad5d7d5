"""Harmful pictures, pictures with false headers, and functions that damage a file."""

import random
import struct
import zlib
from functools import cache
from pathlib import Path

PHONE = Path(__file__).parent / "pictures" / "phone.heic"
"""The duck, stored as 256 x 320 pixels and rotated by the header; written by pillow-heif 1.8."""


@cache
def bomb(side: int) -> bytes:
    """Return a PNG of one colour, which has a few kilobytes for any number of pixels."""
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(b"\0" * (1 + side // 8)) for _ in range(side))
    return _png(side, side, rows + packer.flush())


def png_claiming(width: int, height: int) -> bytes:
    """Return a small PNG whose header states another size."""
    return _png(width, height, zlib.compress(bytes(64)))


def _png(width: int, height: int, packed: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", packed), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def heic_claiming(width: int, height: int) -> bytes:
    """Return a HEIC photograph whose header states another size."""
    said, data = b"ispe" + bytes(4) + struct.pack(">II", 256, 320), PHONE.read_bytes()
    assert said in data
    return data.replace(said, said[:8] + struct.pack(">II", width, height))


def cut(data: bytes, rng: random.Random) -> bytes:
    """Cut off the end of a file."""
    return data[: rng.randrange(len(data))]


def flip(data: bytes, rng: random.Random) -> bytes:
    """Change a few bytes of a file."""
    damaged = bytearray(data)
    for _ in range(rng.choice([1, 4, 64])):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    return bytes(damaged)
