"""Defines the content of a file of Gaussians, and the checks that all readers use."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import BLOCK, SH_COEFFICIENTS, Gaussians, finite_rows
from phy124.io.opening import obstacle
from phy124.runtime.memory import MEMORY_FRACTION, free_memory

MAX_GAUSSIANS = 50_000_000
"""Largest number of Gaussians in a file; larger files are refused before they are read."""
READING = 250
"""Memory that a Gaussian of degree 0 needs while a binary file is read [bytes]."""
RUNNING = 600
"""Memory that a Gaussian needs in a whole run [bytes]; measured in docs/results/scale.md."""
MOST_KEPT = 5_000_000
"""Largest value of --gaussians."""
DENSEST = 100
"""Largest allowed ratio of unpacked to compressed size. The ratio is up to 10 for files of real
objects, and 1000 for zip bombs.
"""
SMALL = 1 << 22
"""Files up to this unpacked size [bytes] may exceed `DENSEST`, because small objects of one colour
compress very well.
"""
OBJECT = "object_id"
LARGEST_SH = SH_COEFFICIENTS[-1]
"""Largest number of harmonics per colour channel (degree 3)."""
DEGREE_4 = "Harmonics of degree 4 are ignored."
MOST_ID = 1e6
"""Largest object number; larger numbers are clipped, because float32 cannot resolve them."""
Y_DOWN = ("-y", "-z")
"""Up and front directions in files of 3DGS and related programs."""
Y_UP = ("y", "z")
"""Up and front directions in glTF and SPZ files, where y is up."""
AGAIN = "Copy or download the file again."
_kept: ContextVar[float] = ContextVar("kept", default=0)
"""The current run's limit on the number of Gaussians from a file; 0 if there is no run."""


class Content(NamedTuple):
    """The Gaussians of a file, and properties of the file."""

    gaussians: Gaussians
    dropped: int = 0
    """Number of Gaussians that were removed because a value was NaN or infinite."""
    axes: tuple[str, str | None] = Y_DOWN
    """Up and front directions of the file; if the front is None, `axes.FRONTS` states the front."""
    antialiased: bool = False
    """Whether the Gaussians were trained with Mip-Splatting's filter, and must be drawn with it."""
    notes: tuple[str, ...] = ()
    """Sentences about columns that are ignored or read in an unusual way."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the coordinates of `gaussians`, in the file's axes; nonzero only if float32 could
    not resolve the positions in the file.
    """
    step: float = 0.0
    """Spacing of the positions that the file can represent near the object; 0 if negligible."""

    @property
    def in_place(self) -> Content:
        """This content with absolute positions, or unchanged if float32 cannot resolve them."""
        means = move_back(self.gaussians.means, np.array(self.origin)) if any(self.origin) else None
        if means is None:
            return self
        moved = replace(self.gaussians, means=means)
        return self._replace(gaussians=moved, origin=(0.0, 0.0, 0.0))

    def remarks(self, chosen: Gaussians | None = None) -> list[str]:
        """Return the notes, and a warning if the precision of the positions is too low.

        The positions of `chosen` are examined; by default, the positions of all Gaussians.
        """
        means = (self.gaussians if chosen is None else chosen).means
        coarse = describe_coarseness(means, self.step)
        return [*self.notes, *([coarse] if coarse else [])]


def refusal(kind: str, path: Path, limit: str, remedy: str = AGAIN) -> InputError:
    """Return the error that says why a file is unusable.

    Args:
        kind: Name of the format, such as "SPZ".
        path: The file.
        limit: A clause that states what is wrong; its first letter may be lower-case.
        remedy: A sentence that states how to correct the file.
    """
    return InputError(f"{kind} file", path, limit[0].upper() + limit[1:], remedy)


class Malformed(ValueError):
    """Raised if a file contradicts its format; the message is a clause that names the fault."""


def name_fault(error: Exception) -> str:
    """Return a clause that describes a file's fault, without the wording of Python's exception."""
    if isinstance(error, Malformed):
        return str(error)
    if isinstance(error, KeyError):
        return f'"{str(error.args[0])[:80]}" is missing'
    return "a value has the wrong type or size"


def check_opens(kind: str, path: Path) -> None:
    """Check that a file can be opened.

    Raises:
        InputError: If the file cannot be opened.
    """
    if hindrance := obstacle(path):
        raise refusal(kind, path, *hindrance)


def read_whole_file(kind: str, path: Path) -> bytes:
    """Return the bytes of a file.

    Raises:
        InputError: If the file cannot be opened or is empty.
    """
    check_opens(kind, path)
    data = path.read_bytes()
    if not data:
        raise refusal(kind, path, "it is empty (0 bytes).")
    return data


def check_count(kind: str, path: Path, count: int, row: int, size: int) -> None:
    """Refuse an impossible number of Gaussians, before memory is allocated for them.

    Args:
        kind: Name of the format.
        path: The file.
        count: Number of Gaussians that the file's header states.
        row: Size of one unpacked Gaussian [bytes].
        size: Size of the file [bytes].

    Raises:
        InputError: If `count` is below 1, above the limit, or too large for the size of the file or
            for the free memory.
    """
    if count < 1:
        raise refusal(
            kind,
            path,
            "it contains no Gaussians.",
            "Export the file again, including its Gaussians.",
        )
    check_size(kind, path, count)
    if count * row > SMALL + DENSEST * size:
        limit = (
            f"its header states {count:,} Gaussians, which is more than {size:,} bytes can hold."
        )
        raise refusal(kind, path, limit)


@contextmanager
def for_run(most: float = math.inf) -> Iterator[None]:
    """Within this context, read files of Gaussians for a run that keeps at most `most` Gaussians.

    A file is refused before it is read if such a run would need more memory than is available.
    Nested contexts can only reduce the number.
    """
    token = _kept.set(min(most, _kept.get() or math.inf))
    try:
        yield
    finally:
        _kept.reset(token)


def check_size(kind: str, path: Path, count: int, *, more: float = 0.0) -> None:
    """Refuse a file with too many Gaussians for the limit or for the free memory.

    Args:
        kind: Name of the format.
        path: The file.
        count: Number of Gaussians that the file's header states.
        more: Memory per Gaussian while the file is read, in addition to `READING` [bytes].

    Raises:
        InputError: If there are too many Gaussians.
    """
    remedy = "Reduce the number of Gaussians in a splat editor, for example SuperSplat."
    if count > MAX_GAUSSIANS:
        limit = f"its header states {count:,} Gaussians; the limit is {MAX_GAUSSIANS:,}."
        raise refusal(kind, path, limit, remedy)
    needed, free = (READING + more) * count, free_memory()
    if needed > free:
        limit = f"reading its {count:,} Gaussians needs about {needed / 1e9:.1f} GB of memory, and "
        raise refusal(kind, path, f"{limit}{free / 1e9:.1f} GB are free.", remedy)
    kept = min(count, _kept.get())
    needed, free = RUNNING * kept, MEMORY_FRACTION * free
    if needed > free:
        limit = f"a run of {kept:,} Gaussians needs about {needed / 1e9:.1f} GB of memory, and "
        limit += f"{free / 1e9:.1f} GB may be used ({MEMORY_FRACTION:.0%} of the free memory)."
        fewer = min(max(int(free / RUNNING), 1), MOST_KEPT)
        fewer -= fewer % 10 ** max(len(str(fewer)) - 2, 0)  # two significant digits
        raise refusal(
            kind,
            path,
            limit,
            f"Set --gaussians to {fewer} or fewer, or reduce the file in a splat editor.",
        )


def drop_non_finite(raw: dict[str, NDArray]) -> tuple[Gaussians, int]:
    """Return the Gaussians whose values are all finite, and the number of the other Gaussians.

    Quaternions are normalised; a quaternion of length 0 becomes the identity.
    """
    good = np.ones(len(raw["means"]), bool)
    with np.errstate(over="ignore", invalid="ignore"):
        for value in raw.values():
            good &= finite_rows(value)
    kept = {name: value[good] for name, value in raw.items()} if not good.all() else raw
    gaussians = Gaussians(**{**kept, "quats": normalise_quats(kept["quats"])})
    return gaussians, int(np.count_nonzero(~good))


def normalise_quats(quats: NDArray) -> NDArray[np.float32]:
    """Normalise quaternions [N,4]; a quaternion of length 0 becomes the identity."""
    units = np.empty(quats.shape, np.float32)
    for start in range(0, len(quats), BLOCK):
        some = quats[start : start + BLOCK]
        with np.errstate(invalid="ignore"):  # signalling NaNs stay NaN, infinite values become NaN
            length = np.linalg.norm(some.astype(np.float64), axis=1, keepdims=True)
            unit = (some / np.where(length > 0, length, 1)).astype(np.float32)
        unit[length[:, 0] < 1e-12] = 1, 0, 0, 0
        units[start : start + BLOCK] = unit
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
    """Build the content of a file from decoded columns (scales as lengths, opacities in 0..1).

    Args:
        kind: Name of the format.
        path: The file.
        raw: Columns by name; the names are the fields of `Gaussians`. `means` has the file's full
            precision; `object_id` may be NaN or negative.
        axes: Up and front directions of the file.
        antialiased: Whether the file requests Mip-Splatting's filter.
        notes: Sentences about the file.
        step: Smallest distance that the file can represent; if None, `step_of` computes it.

    Raises:
        InputError: If no Gaussian has finite values.
    """
    step = step_of(raw["means"]) if step is None else step
    means, origin = centre_means(raw["means"])
    ids, remarks = assign_objects(raw.get(OBJECT), means)
    with np.errstate(over="ignore", invalid="ignore"):  # values that exceed float32 become infinite
        names = raw.keys() - {"means", OBJECT}
        others = {name: raw[name].astype(np.float32, copy=False) for name in names}
    gaussians, dropped = drop_non_finite({"means": means, **others, **ids})
    if not len(gaussians):
        limit = "none of its Gaussians has finite values."
        raise refusal(kind, path, limit, "Export the file again.")
    x, y, z = origin.tolist()
    return Content(gaussians, dropped, axes, antialiased, (*notes, *remarks), (x, y, z), step)


def assign_objects(
    ids: NDArray | None, means: NDArray[np.float32]
) -> tuple[dict[str, NDArray[np.int32]], list[str]]:
    """Return the object index of each Gaussian (None if there are no objects), and notes.

    A Gaussian whose entry in `ids` [N] is NaN or negative gets the index of the nearest Gaussian
    with a valid index.
    """
    if ids is None:
        return {}, []
    some = np.isfinite(ids) & (ids >= 0)
    objects = np.where(some, ids, 0).clip(0, MOST_ID).astype(np.int32)
    lost = ~some & np.isfinite(means).all(axis=1)
    if not lost.any():
        return {OBJECT: objects}, []
    known = some & np.isfinite(means).all(axis=1)
    count = (
        f"{np.count_nonzero(lost):,} Gaussians belong to no object ({OBJECT} is NaN or negative)"
    )
    if not known.any():
        return {}, [f"{count}: all are read as one object."]
    from scipy.spatial import KDTree

    objects[lost] = objects[known][KDTree(means[known]).query(means[lost])[1]]
    return {OBJECT: objects}, [f"{count}; each is assigned to the object of its nearest neighbour."]


FAR = 4
"""float32 is precise enough if an object's distance from the origin is at most this many times its
size.
"""
FINE = 20_000
"""float32 is precise enough if it divides the object's size into at least this many increments."""
COARSE = 4000
"""With fewer increments than this across an object, the user is warned."""
ENOUGH = 100_000
"""Approximate number of centres in the sample from which position and size are estimated."""
LARGEST = 1e38
"""Centres with coordinates above this value are ignored; the largest value of float32 is 3.4e38."""
ENDS = (1, 99)
"""Percentiles of the coordinates that count as the ends of an object; outliers are ignored."""


def centre_means(means: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return centres [N,3] relative to an origin [3], and this origin.

    The origin is 0 unless float32 could not resolve the object. Earth-centred captures, for
    example, have a coordinate of 4,600 km or more, where float32 values are half a metre apart.
    """
    middle, extent = _middle(means)
    blurred = extent < FINE * spacing(middle)
    if not step_of(means):
        blurred |= FAR * extent < np.abs(middle).max()
    origin = np.zeros(3)
    if blurred and extent > 0:
        # The origin is a multiple of a power of two, so that float32 centres stay exact.
        unit = 2.0 ** np.ceil(np.log2(extent))
        origin = np.rint(middle / unit) * unit
    with np.errstate(over="ignore", invalid="ignore"):
        near = means.astype(np.float64) - origin if origin.any() else means
        return near.astype(np.float32, copy=False), origin


def move_back(
    means: NDArray[np.float32], origin: NDArray[np.float64]
) -> NDArray[np.float32] | None:
    """Add the origin [3] to centres [N,3]; return None if float32 cannot resolve the sum."""
    exact = means.astype(np.float64) + origin
    rounded = exact.astype(np.float32)
    middle, extent = _middle(exact)
    resolved = np.array_equal(rounded, exact) or extent >= FINE * spacing(middle)
    return rounded if resolved else None


def step_of(means: NDArray) -> float:
    """Return the spacing of float32 numbers at centres [N,3]; 0 if the centres have double
    precision.
    """
    some = _some(means)
    if not len(some) or not np.array_equal(some, some.astype(np.float32)):
        return 0.0
    return spacing(_middle(means)[0])


def describe_coarseness(means: NDArray, step: float) -> str | None:
    """Return a warning if positions in a file are too coarse for its object; otherwise None.

    The centres [N,3] are relative to any origin; `step` is the smallest distance in the file.
    """
    extent = _middle(means)[1]
    if not step or extent >= COARSE * step or len(means) < 2:
        return None
    across = max(round(extent / step), 1)
    return (
        f"The file stores positions in increments of {step:.2g}. With only about {across:,} "
        "increments across the object, the positions are too coarse. Export the scene in double "
        "precision, or nearer to the origin."
    )


def spacing(place: NDArray) -> float:
    """Return the distance between adjacent float32 values at a position's largest coordinate."""
    return float(np.spacing(np.float32(np.abs(place).max())))


def _middle(means: NDArray) -> tuple[NDArray[np.float64], float]:
    """Return the median of an object's centres [3], and the length of the object's longest side."""
    some = _some(means)
    if not len(some):
        return np.zeros(3), 0.0
    low, middle, high = np.percentile(some, [ENDS[0], 50, ENDS[1]], axis=0)
    return middle, float((high - low).max())


def _some(means: NDArray) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # signalling NaN raises a warning
        some = means[:: max(1, len(means) // ENOUGH)].astype(np.float64)
    return some[(np.abs(some) < LARGEST).all(axis=1)]
