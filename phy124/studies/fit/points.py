"""Compares tracked points (positions over time in m or pixels) with a clip."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.studies.fit.observation import Groups, Table, Values, at_times, divide

NEIGHBOURS = 4
"""Number of Gaussians whose weighted mean predicts the position of a point."""
FAR = 0.2
"""Maximum distance between a point and the object, as a fraction of the object's size."""
PLACES = (
    "Give positions in the scene (metres, z up, the object over the origin), or in the pictures of "
    "--side (pixels)."
)
"""Remedy for points of a file that are far from the object."""


class Points:
    """Measured positions of tracked points over time.

    Each point is attached to the nearest Gaussians in the first frame. The mean of each track is
    subtracted, because an error in the first measurement would shift the whole predicted track.
    """

    def __init__(
        self,
        table: Table,
        rest: Values,
        cameras: Sequence[Camera] | None = None,
        *,
        remedy: str = PLACES,
    ) -> None:
        """Attach measured points (x, y, z in metres, or u, v in pixels) to the object's Gaussians.

        Args:
            table: The measured positions.
            rest: Centres of the Gaussians in the first frame [N,3], m.
            cameras: Camera of each frame, for positions in pixels.
            remedy: Remedy in the message about a point that is far from the object.

        Raises:
            InputError: A point is missing at the first time, or is not on the object.
        """
        self.unit, self.cameras = "m" if cameras is None else "px", cameras
        self.name = "points" if cameras is None else "pixels"
        names, self._track = np.unique(table.names, return_inverse=True)
        self._times, self.last = table.times, float(table.times.max())
        first = _first(table, names, self._track)
        if cameras is None:
            chosen = _nearest(first, rest, remedy)
        else:
            chosen = _seen(first, rest, cameras[0], remedy)
        self.chosen, self.weights = chosen
        width = table.values.shape[1]
        self.measured = self._shape(table.values)
        self.groups: Groups = np.repeat(divide(self._track, table.times), width)

    def predict(self, clip: Clip) -> Values:
        """Predict the positions of the points [M] from a clip."""
        means = clip.means[:, self.chosen.ravel()].astype(np.float64)
        shape = (len(means), *self.chosen.shape, 3)
        tracks = (means.reshape(shape) * self.weights[None, :, :, None]).sum(2)
        if self.cameras is not None:
            seen = zip(self.cameras, tracks, strict=False)
            tracks = np.stack([camera.project(points)[0] for camera, points in seen])
        instants, row = np.unique(self._times, return_inverse=True)
        return self._shape(at_times(clip.times, tracks, instants)[row, self._track])

    def _shape(self, values: Values) -> Values:
        """Subtract the mean of each point's positions [R,C]; return a vector [M]."""
        counts = np.bincount(self._track)[:, None]
        sums = np.stack([np.bincount(self._track, column) for column in values.T], axis=1)
        return (values - (sums / counts)[self._track]).ravel()


def _first(table: Table, names: NDArray[np.str_], track: NDArray) -> Values:
    start = np.flatnonzero(table.times <= table.times.min() + 1e-9)
    places = {int(track[row]): table.values[row] for row in start}
    missing = [name for number, name in enumerate(names) if number not in places]
    if missing:
        limit = f"point {missing[0]} is not seen at the first time, {table.times.min():g} s."
        raise InputError(
            "target", f"{len(names)} points", limit, "Remove points that appear only later."
        )
    if len(np.unique(table.times)) < 2:
        limit = "all measurements have the same time."
        raise InputError(
            "target", f"{len(names)} points", limit, "Give measurements at two or more times."
        )
    return np.stack([places[number] for number in range(len(names))])


def _nearest(first: Values, rest: Values, remedy: str) -> tuple[NDArray[np.int64], Values]:
    """Return the Gaussians nearest to each of K points, and weights [K,NEIGHBOURS]."""
    distance, chosen, size = _query(rest, first, NEIGHBOURS, "of the object's size", remedy)
    weights = 1 / (distance + 1e-6 * size)
    return chosen, weights / weights.sum(1, keepdims=True)


def _seen(
    first: Values, rest: Values, camera: Camera, remedy: str
) -> tuple[NDArray[np.int64], Values]:
    """Return the visible Gaussians nearest to each point's pixel, and weights [K,NEIGHBOURS]."""
    pixels, depth = camera.project(rest)
    of_what = "of the object's size in the picture"
    distance, near, _ = _query(pixels, first, 8 * NEIGHBOURS, of_what, remedy)
    deep = depth[near]
    front = deep <= deep.min(1, keepdims=True) + np.median(np.ptp(deep, axis=1)) / 4
    order = np.argsort(np.where(front, distance, np.inf), axis=1)[:, :NEIGHBOURS]
    chosen = np.take_along_axis(near, order, 1)
    weights = np.take_along_axis(np.where(front, 1 / (distance + 1.0), 0.0), order, 1)
    return chosen, weights / weights.sum(1, keepdims=True)


def _query(
    rest: Values, first: Values, count: int, of_what: str, remedy: str
) -> tuple[Values, NDArray[np.int64], float]:
    """Return distances and indices of the Gaussians nearest to K points [K,count], and the object's
    size.
    """
    from scipy.spatial import KDTree

    count = min(count, len(rest))
    distance, near = KDTree(rest).query(first, k=count)
    distance, near = distance.reshape(-1, count), near.reshape(-1, count)
    size = float(np.ptp(rest, axis=0).max())
    worst = float(distance[:, 0].max() / size)
    if worst > FAR:
        limit = f"a point is {worst:.2g} {of_what} away from the object at the first time."
        raise InputError("target", f"{len(distance)} points", limit, remedy)
    return distance, near, size
