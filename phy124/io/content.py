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
from phy124.io.precision import centred, in_place, step_of, too_coarse

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
"""Larger numbers of objects, which float32 hardly tells apart, are read as this one."""
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
    """Sentences about what of the file is read in another way than usual, or passed over."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Place of the Gaussians' origin, in the same axes. It is not 0 where the file's places are so
    far away that float32 could not tell them apart."""
    step: float = 0.0
    """Distance of neighbouring places that the file can tell apart; 0: too small to matter."""

    @property
    def in_place(self) -> Content:
        """The same with the Gaussians where the file has them, unless that would blur them."""
        means = in_place(self.gaussians.means, np.array(self.origin)) if any(self.origin) else None
        if means is None:
            return self
        moved = replace(self.gaussians, means=means)
        return self._replace(gaussians=moved, origin=(0.0, 0.0, 0.0))

    def remarks(self, chosen: Gaussians | None = None) -> list[str]:
        """The notes, and that the file is too coarse, if it is.

        Args:
            chosen: Those of the Gaussians that are used; None: all.
        """
        blurred = self.blurred(self.gaussians if chosen is None else chosen)
        return [*self.notes, *([blurred] if blurred else [])]

    def blurred(self, chosen: Gaussians) -> str | None:
        """A sentence if the file is too coarse for those of its Gaussians; else None."""
        return too_coarse(chosen.means, self.step)


def refusal(kind: str, path: Path, limit: str, remedy: str = AGAIN) -> InputError:
    """The error for an unusable file.

    Args:
        kind: Name of the format, such as "SPZ".
        path: The file.
        limit: A sentence that says what is wrong, from a lower-case letter.
        remedy: A sentence that says what to do.
    """
    return InputError(f"{kind} file", path, limit[0].upper() + limit[1:], remedy)


def refuse_unopened(kind: str, path: Path) -> None:
    """Make sure that a file can be opened.

    Raises:
        InputError: It cannot.
    """
    if hindrance := obstacle(path):
        raise refusal(kind, path, *hindrance)


def whole_file(kind: str, path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: If it is not there or is empty.
    """
    refuse_unopened(kind, path)
    data = path.read_bytes()
    if not data:
        raise refusal(kind, path, "it is empty (0 bytes).")
    return data


def check_count(kind: str, path: Path, count: int, row: int, size: int) -> None:
    """Refuse a number of Gaussians before memory is taken for them.

    Args:
        kind: Name of the format.
        path: The file.
        count: Number of Gaussians that it announces.
        row: Bytes that one of them takes when unpacked.
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


def finite(raw: dict[str, NDArray]) -> tuple[Gaussians, int]:
    """Gaussians from columns, without the rows that are not finite, and the number of those.

    Quaternions become unit; one of length 0 becomes the identity.
    """
    good = np.ones(len(raw["means"]), bool)
    with np.errstate(over="ignore", invalid="ignore"):
        for value in raw.values():
            # A sum is finite if all are (or overflows, which is no less wrong), and much quicker.
            good &= np.isfinite(value.reshape(len(value), -1).sum(axis=1, dtype=np.float64))
    kept = {name: value[good] for name, value in raw.items()} if not good.all() else raw
    return Gaussians(**{**kept, "quats": unit(kept["quats"])}), int(np.count_nonzero(~good))


def unit(quats: NDArray) -> NDArray[np.float32]:
    """Quaternions [N,4] of length 1; those of length 0 become the identity."""
    length = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    zero = length[:, 0] < 1e-12
    with np.errstate(invalid="ignore"):  # of what is infinite
        found = (quats / np.where(length > 0, length, 1)).astype(np.float32)
    found[zero] = 1, 0, 0, 0
    return found


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
    """The content of a file whose columns are activated.

    Args:
        kind: Name of the format.
        path: The file.
        raw: Columns by the names of `Gaussians`; `means` as exactly as the file has them, and
            `object_id` may be NaN or negative.
        axes: Directions of the file that point up and to the front.
        antialiased: Whether the file asks for Mip-Splatting's filter.
        notes: What is said of the file.
        step: Distance of neighbouring places; None: that of float32, if it has such numbers.

    Raises:
        InputError: If no Gaussian has finite values.
    """
    step = step_of(raw["means"]) if step is None else step
    means, origin = centred(raw["means"])
    ids, said = assigned(raw.get(OBJECT), means)
    with np.errstate(over="ignore", invalid="ignore"):  # What is too large becomes infinite.
        names = raw.keys() - {"means", OBJECT}
        others = {name: raw[name].astype(np.float32) for name in names}
    gaussians, dropped = finite({"means": means, **others, **ids})
    if not len(gaussians):
        limit = "none of its Gaussians has finite values."
        raise refusal(kind, path, limit, "Export it once more.")
    x, y, z = origin.tolist()
    return Content(gaussians, dropped, axes, antialiased, (*notes, *said), (x, y, z), step)


def assigned(
    ids: NDArray | None, means: NDArray[np.float32]
) -> tuple[dict[str, NDArray[np.int32]], list[str]]:
    """Which object each Gaussian belongs to, as a column, and what is said about it.

    Those that name no object belong to that of the nearest Gaussian which does.

    Args:
        ids: Numbers of objects [N] as a file has them; NaN and negative ones are none.
        means: Centres [N,3].
    """
    if ids is None:
        return {}, []
    some = np.isfinite(ids) & (ids >= 0)
    found = np.where(some, ids, 0).clip(0, MOST_ID).astype(np.int32)
    lost = ~some & np.isfinite(means).all(axis=1)
    if not lost.any():
        return {OBJECT: found}, []
    known = some & np.isfinite(means).all(axis=1)
    count = f"{np.count_nonzero(lost):,} Gaussians name no object ({OBJECT} is NaN or negative)"
    if not known.any():
        return {}, [f"{count}: all are read as one object."]
    from scipy.spatial import KDTree

    found[lost] = found[known][KDTree(means[known]).query(means[lost])[1]]
    return {OBJECT: found}, [f"{count}; each is counted to that of its nearest neighbour."]
