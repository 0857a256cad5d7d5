"""Drops or repairs Gaussians that the simulation cannot use.

All thresholds are relative to the object's size. The rules apply in this order:

- Gaussians are dropped if a field contains NaN or infinity, or if a coordinate or scale is above
  `LARGEST`.
- Other invalid values are repaired: a negative scale becomes positive (the covariance does not
  change), a zero scale becomes `THINNEST` times the Gaussian's longest axis, a zero quaternion
  becomes the identity, any other quaternion is normalised, and an opacity above 1 becomes 1.
- Invisible Gaussians (opacity below one step of an 8-bit image, or no extent) are dropped.
- Gigantic Gaussians (longest axis above `GIGANTIC` times the object's longest side *and* above 20
  times the median longest axis) are dropped.
- Stray groups are dropped. A group of Gaussians is stray if it is both separate and small.
  Separate: its distance from the rest is more than about `GAP` times the longest side, and more
  than the usual distance between neighbours. Small: its number of Gaussians, or their
  `visible_area`, is less than the fraction `STRAY` of that of the largest group. An object may
  consist of many separate pieces.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import BLOCK, Gaussians, finite_rows, rotation_matrices

INVISIBLE = 1 / 255
THINNEST = 1e-6
GIGANTIC = 0.5
STRAY = 1e-3
GAP = 0.05
LARGEST = 1e18
WIDE = 16.0
"""Upper bound of the visible area of a Gaussian, relative to the median of all areas."""
VISIBLE = 0.1
"""Smallest opacity of a Gaussian that counts as part of the visible surface."""


@dataclass(frozen=True)
class Cleaning:
    """Numbers of Gaussians that `clean` dropped and repaired."""

    total: int
    not_finite: int = 0
    beyond: int = 0
    invisible: int = 0
    gigantic: int = 0
    stray: int = 0
    pieces: int = 0
    """Number of separate pieces to which the `stray` Gaussians belonged."""
    repaired_scales: int = 0
    repaired_quats: int = 0
    repaired_opacities: int = 0
    survivors: NDArray[np.bool_] | None = field(default=None, compare=False, repr=False)
    """Mask of the Gaussians that were kept; its length is `total`, the number before cleaning."""

    @property
    def dropped(self) -> int:
        """Number of Gaussians that were dropped."""
        return self.not_finite + self.beyond + self.invisible + self.gigantic + self.stray

    @property
    def kept(self) -> int:
        """Number of Gaussians that were kept."""
        return self.total - self.dropped

    @property
    def sentences(self) -> list[str]:
        """Messages for the report, one for each rule that dropped or changed Gaussians."""
        texts = {
            "not_finite": "had NaN or infinite values and were dropped",
            "beyond": f"had a coordinate or scale above {LARGEST:g} m and were dropped",
            "invisible": "were invisible (opacity under 1/255 or no extent) and were dropped",
            "gigantic": "were larger than half the object and were dropped",
            "stray": f"were in {self.pieces} separate pieces smaller than {STRAY:g} times the "
            "largest and were dropped",
            "repaired_scales": "had negative or zero scales, which were repaired",
            "repaired_quats": "had a quaternion of length zero, replaced by no rotation",
            "repaired_opacities": "had an opacity above 1, replaced by 1",
        }
        counts = {name: getattr(self, name) for name in texts}
        return [f"{n} of {self.total} Gaussians {texts[k]}." for k, n in counts.items() if n]

    @property
    def notes(self) -> list[str]:
        """Notes for the user: pieces that are missing in the videos."""
        if not self.pieces:
            return []
        pieces = "piece was" if self.pieces == 1 else "pieces were"
        return [
            f"{self.pieces} separate {pieces} left out ({self.stray} of {self.total} Gaussians), "
            f"because they are smaller than {STRAY:g} times the largest piece. To keep them, "
            "simulate them as further objects."
        ]


def clean(gaussians: Gaussians) -> tuple[Gaussians, Cleaning]:
    """Return the Gaussians that can be simulated and rendered, and the counts of changes.

    Raises:
        InputError: If no visible Gaussian is left.
    """
    total = len(gaussians)
    finite = _are_finite(gaussians)
    near = finite & _are_near(gaussians)
    usable, repairs = _repair(gaussians.select(near))
    visible = (usable.opacities >= INVISIBLE) & (usable.longest > 0)
    usable = usable.select(visible)
    huge = _are_gigantic(usable)
    usable = usable.select(~huge)
    stray, pieces = _find_stray(usable)
    usable = usable.select(~stray)
    survivors = np.zeros(total, bool)
    survivors[np.flatnonzero(near)[visible][~huge][~stray]] = True
    if len(usable) == 0:
        raise InputError(
            "gaussians",
            f"{total} Gaussians",
            f"none of them is finite, visible and within {LARGEST:g} m, so no object is left.",
            "Check the file, or try another picture or generator.",
        )
    return usable, Cleaning(
        total=total,
        not_finite=int((~finite).sum()),
        beyond=int((finite & ~near).sum()),
        invisible=int((~visible).sum()),
        gigantic=int(huge.sum()),
        stray=int(stray.sum()),
        pieces=pieces,
        survivors=survivors,
        **repairs,
    )


def visible_area(gaussians: Gaussians) -> NDArray[np.float32]:
    """Return the visible area of each Gaussian [N], m^2: opacity times area, with an upper bound.

    Without the bound, a background of large Gaussians, such as a sky, would outweigh the object.
    """
    cover = gaussians.cover
    return np.minimum(cover, WIDE * np.median(cover))


def compute_bounds(gaussians: Gaussians) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower and upper corner [3], m, of the box around all Gaussians up to one standard
    deviation.

    At each end of each axis, the outermost 0.1 % of the opacity is excluded, so that a few faint
    Gaussians do not affect the size.
    """
    every = 1 + len(gaussians) // 200_000
    some = gaussians.select(np.arange(len(gaussians)) % every == 0)
    means, reach = some.means.astype(np.float64), some.deviations()
    low = weighted_quantile(means - reach, some.opacities, 0.001)
    high = -weighted_quantile(-means - reach, some.opacities, 0.001)
    return low, high


def scale_to_size(gaussians: Gaussians, size: float, *, ground: bool = True) -> Gaussians:
    """Scale and shift the object (`size_transform`); its longest side becomes `size` [m]."""
    return gaussians.transform(*size_transform(gaussians, size, ground=ground))


def size_transform(
    gaussians: Gaussians, size: float, *, ground: bool = True
) -> tuple[float, NDArray[np.float64]]:
    """Return the scale and offset [3] that make the longest side `size` [m] and centre the object.

    If `ground` is set, the lowest visible point is placed at z = 0; otherwise, the object is also
    centred in z. Visible points are within one standard deviation of Gaussians with an opacity of
    at least 0.1.

    Raises:
        InputError: If the size is not positive.
    """
    if not (np.isfinite(size) and size > 0):
        raise InputError(
            "size",
            size,
            "the length of the longest side must be positive.",
            "Enter a length in metres, such as 1.0.",
        )
    low, high = compute_bounds(gaussians)
    scale = float(size / (high - low).max())
    offset = -scale * (low + high) / 2
    if ground:
        offset[2] = -scale * _lowest_height(gaussians)
    return scale, offset


def _are_finite(gaussians: Gaussians) -> NDArray[np.bool_]:
    names = ("means", "quats", "scales", "opacities", "sh")
    masks = [finite_rows(getattr(gaussians, name)) for name in names]
    return np.logical_and.reduce(masks)


def _are_near(gaussians: Gaussians) -> NDArray[np.bool_]:
    near = [
        (np.abs(values) <= LARGEST).all(axis=1) for values in (gaussians.means, gaussians.scales)
    ]
    return np.logical_and.reduce(near)


def _repair(gaussians: Gaussians) -> tuple[Gaussians, dict[str, int]]:
    """Return repaired Gaussians and counts of repairs; arrays without repairs are not copied."""
    arrays = {name: getattr(gaussians, name) for name in ("quats", "scales", "opacities")}
    repaired, counts = dict(arrays), dict.fromkeys(arrays, 0)
    for start in range(0, len(gaussians), BLOCK):
        block = slice(start, start + BLOCK)
        quats, scales, opacities = (array[block] for array in arrays.values())
        x, y, z = np.abs(scales).T
        least = THINNEST * np.maximum(np.maximum(x, y), z)
        length = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
        zero, off = length[:, 0] == 0, np.abs(length[:, 0] - 1) > 1e-6
        unit = quats.copy()
        unit[off] /= np.where(length[off] == 0, 1, length[off])
        unit[zero] = (1, 0, 0, 0)
        better = {
            "quats": unit,
            "scales": np.stack([np.maximum(axis, least) for axis in (x, y, z)], axis=1),
            "opacities": np.minimum(opacities, 1),
        }
        counts["quats"] += int(zero.sum())
        for name, values in better.items():
            changed = values != arrays[name][block]
            if not changed.any():
                continue
            if name != "quats":
                counts[name] += int(changed.reshape(len(changed), -1).any(axis=1).sum())
            if repaired[name] is arrays[name]:
                repaired[name] = arrays[name].copy()
            repaired[name][block] = values
    counts = {f"repaired_{name}": count for name, count in counts.items()}
    return replace(gaussians, **repaired), counts


def _are_gigantic(gaussians: Gaussians) -> NDArray[np.bool_]:
    if len(gaussians) == 0:
        return np.zeros(0, bool)
    longest = gaussians.longest.astype(np.float64)
    large = longest > 20 * np.median(longest)
    if not large.any():
        return large
    low = weighted_quantile(gaussians.means, gaussians.opacities, 0.001)
    high = -weighted_quantile(-gaussians.means, gaussians.opacities, 0.001)
    return large & (longest > GIGANTIC * (high - low).max())


def _find_stray(gaussians: Gaussians) -> tuple[NDArray[np.bool_], int]:
    """Return whether each Gaussian is stray [N], and the number of stray groups."""
    if len(gaussians) * STRAY < 1:
        return np.zeros(len(gaussians), bool), 0
    means = gaussians.means.astype(np.float64)
    low = weighted_quantile(means, gaussians.opacities, 0.005)
    high = -weighted_quantile(-means, gaussians.opacities, 0.005)
    side = (high - low).max()
    if side == 0:
        return np.zeros(len(gaussians), bool), 0
    # N points on a surface are about side / sqrt(N) apart; gaps between random points are up to a
    # few times as wide.
    cell = max(GAP / 2, 4 / np.sqrt(len(means)))
    # Gaussians that are farther away than half the object are assigned to the outermost cells.
    flat, shape = np.zeros(len(means), np.int64), []
    for along, first, last in zip(means.T, low, high, strict=True):
        cells = np.clip((along - first) / side, -0.5, (last - first) / side + 0.5) / cell
        index = np.floor(cells - cells.min()).astype(np.int64)
        shape.append(int(index.max()) + 1)
        flat = flat * shape[-1] + index
    occupied = (np.bincount(flat, minlength=int(np.prod(shape))) > 0).reshape(shape)
    groups, count = scipy.ndimage.label(occupied, np.ones((3, 3, 3)))  # pyright: ignore
    group = groups.ravel()[flat]
    members = np.bincount(group, minlength=count + 1)
    seen = np.bincount(group, visible_area(gaussians), minlength=count + 1)
    stray = (members < STRAY * members.max()) | (seen < STRAY * seen.max())
    return stray[group], int((stray & (members > 0)).sum())


def weighted_quantile(values: NDArray, weights: NDArray, fraction: float) -> NDArray[np.float64]:
    """Return a weighted quantile [3] of each column of `values` [N,3]."""
    weights = weights.astype(np.float64)
    below = fraction * weights.sum()
    return np.array([_weighted_quantile(column, weights, below, fraction) for column in values.T])


def _weighted_quantile(values: NDArray, weights: NDArray, below: float, fraction: float) -> float:
    values = np.ascontiguousarray(values, np.float64)
    # First sort only the lowest values, whose weight is usually sufficient.
    count = min(len(values), 8 + int(4 * fraction * len(values)))
    for lowest in (np.argpartition(values, count - 1)[:count], np.arange(len(values))):
        order = lowest[np.argsort(values[lowest])]
        first = int((np.cumsum(weights[order]) <= below).sum())
        if first < len(order):
            break
    return float(values[order[min(first, len(order) - 1)]])


def _lowest_height(gaussians: Gaussians) -> float:
    """Return the smallest height that a visible Gaussian reaches at one standard deviation [m]."""
    visible = gaussians.opacities >= VISIBLE
    some = gaussians.select(visible) if visible.any() else gaussians
    z = some.means[:, 2].astype(np.float64)
    # Only Gaussians whose longest axis reaches the lowest centre can contain the lowest point.
    near = z - some.longest <= z.min()
    axes = rotation_matrices(some.quats[near])[:, 2] * some.scales[near]
    return float((z[near] - np.linalg.norm(axes, axis=1)).min())
