"""Keys: a digest of everything that determines a clip, so that equal work is done once."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import warp as wp

import phy124
from phy124.generators import WEIGHTS, needs_image
from phy124.scene import Scene
from phy124.scene.files import files_named
from phy124.studies.sweep.declaration import Sweep
from phy124.studies.sweep.plan import Item
from phy124.studies.sweep.storage import fetched, stamp
from phy124.weights.store import KNOWN, find

DIGITS = 24
"""Hexadecimal digits of a key: two of 1e9 clips share one with a probability of 6e-12."""
CUT_OUT = ("u2net", "u2netp")
"""Weights that may cut out a picture."""


def key_of(sweep: Sweep, item: Item, scene: Scene) -> str:
    """The key of a clip: picture, files, scene, generator, weights, and this code.

    Raises:
        InputError: The picture cannot be read.
    """
    files = {name: digest(str(path)) for name, path in files_named(scene)}
    told: dict[str, Any] = {
        "picture": digest(item.picture),
        "generator": item.generator if needs_image(item.generator) else digest(item.generator),
        "weights": weights_of(item.generator),
        "gaussians": sweep.gaussians,
        "scene": scene.data(),
        "files": files,
        "films": sweep.films,
        "code": code(),
    }
    return _digits(told)


def key_asked(picture: str, generator: str, changes: dict[str, Any]) -> str:
    """A key of what a sweep asks for, even if no clip can be made of it."""
    return _digits([picture, generator, changes])


def _digits(told: Any) -> str:
    text = json.dumps(told, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def digest(address: str) -> str:
    """Digest of a file's content; read once, unless it has changed since.

    Raises:
        InputError: It cannot be read.
    """
    return _digest(address, stamp(address))


@lru_cache(maxsize=4096)
def _digest(address: str, stamp: object) -> str:
    del stamp  # what is remembered is forgotten with it
    with fetched(address) as path:
        return hashlib.sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=64)
def weights_of(generator: str) -> dict[str, str]:
    """Digests of the trained weights that a generator and its cut-out find on this machine."""
    if not needs_image(generator):
        return {}
    names = [*CUT_OUT, *WEIGHTS.get(generator, ())]
    found = {file.path: find(file) for name in names for file in KNOWN[name]}
    return {name: digest(str(path)) for name, path in found.items() if path is not None}


@lru_cache(maxsize=1)
def code() -> str:
    """Digest of this package's modules and the version of Warp."""
    root = Path(phy124.__file__).parent
    whole = hashlib.sha256(str(wp.config.version).encode())
    for path in sorted(root.rglob("*.py")):
        whole.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()
