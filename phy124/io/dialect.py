"""Guesses from columns and positions which program wrote a PLY file.

The axes depend on this program, but few programs state their name. The guess relies on the known
output of each program (docs/guide/plugins.md), and is applied only if the user agrees.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.io.axes import DIALECTS, FRONTS
from phy124.io.content import Y_UP
from phy124.io.formats import recognise
from phy124.io.ply import CENTRE, DC, QUATS, SCALES, VERTICAL
from phy124.io.plyheader import Header, read_header

ENOUGH, BLOCKS = 10_000, 20
"""About `ENOUGH` rows of a file are sampled, in `BLOCKS` blocks of adjacent rows."""
LGM = (*CENTRE, *DC, "opacity", *SCALES, *QUATS)
NORMALS = ("nx", "ny", "nz")
SIGNED = ("phy124", "SuperSplat")
"""Programs that state their name in a comment of the file and use the usual axes."""
UNIT = 1e-3
"""A quaternion counts as a unit quaternion if its length differs from 1 by less than this value."""


class Axes(NamedTuple):
    """Up and front directions of a file, and their source."""

    up: str
    front: str
    said: bool
    """True if the file or its format states the up and front directions; False for a guess."""
    program: str | None = None
    """The program that probably wrote the file, and the reason; None for the usual layout."""


def likely_axes(path: Path, axes: tuple[str, str | None]) -> Axes:
    """Return the most likely axes of a file whose reader assumed `axes`.

    Raises:
        InputError: If the file is missing or its format is not supported.
    """
    up, front = axes[0], axes[1] or FRONTS[axes[0]]
    form = recognise(path)
    if form.name != "ply":
        # glTF and SPZ define the axes; for other formats, the axes are only a convention.
        return Axes(up, front, form.axes == Y_UP)
    likely = likely_dialect(path)
    if likely is not None and axes[0] == DIALECTS["3dgs"][0]:
        return Axes(*DIALECTS[likely[0]], False, likely[1])
    return Axes(up, front, _names_its_axes(read_header(path)))


def _names_its_axes(header: Header) -> bool:
    """Return whether a comment states the up axis; "y" without a sign is not sufficient."""
    matches = filter(None, map(VERTICAL.fullmatch, header.comments))
    return _is_signed(header) or any(match[1].lower() != "y" for match in matches)


def _is_signed(header: Header) -> bool:
    return any(program in text for text in header.comments for program in SIGNED)


def likely_dialect(path: Path) -> tuple[str, str] | None:
    """Return the likely dialect of a file and the reason; None for the usual dialect.

    Raises:
        InputError: If the file is missing or its header is invalid.
    """
    header = read_header(path)
    names = header.row.names or ()
    if _is_signed(header) or header.ascii or "f_rest_0" in names or not set(LGM) <= set(names):
        return None
    rows = _some_rows(path, header)
    reach = max(float(np.abs(rows[axis]).max()) for axis in CENTRE)
    squares = sum(rows[name].astype(np.float64) ** 2 for name in QUATS)
    unit = bool((np.abs(np.sqrt(squares) - 1) < UNIT).all())
    if names == LGM and unit and reach <= 1.01:
        return "lgm", "LGM: no normals, unit quaternions, all within a cube of side 2"
    if reach > 0.51 or not set(NORMALS) <= set(names) or any(rows[n].any() for n in NORMALS):
        return None
    within = "normals of zero, all within a cube of side 1"
    if not unit:
        return "sam3d", f"SAM 3D Objects: quaternions of any length, {within}"
    return "triposplat", f"TripoSplat (or of TRELLIS, which faces -z): {within}"


def _some_rows(path: Path, header: Header) -> NDArray:
    """Return a sample of the file's rows; a short file's rows may be returned repeatedly."""
    each = min(header.count, ENOUGH // BLOCKS)
    firsts = np.linspace(0, header.count - each, BLOCKS).astype(int).tolist()
    places = [header.start + first * header.row.itemsize for first in firsts]
    return np.concatenate([np.fromfile(path, header.row, each, offset=at) for at in places])
