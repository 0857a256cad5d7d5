"""Small runs, and comparisons of their results."""

import shutil
from pathlib import Path

import numpy as np

from phy124.io.clip import Clip
from phy124.pipeline import resume
from phy124.scene import Scene
from phy124.simulation import Simulation

CHANGES = {"accuracy": {"cells": 8}, "time.frames": 6, "view.size": 32, "view.views": ["front"]}
SCENE = Scene.named("press").replaced(CHANGES)
RESULTS = {"clip.safetensors", "front.mp4", "gaussians.ply", "report.json", "scene.toml"}
WITH = {
    "plain": {},
    "velocities and contacts": {"velocities": True, "contacts": True},
    "free solid": {
        "forces": [{"kind": "gravity"}],
        "boundaries": [{"kind": "ground"}],
        "objects": [
            {
                "name": "box",
                "shape": "box",
                "sides": [0.4, 0.4, 0.2],
                "on": "object",
                "motion": {"kind": "free", "density": 400},
            }
        ],
    },
    "at rest": {"boundaries": [{"kind": "ground"}], "time.frames": 9},
}
"""Changes of `SCENE` that a paused run must keep."""
TORN = {
    "accuracy": {"cells": 8, "solver": "mpm"},
    "time.frames": 6,
    "object.lift": 0.1,
    "object.spin": (0, 0, 40.0),
    "material.E": 1e4,
    "forces": [],
    "boundaries": [],
    "checks.balance": False,
}
"""Changes of `drop` with which the object tears."""


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def same(first: Path, other: Path) -> None:
    """Assert that two runs have equal results, except for times."""
    assert names(first) == names(other)
    for name in names(first) - {"clip.safetensors", "report.json"}:
        assert (first / name).read_bytes() == (other / name).read_bytes(), name
    a, b = (Clip.load(folder / "clip.safetensors").tensors() for folder in (first, other))
    assert a.keys() == b.keys()
    for name in a:
        assert np.array_equal(a[name], b[name]), name


def copied_at(frame_number: int, out: Path, copy: Path):
    """Return a function that copies the folder of a run at a frame, as a kill would leave it."""

    def each(run, frame) -> None:
        if frame.index == frame_number:
            shutil.copytree(out, copy, ignore=lambda *_: [])

    return each


def resumed(run: Simulation, frame: int, path: Path, **options) -> Simulation:
    """Pause a run after a frame; return the run that goes on, loaded with the options."""
    while run.step().index < frame:
        pass
    resume.save(run, path)
    return resume.load(path, **options)
