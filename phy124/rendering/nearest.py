"""How near a camera can stand and still show the whole motion, and where it then looks.

A point is in the picture if it lies between four planes through the camera. Along a direction of
view the camera can therefore be no nearer than the farther of the places where the two upright and
the two level planes through the outermost Gaussians meet; these also say where it looks. What is
much longer along the view than across, such as a sword from its tip, would be distorted and blurred
from there: the camera stands farther away and shows it as large with a narrower view.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import rotation_matrices
from phy124.io.clip import Clip

Values = NDArray[np.float64]

SAMPLE = 2048
"""Number of Gaussians, evenly picked, that represent all of them."""
VISIBLE = 0.1
"""Opacity from which a Gaussian counts as part of the object."""
OUTSIDE = 0.01
"""Fraction of the object that may be outside the picture without a warning."""
LEFT_OUT = 5e-4
"""Fraction of the object's sample that may be outside each edge: few drops decide nothing."""
DEPTHS = 1.5
"""Smallest distance from a motion, in its depths along the view."""
CLOSE, TRIES = 0.98, 8
"""Fraction of that distance that is near enough to it, and how often another zoom is tried."""
ZOOM = 40.0
"""Factor by which the view is narrower at most."""
ROOM = 1.08
"""Width of the picture relative to that of the whole motion in it, or height."""
MOST = 0.8
"""Fraction of the frames that are most of a motion; what only the others show is a rare moment."""
RARE = 1.5
"""How much larger a rare moment makes the whole motion at least, for the camera to follow it."""


@dataclass(frozen=True)
class Sample:
    """Visible Gaussians that stand for all of a clip's object."""

    means: Values
    """Centres [T,S,3], m; where the motion broke, those of the first frame."""
    covariances: Values
    """[T,S,3,3], m^2."""

    @classmethod
    def of(cls, clip: Clip) -> Sample:
        """Those of a clip; of none of its scenery."""
        visible = np.flatnonzero(clip.own & (clip.opacities >= VISIBLE))
        chosen = visible if len(visible) else np.flatnonzero(clip.own)
        chosen = chosen[:: 1 + len(chosen) // SAMPLE]
        chosen = chosen[np.isfinite(clip.means[0, chosen]).all(axis=1)]
        means = clip.means[:, chosen].astype(np.float64)
        axes = rotation_matrices(clip.quats[:, chosen].reshape(-1, 4))
        axes = axes * clip.scales[:, chosen].reshape(-1, 1, 3)
        shapes = (axes @ axes.transpose(0, 2, 1)).reshape(*means.shape, 3)
        sound = np.asarray(np.isfinite(means).all(axis=2) & np.isfinite(shapes).all(axis=(2, 3)))
        return cls(
            np.where(sound[..., None], means, means[0]),
            np.where(sound[..., None, None], shapes, 0.0),
        )

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Which of them move [S]; all if none does."""
        moves: NDArray[np.bool_] = (self.means != self.means[0]).any(axis=(0, 2))
        return moves if moves.any() else ~moves

    @cached_property
    def path(self) -> Values:
        """Displacement of the middle of what moves, relative to the first frame [T,3], m."""
        middle = self.means[:, self.moving].mean(axis=1)
        return middle - middle[0]

    @cached_property
    def middle(self) -> Values:
        """Middle of the box around the whole motion [3], m."""
        low, high = self._boxes(self.means)
        return (low.min(axis=0) + high.max(axis=0)) / 2

    def followed(self) -> Sample:
        """The same, seen from a camera that goes along."""
        return Sample(self.means - self.path[:, None], self.covariances)

    def rare(self, largest: float) -> bool:
        """Whether a still camera shows most of the motion small, and a following one does not.

        Args:
            largest: Extent of a motion that a still camera shows in any case [m].
        """
        low, high = self._boxes(self.means)
        whole = _extent(low, high)
        usual = np.quantile(high, MOST, axis=0) - np.quantile(low, 1 - MOST, axis=0)
        far = whole > min(RARE * float(usual.max()), largest)
        return far and whole > RARE * _extent(*self._boxes(self.followed().means))

    def _boxes(self, means: Values) -> tuple[Values, Values]:
        """Corners of the object in each frame [T,3], [T,3], without its outermost Gaussians."""
        low, high = np.quantile(means, [OUTSIDE / 2, 1 - OUTSIDE / 2], axis=1)
        return low, high


@dataclass(frozen=True)
class Standing:
    """Where cameras stand that show a whole motion."""

    distance: float
    """Distance from what they look at [m]."""
    shift: Values
    """How far the places that they look at are moved [3], m."""
    zoom: float
    """Factor by which the opening of the view is narrower."""


def nearest(sample: Sample, cameras: list[Camera], *, zooms: bool = True) -> Standing:
    """Where cameras stand nearest that show the whole motion.

    Args:
        sample: What they show.
        cameras: One for each frame, which say how they are turned, how wide they see, and, if they
            turn during the clip, where they look.
        zooms: Whether they may narrow their view to keep `DEPTHS`.
    """
    seen, halves = _Seen.by(sample, cameras), np.array(cameras[0].halves) / ROOM
    least = DEPTHS * seen.depth if zooms else 0.0
    stand, slope = seen.standing(halves, 1.0), 0.0
    for _ in range(TRIES):
        if stand.distance >= CLOSE * least:
            break
        # The distance is a line in the zoom, bent a little where other Gaussians become outermost.
        slope = slope or stand.distance / stand.zoom
        more = seen.standing(halves, min(stand.zoom + (least - stand.distance) / slope, ZOOM))
        if more.zoom == stand.zoom:
            break
        slope = (more.distance - stand.distance) / (more.zoom - stand.zoom)
        stand = more
    return stand


@dataclass(frozen=True)
class _Seen:
    """A sample in the axes of the cameras."""

    places: Values
    """Right, down and ahead of what is looked at [T,3,S], m."""
    reach: Values
    """Standard deviations right and down [T,2,S], m."""
    axes: Values
    """Right, down and ahead of each camera [T,3,3]."""

    @classmethod
    def by(cls, sample: Sample, cameras: list[Camera]) -> _Seen:
        axes = np.stack([camera.view[:3, :3] for camera in cameras])
        targets = np.array([camera.target for camera in cameras])
        places = axes @ (sample.means - targets[:, None]).transpose(0, 2, 1)
        pairs = axes[:, :2, :, None] * axes[:, :2, None, :]
        variances = pairs.reshape(-1, 2, 9) @ sample.covariances.reshape(
            *places.shape[::2], 9
        ).transpose(0, 2, 1)
        return cls(places, np.sqrt(np.maximum(variances, 0)), axes)

    @property
    def depth(self) -> float:
        """Extent of the motion along the view, the largest in any frame's direction [m]."""
        ahead = np.quantile(self.places[:, 2], [OUTSIDE / 2, 1 - OUTSIDE / 2], axis=1)
        if self.turning:
            return float((ahead[1] - ahead[0]).max())
        return float(ahead[1].max() - ahead[0].min())

    @property
    def turning(self) -> bool:
        """Whether the cameras turn during the clip."""
        return not np.allclose(self.axes, self.axes[0])

    def standing(self, halves: Values, zoom: float) -> Standing:
        """Where they stand nearest with a zoom.

        Args:
            halves: Half of what they see at a distance of 1 without it, right and down [2].
            zoom: Factor by which that is less.
        """
        halves = halves / zoom
        edges = self._edges(halves)
        across, along = halves * (edges[:, 0] - edges[:, 1]) / 2
        if not self.turning:
            shift = across * self.axes[0, 0] + along * self.axes[0, 1]
            return Standing(float(edges.sum(axis=1).max() / 2), shift, zoom)
        # All look at one place, which may only be higher or lower than the middle.
        shift = np.array([0.0, 0.0, along * self.axes[:, 1, 2].mean()])
        moved = replace(self, places=self.places - (self.axes @ shift)[..., None])
        lower = moved._edges(halves).max()
        if lower < edges.max():
            return Standing(float(lower), shift, zoom)
        return Standing(float(edges.max()), np.zeros(3), zoom)

    def _edges(self, halves: Values) -> Values:
        """Distances at which all is inside the edges right, left; below, above [2,2], m."""
        both = [(sign * self.places[:, :2] + self.reach) / halves[:, None] for sign in (1, -1)]
        needed = np.stack(both, axis=2) - self.places[:, None, None, 2]
        few = int(LEFT_OUT * needed.shape[-1])
        return np.partition(needed, -1 - few, axis=-1)[..., -1 - few].max(axis=0)


def _extent(low: Values, high: Values) -> float:
    """Longest side of the box around boxes [T,3], m."""
    return float((high.max(axis=0) - low.min(axis=0)).max())
