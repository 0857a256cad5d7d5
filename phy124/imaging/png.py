"""A PNG without the texts, dates and resolutions around its pixels.

Pillow checks every chunk and refuses a picture for the damage of one that it does not need.
"""

from __future__ import annotations

import struct
import zlib

START = 8
"""Bytes before the first chunk."""
ROUND = 12
"""Bytes of a chunk besides its content: length, kind and checksum."""
NEEDED = b"tRNS"
"""Chunk that may be left out of a PNG and without which its pixels are others."""
READ = (b"iCCP", b"eXIf", b"acTL", b"fcTL")
"""Other such chunks that are read, whose checksum does not count."""


def plain(data: bytes) -> bytes:
    """The same picture with no chunks but those of its pixels and those that are read."""
    kept, place = [data[:START]], START
    while place < len(data):
        end = place + ROUND + int.from_bytes(data[place : place + 4], "big")
        kind, chunk = data[place + 4 : place + 8], data[place:end]
        if kind == NEEDED or not kind[:1].islower():  # Capital letters: no reader may skip it.
            kept.append(chunk)
        elif kind in READ:
            kept += [chunk[:-4], struct.pack(">I", zlib.crc32(chunk[4:-4]))]
        place = len(data) if kind == b"IEND" else end
    return b"".join(kept)
