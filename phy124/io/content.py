"""What a file of Gaussians contains, and the checks that all readers share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import SH_COEFFICIENTS, Gaussians
from phy124.io.opening import obstacle

MAX_GAUSSIANS = 10_000_000
"""Files with more Gaussians are refused before they are read."""
DENSEST = 100
"""Bytes that one byte of a compressed file may stand for: real objects reach 10, bombs 1000."""
SMALL = 1 << 22
"""Bytes that any file may stand for, so that a small object of one colour is no bomb."""
OBJECT = "object_id"
"""Column that says which object of its scene a Gaussian belongs to."""
LARGEST_SH = SH_COEFFICIENTS[-1]
"""Harmonics that are kept per colour; those of degree 4 are left out."""
DEGREE_4 = "Harmonics of degree 4 are left out."
MOST_ID = 1e6
"""Larger object numbers, which float32 can hardly distinguish, are read as this number."""
Y_DOWN = ("-y", "-z")
"""Axes that point up and to the front in files of 3DGS and its relatives."""
Y_UP = ("y", "z")
"""The same where y is up: glTF, SPZ."""
AGAIN = "Copy or download it again."


class Content(NamedTuple):
    """What a file contained."""

    gaussians: Gaussians
    """The Gaussians; as a reader returns them, in the axes of the file."""
    dropped: int = 0
    """Number of Gaussians left out because a value was NaN or infinite."""
    axes: tuple[str, str | None] = Y_DOWN
    """Directions of the file that point up and to the front; None: the usual one for that up."""
    antialiased: bool = False
    """Whether the file asks for Mip-Splatting's filter: its Gaussians were trained with it."""
    notes: tuple[str, ...] = ()
    """Sentences about columns that are ignored, or read in an unusual way."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the Gaussians' origin, in the file's axes. It differs from 0 only if the file's
    positions are so far away that float32 could not distinguish them."""
    step: float = 0.0
    """Smallest distance that the file can resolve; 0: too small to matter."""

    @property
    def in_place(self) -> Content:
        """The content with the Gaussians at the file's positions, if float32 resolves them."""
        means = move_back(self.gaussians.means, np.array(self.origin)) if any(self.origin) else None
        if means is None:
            return self
        moved = replace(self.gaussians, means=means)
        return self._replace(gaussians=moved, origin=(0.0, 0.0, 0.0))

    def remarks(self, chosen: Gaussians | None = None) -> list[str]:
        """Return the notes, and a sentence if the file's numbers are too coarse.

        Args:
            chosen: Those of the Gaussians that are used; None: all.
        """
        means = (self.gaussians if chosen is None else chosen).means
        coarse = describe_coarseness(means, self.step)
        return [*self.notes, *([coarse] if coarse else [])]


def refusal(kind: str, path: Path, limit: str, remedy: str = AGAIN) -> InputError:
    """Return the error for an unusable file.

    Args:
        kind: Name of the format, such as "SPZ".
        path: The file.
        limit: A sentence that says what is wrong, from a lower-case letter.
        remedy: A sentence that says what to do.
    """
    return InputError(f"{kind} file", path, limit[0].upper() + limit[1:], remedy)


def check_opens(kind: str, path: Path) -> None:
    """Refuse a file that cannot be opened.

    Raises:
        InputError: The file cannot be opened.
    """
    if hindrance := obstacle(path):
        raise refusal(kind, path, *hindrance)


def read_whole_file(kind: str, path: Path) -> bytes:
    """Return the bytes of a file.

    Raises:
        InputError: If the file is missing or empty.
    """
    check_opens(kind, path)
    data = path.read_bytes()
    if not data:
        raise refusal(kind, path, "it is empty (0 bytes).")
    return data


def check_count(kind: str, path: Path, count: int, row: int, size: int) -> None:
    """Refuse a wrong number of Gaussians before memory is allocated for them.

    Args:
        kind: Name of the format.
        path: The file.
        count: Number of Gaussians that it announces.
        row: Bytes that a Gaussian takes when unpacked.
        size: Bytes of the file.

    Raises:
        InputError: If there are none, too many, or more than such a file can hold.
    """
    if count < 1:
        raise refusal(kind, path, "it holds no Gaussians.", "Export it again with Gaussians.")
    if count > MAX_GAUSSIANS:
        limit = f"it announces {count:,} Gaussians; the limit is {MAX_GAUSSIANS:,}."
        raise refusal(kind, path, limit, "Reduce it in a splat editor, for example SuperSplat.")
    if count * row > SMALL + DENSEST * size:
        limit = f"it announces {count:,} Gaussians, which {size:,} bytes cannot hold."
        raise refusal(kind, path, limit)


def drop_non_finite(raw: dict[str, NDArray]) -> tuple[Gaussians, int]:
    """Return the Gaussians of all finite rows, and the number of rows left out.

    Quaternions are normalised; those of length 0 become the identity.
    """
    good = np.ones(len(raw["means"]), bool)
    with np.errstate(over="ignore", invalid="ignore"):
        for value in raw.values():
            # A row with a NaN has no finite sum; summing is much quicker than testing each value.
            good &= np.isfinite(value.reshape(len(value), -1).sum(axis=1, dtype=np.float64))
    kept = {name: value[good] for name, value in raw.items()} if not good.all() else raw
    gaussians = Gaussians(**{**kept, "quats": normalise_quats(kept["quats"])})
    return gaussians, int(np.count_nonzero(~good))


def normalise_quats(quats: NDArray) -> NDArray[np.float32]:
    """Scale quaternions [N,4] to length 1; those of length 0 become the identity."""
    length = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    zero = length[:, 0] < 1e-12
    with np.errstate(invalid="ignore"):  # infinite values become NaN
        units = (quats / np.where(length > 0, length, 1)).astype(np.float32)
    units[zero] = 1, 0, 0, 0
    return units


def content_of(
    kind: str,
    path: Path,
    raw: dict[str, NDArray],
    axes: tuple[str, str | None] = Y_DOWN,
    *,
    antialiased: bool = False,
    notes: Iterable[str] = (),
    step: float | None = None,
) -> Content:
    """Return the content of a file from its activated columns.

    Args:
        kind: Name of the format.
        path: The file.
        raw: Columns by the names of `Gaussians`; `means` as exactly as the file has them, and
            `object_id` may be NaN or negative.
        axes: Directions of the file that point up and to the front.
        antialiased: Whether the file asks for Mip-Splatting's filter.
        notes: Sentences about the file.
        step: Smallest distance that the file resolves; None: that of float32, if its centres are.

    Raises:
        InputError: If no Gaussian has finite values.
    """
    step = step_of(raw["means"]) if step is None else step
    means, origin = centre_means(raw["means"])
    ids, remarks = assign_objects(raw.get(OBJECT), means)
    with np.errstate(over="ignore", invalid="ignore"):  # What is too large becomes infinite.
        names = raw.keys() - {"means", OBJECT}
        others = {name: raw[name].astype(np.float32) for name in names}
    gaussians, dropped = drop_non_finite({"means": means, **others, **ids})
    if not len(gaussians):
        limit = "none of its Gaussians has finite values."
        raise refusal(kind, path, limit, "Export it once more.")
    x, y, z = origin.tolist()
    return Content(gaussians, dropped, axes, antialiased, (*notes, *remarks), (x, y, z), step)


def assign_objects(
    ids: NDArray | None, means: NDArray[np.float32]
) -> tuple[dict[str, NDArray[np.int32]], list[str]]:
    """Return the column of each Gaussian's object, if there is any, and notes about it.

    A Gaussian without an object gets the object of the nearest Gaussian that has one.

    Args:
        ids: Numbers of objects [N] as a file has them; NaN and negative ones are none.
        means: Centres [N,3].
    """
    if ids is None:
        return {}, []
    some = np.isfinite(ids) & (ids >= 0)
    objects = np.where(some, ids, 0).clip(0, MOST_ID).astype(np.int32)
    lost = ~some & np.isfinite(means).all(axis=1)
    if not lost.any():
        return {OBJECT: objects}, []
    known = some & np.isfinite(means).all(axis=1)
    count = f"{np.count_nonzero(lost):,} Gaussians name no object ({OBJECT} is NaN or negative)"
    if not known.any():
        return {}, [f"{count}: all are read as one object."]
    from scipy.spatial import KDTree

    objects[lost] = objects[known][KDTree(means[known]).query(means[lost])[1]]
    return {OBJECT: objects}, [f"{count}; each belongs to the object of its nearest neighbour."]


FAR = 4
"""Distance from the origin, relative to the object's size, from which float32 is too coarse for
centres in double precision."""
FINE = 20_000
"""Steps of float32 across an object from which its centres need no origin of their own."""
COARSE = 4000
"""Steps across an object below which a note calls its file too coarse."""
ENOUGH = 100_000
"""Number of centres that are examined."""
LARGEST = 1e38
"""About the largest value of float32."""
ENDS = (1, 99)
"""Percentiles between which an object lies, so that single outliers do not count."""


def centre_means(means: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return centres [N,3] relative to an origin [3], and that origin.

    The origin is 0 unless the centres are so far away that float32 could not resolve the object.
    (float32 has 24 bits: its values are half a metre apart at 4,600 km from the origin, where
    Earth-centred captures lie.) It is subtracted in double precision.
    """
    middle, extent = _middle(means)
    blurred = extent < FINE * spacing(middle)
    if not step_of(means):
        blurred |= FAR * extent < np.abs(middle).max()
    origin = np.zeros(3)
    if blurred and extent > 0:
        # A multiple of a power of two, so that centres given in float32 lose nothing.
        normalise_quats = 2.0 ** np.ceil(np.log2(extent))
        origin = np.rint(middle / normalise_quats) * normalise_quats
    with np.errstate(over="ignore", invalid="ignore"):
        near = means.astype(np.float64) - origin if origin.any() else means
        return near.astype(np.float32), origin


def move_back(
    means: NDArray[np.float32], origin: NDArray[np.float64]
) -> NDArray[np.float32] | None:
    """Add the origin [3] to centres [N,3]; None if float32 could not resolve the result."""
    exact = means.astype(np.float64) + origin
    rounded = exact.astype(np.float32)
    middle, extent = _middle(exact)
    resolved = np.array_equal(rounded, exact) or extent >= FINE * spacing(middle)
    return rounded if resolved else None


def step_of(means: NDArray) -> float:
    """Distance of neighbouring values where centres [N,3] are float32 numbers, else 0."""
    some = _some(means)
    if not len(some) or not np.array_equal(some, some.astype(np.float32)):
        return 0.0
    return spacing(_middle(means)[0])


def describe_coarseness(means: NDArray, step: float) -> str | None:
    """Return a sentence if a file's steps are too coarse for the object in it, else None.

    Args:
        means: Centres [N,3], from any origin.
        step: Distance of neighbouring values in the file.
    """
    extent = _middle(means)[1]
    if not step or extent >= COARSE * step or len(means) < 2:
        return None
    across = max(round(extent / step), 1)
    return (
        f"The file's positions come in steps of {step:.2g}, about {across:,} across the object, "
        "which is too coarse. Export it in double precision, or nearer to the origin."
    )


def spacing(place: NDArray) -> float:
    """Distance of neighbouring float32 values at a position [3], along its farthest axis."""
    return float(np.spacing(np.float32(np.abs(place).max())))


def _middle(means: NDArray) -> tuple[NDArray[np.float64], float]:
    """Median centre of an object [3], and the length of its longest side."""
    some = _some(means)
    if not len(some):
        return np.zeros(3), 0.0
    low, middle, high = np.percentile(some, [ENDS[0], 50, ENDS[1]], axis=0)
    return middle, float((high - low).max())


def _some(means: NDArray) -> NDArray[np.float64]:
    """Sample centres from the whole file, without those that overflow float32."""
    some = means[:: max(1, len(means) // ENOUGH)].astype(np.float64)
    return some[(np.abs(some) < LARGEST).all(axis=1)]
