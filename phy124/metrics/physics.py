"""Physical measures of a clip that need no trained weights: what its Gaussians do over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.io.clip import Clip


@dataclass(frozen=True)
class Physics:
    """Measures of one clip; None where the clip lacks what is needed."""

    mass: float | None
    """Mass of the particles, kg; a single number, since it is conserved by construction."""
    volume_lowest: float
    """Smallest total volume of the Gaussians over time, relative to the first frame."""
    volume_highest: float
    """Largest total volume, likewise."""
    momentum_residual: float | None
    """Mean momentum against the motion of the centre, relative to the mean speed.

    |dx/dt - (v before + v after) / 2| of the mean of all Gaussians. It is exact up to the curvature
    of the path between two frames, so a collision shows; velocities that do not belong to the
    motion show more.
    """
    travelled: float
    """Length of the centre's path, in object sizes: 0 for a frozen clip."""
    finite: bool
    """True if every number of every frame is finite."""


def measure_physics(clip: Clip) -> Physics:
    """Measure the physics of a clip; all Gaussians have equal weight."""
    volumes = np.prod(np.asarray(clip.scales, dtype=np.float64), axis=2).sum(axis=1)
    ratio = volumes / volumes[0]
    centres = np.asarray(clip.means, dtype=np.float64).mean(axis=1)
    size = float(np.ptp(clip.means[0], axis=0).max())
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    arrays = (clip.means, clip.quats, clip.scales)
    return Physics(
        mass=clip.report.get("mass"),
        volume_lowest=float(ratio.min()),
        volume_highest=float(ratio.max()),
        momentum_residual=_momentum_residual(clip, centres),
        travelled=float(steps.sum()) / size,
        finite=all(bool(np.isfinite(array).all()) for array in arrays),
    )


def _momentum_residual(clip: Clip, centres: NDArray[np.float64]) -> float | None:
    if clip.velocities is None or len(clip) < 2:
        return None
    v = np.asarray(clip.velocities, dtype=np.float64).mean(axis=1)
    moved = np.diff(centres, axis=0) / np.diff(clip.times)[:, None]
    speed = float(np.linalg.norm(v, axis=1).mean())
    if speed == 0:
        return float(np.linalg.norm(moved, axis=1).mean())
    return float(np.linalg.norm(moved - (v[1:] + v[:-1]) / 2, axis=1).mean()) / speed


def centre_paths_differ(a: Clip, b: Clip) -> float:
    """Return the largest distance of two clips' centres at equal times, per longer path.

    Both must have the same frames. It measures whether two generators lead to "the same dynamics".
    """
    if len(a) != len(b):
        raise ValueError(f"the clips have {len(a)} and {len(b)} frames")
    paths = [np.asarray(c.means, dtype=np.float64).mean(axis=1) for c in (a, b)]
    first, second = (path - path[0] for path in paths)
    length = max(float(np.linalg.norm(path, axis=1).max()) for path in (first, second))
    apart = float(np.linalg.norm(first - second, axis=1).max())
    return apart / length if length > 0 else 0.0
