"""Pictures that would do harm or claim to be what they are not, and damage to any file."""

from __future__ import annotations

import random
import struct
import zlib
from functools import cache
from pathlib import Path

PHONE = Path(__file__).parent / "pictures" / "phone.heic"
"""The duck, 256 x 320 as stored and turned by its header; written by pillow-heif 1.8."""


@cache
def bomb(side: int) -> bytes:
    """A PNG of one colour: a few kilobytes however large it is."""
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(b"\0" * (1 + side // 8)) for _ in range(side))
    return _png(side, side, rows + packer.flush())


def png_claiming(width: int, height: int) -> bytes:
    """A small PNG whose header claims another size."""
    return _png(width, height, zlib.compress(bytes(64)))


def _png(width: int, height: int, packed: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", packed), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def heic_claiming(width: int, height: int) -> bytes:
    """A photograph in HEIC with another size in its header."""
    said, data = b"ispe" + bytes(4) + struct.pack(">II", 256, 320), PHONE.read_bytes()
    assert said in data
    return data.replace(said, said[:8] + struct.pack(">II", width, height))


def cut(data: bytes, rng: random.Random) -> bytes:
    """The end is missing."""
    return data[: rng.randrange(len(data))]


def flip(data: bytes, rng: random.Random) -> bytes:
    """A few bytes are others."""
    damaged = bytearray(data)
    for _ in range(rng.choice([1, 4, 64])):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    return bytes(damaged)
