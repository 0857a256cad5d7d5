"""Small runs, and what they leave."""

from pathlib import Path

import numpy as np

from phy124.io.clip import Clip
from phy124.scene import Scene

CHANGES = {"accuracy": {"cells": 8}, "time.frames": 6, "view.size": 32, "view.views": ["front"]}
SCENE = Scene.named("press").replaced(CHANGES)
RESULTS = {"clip.safetensors", "front.mp4", "gaussians.ply", "report.json", "scene.toml"}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def same(first: Path, other: Path) -> None:
    """Assert that two runs left the same, apart from what they took."""
    assert names(first) == names(other)
    for name in names(first) - {"clip.safetensors", "report.json"}:
        assert (first / name).read_bytes() == (other / name).read_bytes(), name
    a, b = (Clip.load(folder / "clip.safetensors").tensors() for folder in (first, other))
    assert a.keys() == b.keys()
    for name in a:
        assert np.array_equal(a[name], b[name]), name
