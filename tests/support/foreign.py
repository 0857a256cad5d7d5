"""Readers of Gaussians from other projects, which check the files that phy124 writes.

They are not part of the test extra, because gsply needs numba, which is large, and one needs
Node.js. `make test-foreign` installs them and runs their tests.

spz-js of npm cannot be used, because it reads only version 2, and phy124 writes versions 3 and 4.
Files that spz-js wrote are read in tests/test_formats.py.
"""

import importlib.util
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phy124.gaussians import Gaussians
from phy124.io.formats import read_as_is

MODULES = Path(os.environ.get("PHY124_NODE_MODULES", "none"))


@dataclass(frozen=True)
class Judge:
    """A program that reads some formats."""

    name: str
    reads: tuple[str, ...]
    read: Callable[[Path], Gaussians]
    """The Gaussians in the axes of the file."""
    missing: Callable[[], str]
    """Return the reason why this program cannot be used, or an empty text."""


def _node(path: str) -> Callable[[], str]:
    def missing() -> str:
        if shutil.which("node") is None:
            return "there is no Node.js"
        return "" if (MODULES / path).exists() else f"there is no {path} in PHY124_NODE_MODULES"

    return missing


def _package(name: str) -> Callable[[], str]:
    return lambda: "" if importlib.util.find_spec(name) else f"{name} is not installed"


def _splat_transform(path: Path) -> Gaussians:
    out = path.with_suffix(".read.ply")
    program = MODULES / "@playcanvas/splat-transform/bin/cli.mjs"
    command = ["node", str(program), "-q", "-w", str(path), str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return read_as_is(out).gaussians


def _gsply(path: Path) -> Gaussians:
    import gsply
    from gsply.sog_reader import sogread

    readers = {".ply": gsply.plyread, ".spz": gsply.read_spz, ".sog": sogread}
    return _activated(readers[path.suffix](str(path)))


def _activated(data: Any) -> Gaussians:
    """Convert logarithms and logits to Gaussians."""
    first = data.sh0[:, None]
    sh = first if data.shN is None else np.concatenate([first, data.shN], axis=1)
    quats = data.quats / np.linalg.norm(data.quats, axis=1, keepdims=True)
    opacities = 1 / (1 + np.exp(-data.opacities.reshape(-1).astype(np.float64)))
    return Gaussians(data.means, quats, np.exp(data.scales), opacities, sh)


def _gaussforge(path: Path) -> Gaussians:
    import gaussforge

    made = gaussforge.GaussForge().convert(path.read_bytes(), path.suffix[1:], "ply")
    out = path.with_suffix(".read.ply")
    out.write_bytes(bytes(made["data"]))
    return read_as_is(out).gaussians


JUDGES = (
    Judge(
        "splat-transform",
        ("ply", "splat", "spz", "spz4", "sog"),
        _splat_transform,
        _node("@playcanvas/splat-transform"),
    ),
    Judge("gsply", ("ply", "spz", "spz4", "sog"), _gsply, _package("gsply")),
    Judge("gaussforge", ("ply", "splat", "spz", "sog"), _gaussforge, _package("gaussforge")),
)
