"""Reads and writes 3DGS PLY files, whose scales are logarithms and whose opacities are logits.

The layout is that of Kerbl et al. 2023, "3D Gaussian Splatting": one element `vertex` whose
properties are found by name; colours are spherical harmonics, with all red `f_rest` first, then
green, then blue. Such files have x right, y down, z into the picture; ours is z up with the object
facing +x, so the axes are renamed on reading and writing (docs/reference/conventions.md). This
change of axes is a signed permutation and hence exact: values read back bit for bit, except for the
rounding of log and logit.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.axes import orientation, turned
from phy124.io.columns import check_names, columns
from phy124.io.content import MAX_GAUSSIANS, OBJECT, Y_DOWN, Content, content_of
from phy124.io.files import replacing
from phy124.io.plyheader import Header, read_header, refusal

SCALE_FLOOR = 1e-12
"""Smallest scale written, m, since a perfectly flat Gaussian has no logarithm."""
OPACITY_MARGIN = 1e-7
"""Opacities are kept this far from 0 and 1, whose logits are infinite."""
COMMENT = "phy124: x right, y down, z into the picture; the world's (x, y, z) is (-z, x, -y) here"
VERTICAL = re.compile(r"vertical axis:\s*(-?[xyz])\s*", re.IGNORECASE)
"""How Nerfstudio and Brush name the axis that is vertical."""
MIP = ("SplatRenderMode: mip", "antialiased 1")
"""How Brush and Postshot say that a file was trained with Mip-Splatting's filter."""
NOT_MIP = ("SplatRenderMode: default", "antialiased 0")
NO_NUMBER = re.compile(rb"[-+]?(nan\([^)]*\)|1\.#\w+)", re.IGNORECASE)
"""How programs on Windows write what is no number: -nan(ind), 1.#QNAN, -1.#INF00."""


class Ply(NamedTuple):
    """What a file contained; `read_gaussians` also tells what was passed over."""

    gaussians: Gaussians
    """The Gaussians in our world, in metres if that is the file's unit; moved to the origin if they
    lie so far from it in double precision that float32 could not tell them apart."""
    dropped: int
    """Number of rows left out because a value was NaN or infinite."""


def read_ply(
    path: str | os.PathLike[str],
    *,
    up: str | None = None,
    front: str | None = None,
    dialect: str | None = None,
) -> Ply:
    """Read a 3DGS PLY: ascii or binary, any property order, any float type, SH degree 0 to 4.

    Args:
        path: The file.
        up: Direction in the file that points up, as `phy124.io.axes.orientation` takes it.
        front: Direction in the file that the object's front faces.
        dialect: The program that wrote the file, used where `up` is not given. Without it, what
            the file says of its vertical axis counts, else what viewers show upright.

    Raises:
        InputError: If the file is missing, cut short, not a PLY, or contains no Gaussians.
    """
    rotation = None if up is None and dialect is None else orientation(up, front, dialect)
    content = read(Path(path)).in_place
    if rotation is None:
        rotation = orientation(content.axes[0], front or content.axes[1])
    return Ply(turned(content.gaussians, rotation), content.dropped)


def read(path: Path) -> Content:
    """The Gaussians of a PLY in its own axes.

    Raises:
        InputError: If the file is missing, cut short, not a PLY, or contains no Gaussians.
    """
    header = read_header(path)
    check_names(path, header)
    raw, notes = columns(path, _rows(path, header))
    axes, antialiased = said(header.comments)
    return content_of("PLY", path, raw, axes, antialiased=antialiased, notes=notes)


def said(comments: tuple[str, ...]) -> tuple[tuple[str, str | None], bool]:
    """The axes that a header's comments name, and whether they ask for Mip-Splatting's filter."""
    axes: tuple[str, str | None] = Y_DOWN
    antialiased = False
    for text in comments:
        if found := VERTICAL.fullmatch(text):
            # Brush writes y whatever is up, so a bare y only says that up is along y.
            axes = Y_DOWN if found[1].lower() in ("y", "-y") else (found[1].lower(), None)
        antialiased |= text in MIP
    return axes, antialiased


def write_ply(
    path: str | os.PathLike[str], gaussians: Gaussians, *, antialiased: bool = False
) -> None:
    """Write the Inria layout, binary little-endian float32; it appears whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(encode(turned(gaussians, orientation().T), antialiased=antialiased))


def encode(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """The bytes of a PLY whose axes are those of the Gaussians, which should be x right, y down."""
    table = raw_table(gaussians)
    names = table.dtype.names or ()
    tags = [COMMENT, "Vertical axis: -y", *(MIP if antialiased else NOT_MIP)]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {tag}" for tag in tags)]
    lines += [f"element vertex {len(table)}", *(f"property float {name}" for name in names)]
    return "\n".join([*lines, "end_header\n"]).encode("ascii") + table.tobytes()


def read_rows(path: Path) -> NDArray[Any]:
    """The rows of element `vertex` of any PLY file, as a structured array.

    Raises:
        InputError: If the file is missing, is no PLY file, is too large or cut short.
    """
    header = read_header(path)
    return _rows(path, header)


def _rows(path: Path, header: Header) -> NDArray[Any]:
    if header.count > MAX_GAUSSIANS:
        limit = f"it announces {header.count:,} Gaussians; the limit is {MAX_GAUSSIANS:,}."
        raise refusal(path, limit, "Reduce it in a splat editor, for example SuperSplat.")
    if header.ascii:
        return _read_ascii(path, header)
    available = max(path.stat().st_size - header.start, 0) // header.row.itemsize
    count = min(available, header.count)  # No memory is taken for what is not there.
    rows = np.fromfile(path, header.row, count, offset=header.start)
    if len(rows) < header.count:
        raise _cut_short(path, len(rows), header.count)
    return rows


def _read_ascii(path: Path, header: Header) -> NDArray[Any]:
    with open(path, "rb") as file:
        file.seek(header.start)
        rows = [line for line in file.read().splitlines() if line.strip()]
    lines = rows[header.skip_lines :][: header.count]
    names, text = header.row.names or (), b" ".join(lines)
    if b"#" in text or b"(" in text:
        text = NO_NUMBER.sub(b"nan", text)
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise refusal(path, f"it has an unreadable number ({error}).", "Export again.") from error
    rows = len(values) // len(names)
    if rows < header.count:
        raise _cut_short(path, rows, header.count)
    if len(values) != header.count * len(names):
        raise refusal(path, "its rows do not have one value per property.", "Export it again.")
    table = np.empty(header.count, [(name, np.float64) for name in names])
    for name, column in zip(names, values.reshape(-1, len(names)).T, strict=True):
        table[name] = column
    return table


def _cut_short(path: Path, found: int, wanted: int) -> InputError:
    limit = f"it is cut short: {found:,} of {wanted:,} Gaussians are there."
    return refusal(path, limit, "Copy or download it again.")


def raw_table(gaussians: Gaussians) -> NDArray[Any]:
    """Rows of the Inria layout: raw values (logits, log scales) in the Gaussians' own axes."""
    opacity = np.clip(gaussians.opacities.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), -1)
    groups = {
        "x y z": gaussians.means,
        "nx ny nz": np.zeros((len(gaussians), 3), np.float32),
        "f_dc_0 f_dc_1 f_dc_2": gaussians.sh[:, 0],
        " ".join(f"f_rest_{i}" for i in range(rest.shape[1])): rest,
        "opacity": np.log(opacity / (1 - opacity))[:, None],
        "scale_0 scale_1 scale_2": np.log(np.maximum(gaussians.scales, SCALE_FLOOR)),
        "rot_0 rot_1 rot_2 rot_3": gaussians.quats,
    }
    if gaussians.object_id is not None:  # Exact in a float: there are few objects.
        groups[OBJECT] = gaussians.object_id.astype(np.float32)[:, None]
    names = " ".join(groups).split()
    values = np.concatenate(list(groups.values()), axis=1, dtype="<f4", casting="same_kind")
    return values.view([(name, "<f4") for name in names])[:, 0]
