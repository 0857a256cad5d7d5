"""Computes the key of a clip: a digest of all inputs that determine the clip. Clips with the same
key are made only once.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import phy124
from phy124.errors import InputError
from phy124.generators import WEIGHTS, needs_image
from phy124.scene import Scene
from phy124.scene.files import files_named
from phy124.studies.sweep.declaration import Sweep
from phy124.studies.sweep.plan import Item, Plan
from phy124.studies.sweep.storage import fetch, stamp
from phy124.weights.store import KNOWN, find

DIGITS = 24
"""Number of hexadecimal digits of a key. The probability of equal keys among 1e9 clips is 6e-12."""
CUT_OUT = ("u2net", "u2netp")
"""Weights that may segment the object in a picture."""


def key_of(sweep: Sweep, item: Item, scene: Scene) -> str:
    """Return the key of a clip.

    The key depends on the picture, scene and files, generator, weights and code.

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


def keys_in_plan(plan: Plan) -> Iterator[tuple[str, Item]]:
    """Yield the key and the settings of each clip of a sweep."""
    for item in plan:
        try:
            yield key_of(plan.sweep, item, plan.scene_of(item)), item
        except InputError:
            yield key_of_request(item.picture, item.generator, item.changes), item


def key_of_request(picture: str, generator: str, changes: dict[str, Any]) -> str:
    """Return the key of a request for a clip; an invalid request has a key, too.

    `changes` maps dotted paths in the scene to values.
    """
    return _digest_of([picture, generator, changes])


def _digest_of(data: Any) -> str:
    text = json.dumps(data, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def digest(address: str) -> str:
    """Return the digest of a file, which is cached until the file changes.

    Raises:
        InputError: The file cannot be read.
    """
    return _digest(address, stamp(address))


@lru_cache(maxsize=4096)
def _digest(address: str, stamp: object) -> str:
    """Return the digest of a file, cached until `stamp` changes with the file."""
    with fetch(address) as path:
        return hashlib.sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=64)
def weights_of(generator: str) -> dict[str, str]:
    """Return digests of a generator's and the segmentation's weights on this machine."""
    if not needs_image(generator):
        return {}
    names = [*CUT_OUT, *WEIGHTS.get(generator, ())]
    paths = {file.path: find(file) for name in names for file in KNOWN[name]}
    return {name: digest(str(path)) for name, path in paths.items() if path is not None}


@lru_cache(maxsize=1)
def code() -> str:
    """Return the digest of this package's modules and native code, and of Warp's version."""
    root = Path(phy124.__file__).parent
    whole = hashlib.sha256(str(wp.config.version).encode())
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.h")]):
        whole.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()


HEXADECIMAL = 16
"""Number of a key's digits that `Seen` stores. The probability that these digits are equal for any
two of 1e6 keys is 3e-8.
"""
RECENT = 4096
"""Maximum number of unsorted keys in `Seen`."""


class Seen:
    """A set of hexadecimal keys that takes eight bytes per key, for millions of clips."""

    def __init__(self, keys: Iterable[str] = ()) -> None:
        self._sorted = np.empty(0, np.uint64)
        self._recent: set[int] = set()
        for key in keys:
            self.add(key)

    def add(self, key: str) -> None:
        """Add a key."""
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
