"""Prepare for the first visitor: load the kernels of all presets, and measure this machine."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.gaussians import Gaussians
from phy124.imaging.cutout import foreground
from phy124.pipeline.warming import warm
from phy124.runtime.context import RunContext
from phy124.scene import Scene, preset_names

COUNT = 500
EXAMPLE = Path(__file__).parent / "examples/duck.png"


def warm_up(context: RunContext) -> None:
    """Compile and load the kernels of all presets."""
    scenes = [Scene.named(name) for name in preset_names()]
    warm(scenes, context)


def tiny_run(context: RunContext) -> tuple[dict[str, Any], Scene]:
    """Make a run with hardly any work, and return its report and its scene.

    The times in this report are mostly the fixed costs of a substep and of a video.
    """
    few = {"accuracy": {"cells": 8, "particles_per_axis": 1.0}, "time.frames": 2}
    scene = Scene.named("press").replaced({**few, "view.size": 32, "view.views": ["front"]})
    with tempfile.TemporaryDirectory() as folder:
        result = pipeline.simulate(_ball(), scene, folder, context.aside())
    return result.report, scene


def example_run(context: RunContext) -> tuple[dict[str, Any], Scene]:
    """Make a short run to measure costs per particle and per pixel; return its report and scene."""
    short = {"accuracy": "draft", "time.frames": 5, "view.views": ["front"]}
    scene = Scene.named("press").replaced(short)
    with tempfile.TemporaryDirectory() as folder:
        result = pipeline.generate(EXAMPLE, scene, folder, context.aside())
    return result.report, scene


def search_seconds() -> float:
    """Measure the time to segment the object of a photograph on this machine [s]."""
    with Image.open(EXAMPLE) as example:
        photograph = Image.new("RGBA", example.size, "white")
        photograph.alpha_composite(example.convert("RGBA"))
    start = time.monotonic()
    foreground(photograph)
    return time.monotonic() - start


def _ball() -> Gaussians:
    rng = np.random.default_rng(0)
    away = rng.normal(size=(COUNT, 3))
    means = 0.5 * away / np.linalg.norm(away, axis=1, keepdims=True)
    quats = np.tile([1.0, 0, 0, 0], (COUNT, 1))
    shape = np.full((COUNT, 3), 0.05)
    return Gaussians.from_rgb(
        means, quats, shape, np.full(COUNT, 0.9), rng.random((COUNT, 3), np.float32)
    )
