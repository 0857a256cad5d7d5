"""Small clips that are made without a simulation."""

import numpy as np

from phy124.gaussians import Frame
from phy124.io.clip import Clip
from support.shapes import ball

AWAY = [(0, 0.2 * i, 0) for i in range(8)]
"""Direction to the right of the front camera."""
FIT = {
    "target": "a<b.mp4", "cells": 24, "grids": [{"cells": 16}, {"cells": 24}], "notes": [],
    "found": {"material.E": {"value": 5e4, "interval": [4e4, 6e4],
                             "limit": {"value": 5e4, "interval": [4e4, 6e4]}}},
    "measured": {"silhouettes": {"unit": "of a pixel", "misfit": 0.01}},
    "tried": [
        {"level": 0, "values": {"material.E": 1e4}, "misfits": [0.1]},
        {"level": 1, "values": {"material.E": 5e4}, "misfits": [0.02]},
        {"level": 1, "values": {"material.E": 9e4}, "misfits": None},
    ],
    "declared": {"find": {"material.E": {"log_uniform": [1e4, 1e5]}}},
    "pictures": {"fps": 10.0, "times": [0, 0.1], "was": {"material.E": 4e4},
                 "before": [0.0, 0.1], "fitted": [0.0, 0.02]},
}  # fmt: skip
"""Report of a fit to a film."""


def random_clip(
    frames: int = 4, count: int = 50, *, degree: int = 0, velocities: bool = True, fps: float = 30.0
) -> Clip:
    rng = np.random.default_rng(124)

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    quats = normal(frames, count, 4)
    return Clip(
        means=normal(frames, count, 3),
        quats=quats / np.linalg.norm(quats, axis=-1, keepdims=True),
        scales=rng.uniform(0.01, 0.1, (frames, count, 3)).astype(np.float32),
        opacities=rng.uniform(0, 1, count).astype(np.float32),
        sh=normal(count, (degree + 1) ** 2, 3),
        times=np.arange(frames) / fps,
        velocities=normal(frames, count, 3) if velocities else None,
        scene={"description": "random", "view": {"size": 512}},
        report={"complete": True, "frames": frames},
    )


def flight(steps, *, count: int = 500) -> Clip:
    """Return a clip of a ball of 1 m that is displaced by `steps` [T,3], m, in the frames."""
    rest = ball(count)
    frames = [
        Frame(i, i / 24, rest.transform(1.0, np.array(step, float))) for i, step in enumerate(steps)
    ]
    return Clip.from_frames(frames)


def with_floor(clip: Clip, count: int = 1500) -> Clip:
    """Return the clip with surroundings: the Gaussians of a floor, which do not move."""
    n = clip.means.shape[1]
    x = np.random.default_rng(0).uniform(-2, 2, (count, 3)) * [1, 1, 0] - [0, 0, 0.5]

    def add(array: np.ndarray, values: np.ndarray | float) -> np.ndarray:
        shape = (*array.shape[: array.ndim - 2], count, array.shape[-1])
        return np.concatenate([array, np.broadcast_to(values, shape).astype(array.dtype)], axis=-2)

    return Clip(
        add(clip.means, x),
        add(clip.quats, np.array([1.0, 0.0, 0.0, 0.0])),
        add(clip.scales, 0.02),
        np.append(clip.opacities, np.ones(count, clip.opacities.dtype)),
        np.concatenate([clip.sh, np.zeros((count, *clip.sh.shape[1:]), clip.sh.dtype)]),
        clip.times,
        velocities=None if clip.velocities is None else add(clip.velocities, 0.0),
        scene={"parts": [{"gaussians": (n, n + count), "surroundings": True, "static": True}]},
        report=clip.report,
    )


def falling(count=5):
    """Return a clip of a falling cube of Gaussians, and the positions in the first frame."""
    rest = np.stack(np.meshgrid(*[np.linspace(0, 1, 4)] * 3), -1).reshape(-1, 3)
    times = np.arange(count) / 24
    means = rest[None] - 4.9 * times[:, None, None] ** 2 * [0, 0, 1]
    n = len(rest)
    turned = np.broadcast_to([1.0, 0, 0, 0], (count, n, 4))
    clip = Clip(means, turned, np.full((count, n, 3), 0.1), np.ones(n), np.zeros((n, 1, 3)), times)
    return clip, rest
