"""Finds the nearest camera position that shows the whole motion, and the target of this camera.

A point is in the picture if it lies between four planes through the camera. The planes are moved
until they touch the outermost Gaussians. The two vertical planes then intersect in one line, and
the two horizontal planes in another; the more distant line determines the camera's distance.
Objects that are much longer along the view than across, such as a sword, would look distorted and
blurred, so the camera is farther away and has a narrower field of view.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import Array, rotation_matrices
from phy124.io.clip import Clip
from phy124.kernels.splat.discs import MOVES, WIDEST

Values = NDArray[np.float64]

SAMPLE = 8192
"""Largest number of sampled Gaussians, which have evenly spaced indices."""
MOST_VALUES = 1 << 20
"""Largest product of sampled Gaussians and frames. In longer clips, fewer Gaussians are sampled."""
FEWEST = 128
BLOCK = 64
VISIBLE = 0.1
"""Smallest opacity of a sampled Gaussian."""
OUTSIDE = 0.01
"""Fraction of the object that may be outside the picture without a warning."""
LEFT_OUT = 1.5e-4
"""Fraction of the sampled Gaussians, such as single drops, that may lie outside each edge."""
DEPTHS = 1.5
"""Smallest distance of the camera from a motion, in units of the motion's depth along the view."""
CLOSE = 0.98
"""The search for a zoom stops at this fraction of the smallest allowed camera distance."""
TRIES = 8
ZOOM = 40.0
"""Largest factor by which the field of view is narrowed."""
ROOM = 1.08
"""Width of the picture divided by the width of the whole motion; the same ratio holds for heights.
"""
MOST = 0.8
"""Fraction of the frames that determine a motion's usual extent; the other frames are rare moments.
"""
RARE = 1.5
"""The camera follows the object if rare moments enlarge a motion's extent by this factor."""


@dataclass(frozen=True)
class Sample:
    """Visible Gaussians that represent a clip's object (the sample)."""

    means: NDArray[np.floating]
    """Centres [T,S,3], m; the first frame's position replaces a position that is not finite."""
    covariances: Array
    """Covariance matrices [T,S,3,3], m^2."""
    corners: tuple[NDArray, NDArray] | None = None
    """Corners [3], [3] of the object in the first frame, m; None if no centre is finite."""

    @classmethod
    def of(cls, clip: Clip) -> Sample:
        """Sample the Gaussians of a clip's object, without its scenery."""
        if clip not in _samples:
            _samples[clip] = cls._of(clip)
        return _samples[clip]

    @classmethod
    def _of(cls, clip: Clip) -> Sample:
        visible = np.flatnonzero(clip.object_mask & (clip.opacities >= VISIBLE))
        chosen = visible if len(visible) else np.flatnonzero(clip.object_mask)
        # Each axis is a long contiguous row, for which minimum and maximum are faster.
        rest = np.ascontiguousarray(clip.means[0].T)
        rest = np.compress(clip.object_mask & np.isfinite(rest).all(axis=0), rest, axis=1)
        corners = (rest.min(axis=1), rest.max(axis=1)) if rest.size else None
        chosen = chosen[:: 1 + len(chosen) // min(SAMPLE, max(MOST_VALUES // len(clip), FEWEST))]
        chosen = chosen[np.isfinite(clip.means[0, chosen]).all(axis=1)]
        drawn = np.eye(3)[:, :, None] * _reach_of_discs(clip)[chosen] ** 2
        means = np.empty((len(clip), len(chosen), 3), np.float32)
        shapes = np.empty((*means.shape, 3), np.float32)
        for index, (centres, quats, scales) in enumerate(clip.rows_of(chosen)):
            # Long rows are several times faster than a product of matrices for each Gaussian.
            axes = np.ascontiguousarray((rotation_matrices(quats) * scales[:, None]).T)
            shape = (axes[:, :, None] * axes[:, None]).sum(axis=0) + drawn
            sound: Any = np.isfinite(centres).all(axis=1) & np.isfinite(shape).all(axis=(0, 1))
            shapes[index] = np.where(sound, shape, 0.0).T
            means[index] = np.where(sound[:, None], centres, means[0])
        return cls(means, shapes, corners)

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Mask of the moving Gaussians [S]; all Gaussians if none moves."""
        moves: NDArray[np.bool_] = (self.means != self.means[0]).any(axis=(0, 2))
        return moves if moves.any() else ~moves

    @cached_property
    def path(self) -> Values:
        """Displacement of the mean of the moving Gaussians since the first frame [T,3], m."""
        middle = self.means[:, self.moving].mean(axis=1, dtype=np.float64)
        return middle - middle[0]

    @cached_property
    def middle(self) -> Values:
        """Centre of the box around the whole motion [3], m."""
        low, high = self._boxes(self.means)
        return (low.min(axis=0) + high.max(axis=0)) / 2

    def with_fixed(self, points: NDArray) -> Sample:
        """Add fixed points [K,3] m to the sample of the object."""
        # The points are repeated, because a few points of a sample may lie outside the picture.
        times, still = len(self.means), np.repeat(points, 1 + len(self.means[0]) // 256, axis=0)
        means = np.broadcast_to(still.astype(np.float32), (times, *still.shape))
        shapes = np.zeros((*means.shape, 3), np.float32)
        whole = np.concatenate([self.means, means], axis=1)
        return Sample(whole, np.concatenate([self.covariances, shapes], axis=1), self.corners)

    def follow(self) -> Sample:
        """Return the sample relative to the object's path, as seen by a camera that follows the
        object.
        """
        return Sample(self.means - self.path[:, None], self.covariances)

    def has_rare_moment(self, largest: float) -> bool:
        """Return whether a few frames make the motion too large for a fixed camera.

        A fixed camera suffices if the extent of the motion is at most `largest` [m].
        """
        low, high = self._boxes(self.means)
        whole = _extent(low, high)
        usual = np.quantile(high, MOST, axis=0) - np.quantile(low, 1 - MOST, axis=0)
        far = whole > min(RARE * float(usual.max()), largest)
        return far and whole > RARE * _extent(*self._boxes(self.follow().means))

    def _boxes(self, means: NDArray[np.floating]) -> tuple[Values, Values]:
        """Return the object's corners in each frame [T,3], without the outermost Gaussians."""
        ends = [OUTSIDE / 2, 1 - OUTSIDE / 2]
        parts = (means[part].astype(np.float64) for part in _blocks(len(means)))
        low, high = np.concatenate([np.quantile(part, ends, axis=1) for part in parts], axis=1)
        return low, high


_samples: WeakKeyDictionary[Clip, Sample] = WeakKeyDictionary()


def _reach_of_discs(clip: Clip) -> Values:
    """Return the extent of a liquid's discs beyond its Gaussians [N], m; 0 for other Gaussians."""
    reach = np.zeros(len(clip.opacities))
    cell = float(clip.report.get("grid", {}).get("dx", 0.0))
    for first, last in (clip.report.get("shine") or {}).get("fluid", ()):
        reach[first:last] = (MOVES[1] + WIDEST) * cell
    return reach


@dataclass(frozen=True)
class Standing:
    """Camera distance, target and zoom at which a whole motion is visible."""

    distance: float
    """Distance of the cameras from their targets [m]."""
    shift: Values
    """Displacement of the points at which the cameras look [3], m."""
    zoom: float
    """Factor by which the field of view is narrowed so that the cameras can be farther away."""


def place_nearest(sample: Sample, cameras: list[Camera], *, zooms: bool = True) -> Standing:
    """Find the nearest camera positions that show the whole motion.

    Args:
        sample: The object in motion.
        cameras: A camera for each frame. The camera defines the orientation and the field of view.
            If the cameras turn during the clip, the camera also defines the target.
        zooms: Whether the field of view may narrow so that the camera keeps the distance `DEPTHS`.
    """
    seen, halves = _Seen.by(sample, cameras), np.array(cameras[0].halves) / ROOM
    least = DEPTHS * seen.depth if zooms else 0.0
    stand, slope = seen.standing(halves, 1.0), 0.0
    for _ in range(TRIES):
        if stand.distance >= CLOSE * least:
            break
        # The distance is almost linear in the zoom, until another Gaussian becomes the outermost.
        slope = slope or stand.distance / stand.zoom
        more = seen.standing(halves, min(stand.zoom + (least - stand.distance) / slope, ZOOM))
        if more.zoom == stand.zoom:
            break
        slope = (more.distance - stand.distance) / (more.zoom - stand.zoom)
        stand = more
    return stand


def place_along(
    sample: Sample, cameras: list[Camera], still: Standing, window: int
) -> tuple[Values, Values]:
    """Place cameras that move in and out smoothly and show the object in every frame.

    The positions from which a camera sees a point form a convex set, so if several positions show
    all points, the mean of these positions also shows all points.

    Args:
        sample: The object in motion.
        cameras: A camera for each frame. The camera defines the orientation and the field of view.
            If the cameras turn during the clip, the camera also defines the target.
        still: The nearest camera positions that show the whole motion. The zoom of these positions
            is used and, if the cameras turn, also the target.
        window: Each frame's camera also shows this number of frames before and after the frame.

    Returns:
        Distances of the cameras from the targets [T], m, and displacements of the targets [T,3], m.
    """
    seen, halves = _Seen.by(sample, cameras), np.array(cameras[0].halves) / ROOM
    if seen.turning:
        seen = replace(seen, points=seen.points - (seen.axes @ still.shift)[..., None])
    spans = [slice(max(t - window, 0), t + window + 1) for t in range(len(cameras))]
    edges = seen._edges(halves / still.zoom)
    around = np.array([edges[span].max(axis=0) for span in spans])
    if seen.turning:
        radii, shifts = around.max(axis=(1, 2)), np.tile(still.shift, (len(spans), 1))
    else:
        radii, shifts = seen._between(around, halves / still.zoom)
    stands = np.column_stack([radii, shifts])
    smooth = np.array([stands[span].mean(axis=0) for span in spans])
    return smooth[:, 0], smooth[:, 1:]


@dataclass(frozen=True)
class _Seen:
    points: NDArray[np.floating]
    """Positions relative to each camera's target: to the right, downwards and ahead [T,3,S], m."""
    reach: NDArray[np.floating]
    """Standard deviations of the Gaussians to the right and downwards [T,2,S], m."""
    axes: Values
    """Unit vectors of each camera: right, down and ahead [T,3,3]."""

    @classmethod
    def by(cls, sample: Sample, cameras: list[Camera]) -> _Seen:
        axes = np.stack([camera.view[:3, :3] for camera in cameras])
        targets = np.array([camera.target for camera in cameras])
        count, size = sample.means.shape[:2]
        points = np.empty((count, 3, size), np.float32)
        reach = np.empty((count, 2, size), np.float32)
        for part in _blocks(count):
            away = sample.means[part] - targets[part, None]
            points[part] = axes[part] @ away.transpose(0, 2, 1)
            pairs = axes[part, :2, :, None] * axes[part, :2, None, :]
            shapes = sample.covariances[part].reshape(-1, size, 9).transpose(0, 2, 1)
            reach[part] = np.sqrt(np.maximum(pairs.reshape(-1, 2, 9) @ shapes, 0))
        return cls(points, reach, axes)

    @property
    def depth(self) -> float:
        """Extent of the motion along the view [m]; the largest in any frame if cameras turn."""
        ahead = np.quantile(self.points[:, 2], [OUTSIDE / 2, 1 - OUTSIDE / 2], axis=1)
        if self.turning:
            return float((ahead[1] - ahead[0]).max())
        return float(ahead[1].max() - ahead[0].min())

    @property
    def turning(self) -> bool:
        return not np.allclose(self.axes, self.axes[0])

    def standing(self, halves: Values, zoom: float) -> Standing:
        """Return the nearest position from which the cameras see the whole object.

        `halves` [2] is defined in `Camera.halves`.
        """
        halves = halves / zoom
        edges = self._edges(halves).max(axis=0)
        if not self.turning:
            distance, shift = self._between(edges, halves)
            return Standing(float(distance), shift, zoom)
        # All cameras look at the same point, which may only be moved up or down.
        along = halves[1] * (edges[1, 0] - edges[1, 1]) / 2
        shift = np.array([0.0, 0.0, along * self.axes[:, 1, 2].mean()])
        moved = replace(self, points=self.points - (self.axes @ shift)[..., None])
        lower = moved._edges(halves).max()
        if lower < edges.max():
            return Standing(float(lower), shift, zoom)
        return Standing(float(edges.max()), np.zeros(3), zoom)

    def _between(self, edges: Values, halves: Values) -> tuple[Values, Values]:
        """Return the distances [...] m and shifts [...,3] m at which both opposite picture edges
        touch the sample.
        """
        shift = halves * (edges[..., 0] - edges[..., 1]) / 2
        return edges.sum(axis=-1).max(axis=-1) / 2, shift @ self.axes[0, :2]

    def _edges(self, halves: Values) -> Values:
        """Return the distances [T,2,2], m, from which the sample is inside each picture edge."""
        few, needed = int(LEFT_OUT * self.points.shape[2]), []
        for part in _blocks(len(self.points)):
            points, reach = self.points[part], self.reach[part]
            both = [(sign * points[:, :2] + reach) / halves[:, None] for sign in (1, -1)]
            each = np.stack(both, axis=2) - points[:, None, None, 2]
            each.partition(each.shape[-1] - 1 - few, axis=-1)
            needed.append(each[..., -1 - few])
        return np.concatenate(needed)


def _blocks(count: int) -> list[slice]:
    return [slice(start, start + BLOCK) for start in range(0, count, BLOCK)]


def _extent(low: Values, high: Values) -> float:
    return float((high.max(axis=0) - low.min(axis=0)).max())
