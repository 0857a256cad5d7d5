"""Which program may have written a PLY file: told by its columns and by where its points lie.

Few programs sign their files, so this is a guess from what each is known to write
(docs/guide/plugins.md); it is told to the user, never acted upon.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phy124.io.plyheader import Header, read_header

ENOUGH = 10_000
"""Rows that are looked at."""
LGM = (
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
)  # fmt: skip
"""The columns that LGM writes, in its order."""
SIGNED = ("phy124", "SuperSplat")
"""Programs that say in a comment that they wrote a file; its axes are the usual ones."""
UNIT = 1e-3
"""How far the length of a unit quaternion may be off 1."""


def likely_dialect(path: Path) -> tuple[str, str] | None:
    """The dialect that a file may have, and what of it says so; None for the usual one.

    Raises:
        InputError: If the file is missing or its header is invalid.
    """
    header = read_header(path)
    names = header.row.names or ()
    signed = any(program in text for text in header.comments for program in SIGNED)
    if signed or header.ascii or "f_rest_0" in names or not set(LGM) <= set(names):
        return None
    rows = np.fromfile(path, header.row, min(header.count, ENOUGH), offset=header.start)
    reach, unit = _reach(rows), _unit(rows)
    if names == LGM and unit and reach <= 1.01:
        return "lgm", "LGM: no normals, unit quaternions, all within a cube of side 2"
    if not _plain_normals(header, rows) or reach > 0.51:
        return None
    within = "normals of zero, all within a cube of side 1"
    if not unit:
        return "sam3d", f"SAM 3D Objects: quaternions of any length, {within}"
    return "triposplat", f"TripoSplat (or of TRELLIS, which faces -z): {within}"


def _reach(rows: NDArray) -> float:
    """Largest coordinate of the points."""
    return max((float(np.abs(rows[axis]).max()) for axis in "xyz"), default=np.inf)


def _unit(rows: NDArray) -> bool:
    squares = sum(rows[f"rot_{i}"].astype(np.float64) ** 2 for i in range(4))
    return bool((np.abs(np.sqrt(squares) - 1) < UNIT).all())


def _plain_normals(header: Header, rows: NDArray) -> bool:
    names = header.row.names or ()
    return {"nx", "ny", "nz"} <= set(names) and not any(rows[n].any() for n in ("nx", "ny", "nz"))
