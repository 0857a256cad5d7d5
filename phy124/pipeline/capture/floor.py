"""Finds the floor of a captured scene by random sampling (RANSAC; Fischler and Bolles 1981, "Random
sample consensus").

Each trial plane passes through three random points. The plane with the most points near it is then
fitted to these points by least squares.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError

TRIALS = 2000
"""Number of trial planes; a floor with a fifth of all points is missed with probability 1e-7."""
SAMPLE = 4000
"""Number of points with which each trial plane is tested."""
THICKNESS = 0.02
"""Points belong to a trial plane up to this distance from the plane, relative to the scene's
spread.
"""
SIGMAS = 3.0
"""Points belong to the floor up to this distance from the floor, in standard deviations."""
MIN_FRACTION = 0.1
"""Smallest fraction of all points that must belong to a floor."""
MIN_ABOVE = 0.005
"""Smallest fraction of all points that must be above a floor. Of the floor's own points, about
0.13 % are more than `SIGMAS` above it.
"""
NEAR = 0.7071
"""Cosine of the largest angle between the floor's normal and a known up direction."""

Vectors = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Floor:
    """A plane `normal . x = offset`, and the thickness of the layer of points around the plane."""

    normal: Vectors
    """Unit vector that points up [3]."""
    offset: float
    """Distance from the origin along the normal, in the file's units."""
    tolerance: float
    """Points belong to the floor up to this distance from the floor, in the file's units."""

    def heights(self, points: NDArray) -> Vectors:
        """Return signed heights [N] of points [N,3] above the floor."""
        return points.astype(np.float64) @ self.normal - self.offset

    def holds(self, points: NDArray) -> NDArray[np.bool_]:
        """Return a mask [N] of the points [N,3] on the floor or below it."""
        return self.heights(points) <= self.tolerance


def find_floor(points: NDArray, up: Vectors | None = None) -> Floor:
    """Find the floor of a scene, in any units and orientation, from points [N,3].

    With an approximate direction `up`, steep planes such as walls are rejected, and the floor is
    searched below planes that have more points below than above, such as ceilings. Otherwise, up is
    the side of the plane with more points.

    Raises:
        InputError: No plane contains enough points, nothing is above the plane, or the plane is
            smaller than the object on top.
    """
    x = np.asarray(points, np.float64)
    floor = _find_plane(x, up)
    while up is not None and _is_ceiling(x, floor):
        x = x[floor.heights(x) < -floor.tolerance]
        floor = _find_plane(x, up)
    _check(x, floor, len(points))
    return floor


def _is_ceiling(x: Vectors, plane: Floor) -> bool:
    heights = plane.heights(x)
    below, above = (heights < -plane.tolerance).sum(), (heights > plane.tolerance).sum()
    # Some floaters may be below the floor of a small object.
    return bool(below > max(above, MIN_FRACTION * len(x)))


def _find_plane(x: Vectors, up: Vectors | None) -> Floor:
    if len(x) < 3:
        raise _none("there are too few Gaussians.")
    middle = np.median(x, axis=0)
    spread = _spread(x - middle)
    if not spread > 0:
        raise _none("there are too few Gaussians.")
    normals, offsets = _trials((x - middle) / spread, up, np.random.default_rng(0))
    if not len(normals):
        raise _none("no plane has a normal close to the given up direction.")
    some = ((x - middle) / spread)[:: 1 + len(x) // SAMPLE]
    best = max(range(len(normals)), key=lambda i: _near(some, normals[i], offsets[i], THICKNESS))
    normal, offset, tolerance = _fit((x - middle) / spread, normals[best], offsets[best])
    above = (x - middle) / spread @ normal - offset
    rest = np.abs(above) > tolerance
    against = up @ normal < 0 if up is not None else (above[rest] < 0).sum() > rest.sum() / 2
    sign = -1.0 if against else 1.0
    return Floor(
        sign * normal, float(sign * (offset * spread + middle @ normal)), float(tolerance * spread)
    )


def _trials(x: Vectors, up: Vectors | None, rng: np.random.Generator) -> tuple[Vectors, Vectors]:
    a, b, c = x[rng.integers(0, len(x), (3, TRIALS))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    # Three points that lie nearly on a line do not define a plane.
    good = length > 1e-3 * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    good &= length > 0
    normals = normals[good] / length[good, None]
    offsets = (normals * a[good]).sum(axis=1)
    if up is None:
        return normals, offsets
    level = np.abs(normals @ up) >= NEAR
    return normals[level], offsets[level]


def _near(x: Vectors, normal: Vectors, offset: float, tolerance: float) -> int:
    return int((np.abs(x @ normal - offset) <= tolerance).sum())


def _fit(x: Vectors, normal: Vectors, offset: float) -> tuple[Vectors, float, float]:
    """Fit a plane to the points near a given plane; return the normal, the offset, and the largest
    distance of points that belong to the fitted plane.
    """
    tolerance = THICKNESS
    for _ in range(12):
        on = x[np.abs(x @ normal - offset) <= tolerance]
        centre = on.mean(axis=0)
        fitted = np.linalg.eigh(np.cov((on - centre).T))[1][:, 0]
        normal = fitted if fitted @ normal > 0 else -fitted
        offset = float(normal @ centre)
        # Objects that stand on the floor do not affect the median.
        deviation = 1.4826 * float(np.median(np.abs(on @ normal - offset)))
        tolerance = min(max(SIGMAS * deviation, 1e-4), 3 * THICKNESS)
    return normal, offset, tolerance


def _check(x: Vectors, floor: Floor, total: int) -> None:
    heights = floor.heights(x)
    on, above = np.abs(heights) <= floor.tolerance, heights > floor.tolerance
    if on.sum() < MIN_FRACTION * total:
        raise _none(f"the best plane contains only {on.sum() / total:.0%} of the Gaussians.")
    if above.sum() < MIN_ABOVE * total:
        raise _none(f"only {above.sum() / total:.1%} of the Gaussians are above the best plane.")
    flat = x - heights[:, None] * floor.normal
    reach = [_spread(flat[part] - np.median(flat[part], axis=0)) for part in (on, above)]
    if reach[0] <= reach[1]:
        raise _none("the best plane is no larger than the object on it.")


def _spread(x: Vectors) -> float:
    """Return the median length of vectors, which outliers hardly affect; 0 without vectors."""
    return float(np.median(np.linalg.norm(x, axis=1))) if len(x) else 0.0


def _none(limit: str) -> InputError:
    return InputError(
        "floor", "wanted", f"no floor was found: {limit}",
        "Keep only the object and its floor with --crop, give the up direction with --up, or leave "
        "--floor out.",
    )  # fmt: skip
