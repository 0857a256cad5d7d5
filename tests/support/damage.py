"""Damage to files: what a broken download or a wrong byte does to them."""

import random
from collections.abc import Callable

Damage = Callable[[bytes, random.Random], bytes]


def cut(data: bytes, rng: random.Random) -> bytes:
    """The end is missing."""
    return data[: rng.randrange(len(data))]


def flip(data: bytes, rng: random.Random) -> bytes:
    """A few bytes are others."""
    damaged = bytearray(data)
    for _ in range(rng.choice([1, 4, 64])):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    return bytes(damaged)
