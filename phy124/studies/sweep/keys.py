"""Computes the key of a clip, which is a digest of all inputs that determine the clip.

Clips with the same key are equal and are made only once.
"""

import hashlib
import json
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import phy124
from phy124.generators import WEIGHTS, needs_image
from phy124.scene import Scene
from phy124.scene.files import files_named
from phy124.studies.sweep.declaration import Sweep
from phy124.studies.sweep.plan import Item
from phy124.studies.sweep.storage import fetch, stamp
from phy124.weights.store import KNOWN, find

DIGITS = 24
"""Number of hexadecimal digits in the key of a clip.

The probability that any two of 1e9 different clips have equal keys is 6e-12.
"""
CUT_OUT = ("u2net", "u2netp")
"""Names of the weights that may be used to segment the object in a picture."""


def key_of(sweep: Sweep, item: Item, scene: Scene) -> str:
    """Return the key of a clip.

    The key is the digest of the picture, the scene and its files, the generator, the weights, and
    the code of this package.

    Raises:
        InputError: The picture cannot be read.
    """
    files = {name: digest(str(path)) for name, path in files_named(scene)}
    inputs: dict[str, Any] = {
        "picture": digest(item.picture),
        "generator": item.generator if needs_image(item.generator) else digest(item.generator),
        "weights": weights_of(item.generator),
        "gaussians": sweep.gaussians,
        "scene": scene.data(),
        "files": files,
        "films": sweep.films,
        "code": code(),
    }
    return _digest_of(inputs)


def key_of_request(picture: str, generator: str, changes: dict[str, Any]) -> str:
    """Return the key of a request for a clip; an invalid request has a key, too.

    `picture` is an address; `changes` maps dotted paths in the scene to values.
    """
    return _digest_of([picture, generator, changes])


def _digest_of(data: Any) -> str:
    text = json.dumps(data, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def digest(address: str) -> str:
    """Return the digest of a file's content; it is cached until the file changes.

    Raises:
        InputError: The file cannot be read.
    """
    return _digest(address, stamp(address))


@lru_cache(maxsize=4096)
def _digest(address: str, stamp: object) -> str:
    """Return the digest of a file's content; `stamp` is a value that changes with the file."""
    with fetch(address) as path:
        return hashlib.sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=64)
def weights_of(generator: str) -> dict[str, str]:
    """Return digests of the weight files that a generator and the segmentation use.

    Weight files that are not on this machine are skipped.
    """
    if not needs_image(generator):
        return {}
    names = [*CUT_OUT, *WEIGHTS.get(generator, ())]
    paths = {file.path: find(file) for name in names for file in KNOWN[name]}
    return {name: digest(str(path)) for name, path in paths.items() if path is not None}


@lru_cache(maxsize=1)
def code() -> str:
    """Return the digest of this package's modules and of Warp's version."""
    root = Path(phy124.__file__).parent
    whole = hashlib.sha256(str(wp.config.version).encode())
    for path in sorted(root.rglob("*.py")):
        whole.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()


HEXADECIMAL = 16
"""Number of a key's first hexadecimal digits that the set `Seen` stores.

For 1e6 keys of clips, the probability that any two agree in all these digits is 3e-8.
"""
RECENT = 4096
"""Maximum number of keys that `Seen` holds unsorted, before it sorts them into its array."""


class Seen:
    """A set of hexadecimal keys with only eight bytes per key, for millions of clips."""

    def __init__(self, keys: Iterable[str] = ()) -> None:
        self._sorted = np.empty(0, np.uint64)
        self._recent: set[int] = set()
        for key in keys:
            self.add(key)

    def add(self, key: str) -> None:
        """Add a key to the set."""
        self._recent.add(_leading_digits(key))
        if len(self._recent) >= RECENT:
            recent = np.fromiter(self._recent, np.uint64, len(self._recent))
            self._sorted = np.union1d(self._sorted, recent)
            self._recent.clear()

    def __contains__(self, key: str) -> bool:
        number = _leading_digits(key)
        if number in self._recent:
            return True
        place = np.searchsorted(self._sorted, np.uint64(number))
        return bool(place < len(self._sorted) and self._sorted[place] == number)


def _leading_digits(key: str) -> int:
    return int(key[:HEXADECIMAL], 16)
