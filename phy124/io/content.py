"""What a file of Gaussians contains, and the checks that all readers share."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import SH_COEFFICIENTS, Gaussians

MAX_GAUSSIANS = 10_000_000
"""Files with more Gaussians are refused before they are read."""
DENSEST = 100
"""Bytes that one byte of a compressed file may stand for: real objects reach 10, bombs 1000."""
SMALL = 1 << 22
"""Bytes that any file may stand for, so that a small object of one colour is no bomb."""
LARGEST_SH = SH_COEFFICIENTS[-1]
"""Harmonics that are kept per colour; those of degree 4 are left out."""
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


def refusal(kind: str, path: Path, limit: str, remedy: str = AGAIN) -> InputError:
    """The error for an unusable file.

    Args:
        kind: Name of the format, such as "SPZ".
        path: The file.
        limit: A sentence that says what is wrong, from a lower-case letter.
        remedy: A sentence that says what to do.
    """
    return InputError(f"{kind} file", path, limit[0].upper() + limit[1:], remedy)


def whole_file(kind: str, path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: If it is not there or is empty.
    """
    if not path.is_file():
        raise refusal(kind, path, "there is no such file.", "Check the path.")
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
    length = np.linalg.norm(kept["quats"].astype(np.float64), axis=1, keepdims=True)
    zero = length[:, 0] < 1e-12
    unit = (kept["quats"] / np.where(length > 0, length, 1)).astype(np.float32)
    unit[zero] = 1, 0, 0, 0
    return Gaussians(**{**kept, "quats": unit}), int(np.count_nonzero(~good))


def content_of(
    kind: str,
    path: Path,
    raw: dict[str, NDArray],
    axes: tuple[str, str | None] = Y_DOWN,
    *,
    antialiased: bool = False,
) -> Content:
    """The content of a file whose columns are activated.

    Args:
        kind: Name of the format.
        path: The file.
        raw: Columns by the names of `Gaussians`.
        axes: Directions of the file that point up and to the front.
        antialiased: Whether the file asks for Mip-Splatting's filter.

    Raises:
        InputError: If no Gaussian has finite values.
    """
    gaussians, dropped = finite(raw)
    if not len(gaussians):
        limit = "none of its Gaussians has finite values."
        raise refusal(kind, path, limit, "Export it once more.")
    return Content(gaussians, dropped, axes, antialiased)
