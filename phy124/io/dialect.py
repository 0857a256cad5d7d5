"""Which program may have written a file, told by its columns and by where its points lie, and
which way up it hence is.

Few programs sign their files, so this is a guess from what each is known to write
(docs/guide/plugins.md); it is told to the user, never acted upon without a look at it.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.io.axes import DIALECTS, FRONTS
from phy124.io.content import Y_UP
from phy124.io.formats import recognised
from phy124.io.ply import VERTICAL
from phy124.io.plyheader import Header, read_header

ENOUGH, BLOCKS = 10_000, 20
"""Number of rows that are looked at, and of the places all over the file where they are read."""
LGM = (
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
)  # fmt: skip
"""The columns that LGM writes, in its order."""
SIGNED = ("phy124", "SuperSplat")
"""Programs that say in a comment that they wrote a file; its axes are the usual ones."""
UNIT = 1e-3
"""How far the length of a unit quaternion may be off 1."""


class Axes(NamedTuple):
    """Which directions of a file point up and to the front."""

    up: str
    front: str
    said: bool
    """Whether the file or its format says so; else it is a guess."""
    program: str | None = None
    """The program that the file looks like, and why, if that is unusual."""


def likely_axes(path: Path, axes: tuple[str, str | None]) -> Axes:
    """The axes that a file most likely has.

    Args:
        path: The file.
        axes: Those with which its reader has read it.

    Raises:
        InputError: If the file is missing or of no format that is read.
    """
    up, front = axes[0], axes[1] or FRONTS[axes[0]]
    form = recognised(path)
    if form.name != "ply":
        # glTF and SPZ define their axes; the others have them by habit.
        return Axes(up, front, form.axes == Y_UP)
    likely = likely_dialect(path)
    if likely is not None and axes[0] == DIALECTS["3dgs"][0]:
        return Axes(*DIALECTS[likely[0]], False, likely[1])
    return Axes(up, front, _names_its_axes(read_header(path)))


def _names_its_axes(header: Header) -> bool:
    """Whether a comment says which way is up; a bare y may be meant either way."""
    named = [found[1].lower() for text in header.comments if (found := VERTICAL.fullmatch(text))]
    return _signed(header) or any(name != "y" for name in named)


def _signed(header: Header) -> bool:
    return any(program in text for text in header.comments for program in SIGNED)


def likely_dialect(path: Path) -> tuple[str, str] | None:
    """The dialect that a file may have, and what of it says so; None for the usual one.

    Raises:
        InputError: If the file is missing or its header is invalid.
    """
    header = read_header(path)
    names = header.row.names or ()
    if _signed(header) or header.ascii or "f_rest_0" in names or not set(LGM) <= set(names):
        return None
    rows = _some_rows(path, header)
    reach, unit = _reach(rows), _unit(rows)
    if names == LGM and unit and reach <= 1.01:
        return "lgm", "LGM: no normals, unit quaternions, all within a cube of side 2"
    if not _plain_normals(header, rows) or reach > 0.51:
        return None
    within = "normals of zero, all within a cube of side 1"
    if not unit:
        return "sam3d", f"SAM 3D Objects: quaternions of any length, {within}"
    return "triposplat", f"TripoSplat (or of TRELLIS, which faces -z): {within}"


def _some_rows(path: Path, header: Header) -> NDArray:
    """Rows from all over the file, as a structured array; some twice if there are few."""
    each = min(header.count, ENOUGH // BLOCKS)
    firsts = np.linspace(0, header.count - each, BLOCKS).astype(int).tolist()
    places = [header.start + first * header.row.itemsize for first in firsts]
    return np.concatenate([np.fromfile(path, header.row, each, offset=at) for at in places])


def _reach(rows: NDArray) -> float:
    """Largest coordinate of the points."""
    return max((float(np.abs(rows[axis]).max()) for axis in "xyz"), default=np.inf)


def _unit(rows: NDArray) -> bool:
    squares = sum(rows[f"rot_{i}"].astype(np.float64) ** 2 for i in range(4))
    return bool((np.abs(np.sqrt(squares) - 1) < UNIT).all())


def _plain_normals(header: Header, rows: NDArray) -> bool:
    names = header.row.names or ()
    return {"nx", "ny", "nz"} <= set(names) and not any(rows[n].any() for n in ("nx", "ny", "nz"))
