"""Measures the physics of a clip from the motion of its Gaussians, without trained weights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array
from phy124.io.clip import Clip
from phy124.io.flaws import hide_flaws


@dataclass(frozen=True)
class Physics:
    """Physical measures of a clip. A measure is None if the clip lacks the necessary data."""

    mass: float | None
    """Mass of the particles [kg], which MPM conserves by construction."""
    volume_lowest: float
    """Smallest total volume of the object's Gaussians, relative to that of the first frame."""
    volume_highest: float
    """Largest total volume of the object's Gaussians, relative to that of the first frame."""
    momentum_residual: float | None
    """Mean difference between the velocity of the object's centre and the change of the centre's
    position.

    The residual is the mean over frames of |dx/dt - (v before + v after) / 2|, divided by the mean
    speed; x and v are means over the Gaussians. If all velocities are zero, the residual is not
    divided, and its unit is m/s. The residual is larger than zero if the path of the centre curves
    between two frames, as in a collision, and even larger if the velocities do not match the
    motion. None if the clip has no velocities.
    """
    travelled: float
    """Length of the path of the object's centre [object sizes]; [m] if the object is a point."""
    finite: bool
    """Whether all positions, rotations and scales are finite in all frames."""


def measure_physics(clip: Clip) -> Physics:
    """Measure the physics of a clip's object; all its Gaussians with finite values have equal
    weights.

    Raises:
        InputError: No Gaussian has finite values in all frames.
    """
    clip, flaws = hide_flaws(clip)
    # Frames are read one by one, because a clip may be larger than the memory.
    volumes, mask = [], clip.object_mask
    for scales in clip.scales:
        volumes.append(np.prod(scales[mask], axis=1, dtype=np.float64).sum())
    ratio, path = np.array(volumes) / volumes[0], _centres(clip.means, mask)
    size = float(np.ptp(clip.means[0][mask], axis=0).max()) or 1.0
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return Physics(
        mass=clip.report.get("mass"),
        volume_lowest=float(ratio.min()),
        volume_highest=float(ratio.max()),
        momentum_residual=_momentum_residual(clip, path),
        travelled=float(steps.sum()) / size,
        finite=not flaws,
    )


def _momentum_residual(clip: Clip, centres: NDArray[np.float64]) -> float | None:
    if clip.velocities is None or len(clip) < 2:
        return None
    v = _centres(clip.velocities, clip.object_mask)
    moved = np.diff(centres, axis=0) / np.diff(clip.times)[:, None]
    speed = float(np.linalg.norm(v, axis=1).mean())
    if speed == 0:
        return float(np.linalg.norm(moved, axis=1).mean())
    return float(np.linalg.norm(moved - (v[1:] + v[:-1]) / 2, axis=1).mean()) / speed


def _centres(rows: Array, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the mean of the chosen Gaussians' values in each frame [T,3]."""
    return np.array([row[mask].mean(axis=0, dtype=np.float64) for row in rows])


def centre_paths_differ(a: Clip, b: Clip) -> float:
    """Return the relative difference between the paths of the objects' centres in two clips.

    The difference is the largest distance between simultaneous displacements of the two centres,
    divided by the largest displacement.

    Raises:
        ValueError: The clips have different numbers of frames.
        InputError: No Gaussian of a clip has finite values in all frames.
    """
    if len(a) != len(b):
        raise ValueError(f"the clips have {len(a)} and {len(b)} frames")
    clips = (hide_flaws(clip)[0] for clip in (a, b))
    paths = (_centres(clip.means, clip.object_mask) for clip in clips)
    first, second = (path - path[0] for path in paths)
    length = max(float(np.linalg.norm(path, axis=1).max()) for path in (first, second))
    apart = float(np.linalg.norm(first - second, axis=1).max())
    return apart / length if length > 0 else 0.0
