"""Reads and writes 3DGS PLY files, which store log scales and opacity logits.

The layout follows Kerbl et al. 2023, "3D Gaussian Splatting": one element `vertex`, whose
properties are identified by their names. Colours are spherical harmonics; the coefficients `f_rest`
are first all red, then all green, then all blue. The axes are x right, y down, z into the image.
The conversion to the axes of phy124 is exact, so writing and then reading a file changes values
only by the rounding of log and logit.

Columns of other training programs are applied if they change the Gaussians. A note lists unknown
columns, because they might also change the Gaussians.

    program                           columns                     treatment
    Mip-Splatting, GOF, RaDe-GS       filter_3D                   filter applied: wider and fainter
    2DGS                              no scale_2                  read as flat Gaussians
    isotropic trainings               scale_0 alone               read as spheres
    trainings of plain colours        red, green, blue, no f_dc   read as degree 0
    Scaffold-GS, Octree-GS, HAC       f_anchor_feat, f_offset     refused: they need a network
"""

import os
import re
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import SH_C0, SH_COEFFICIENTS, Gaussians
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.content import (
    DEGREE_4,
    LARGEST_SH,
    MAX_GAUSSIANS,
    OBJECT,
    Y_DOWN,
    Content,
    check_size,
    content_of,
)
from phy124.io.files import replacing
from phy124.io.plyheader import Header, read_header, refusal

BLOCK = 1 << 16
PLAIN, WIDER, TEXT = 68, 3, 70
"""Memory for reading [bytes]: for a binary row of degree 0, for each further byte of a binary row,
and for each value of an ascii row.
"""
FILTER = "filter_3D"
"""Column with the width of Mip-Splatting's filter, in the file's unit (Yu et al. 2023, eq. 7)."""
CENTRE = ("x", "y", "z")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
RGB = ("red", "green", "blue")
SCALES = ("scale_0", "scale_1", "scale_2")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
SPLATS = (*SCALES, *QUATS, "opacity")
KNOWN = {*CENTRE, *DC, *RGB, *SPLATS, OBJECT, FILTER, "nx", "ny", "nz"}
"""Columns that are not reported as ignored."""
ANCHORS = ("f_anchor_feat_0", "f_offset_0")
FLAT = 0.01
"""Thickness of Gaussians without the column scale_2, relative to their shorter side."""
MOST_NAMED = 12
"""Largest number of unknown columns in a note; columns that differ only in a number count once."""
COEFFICIENTS = (*SH_COEFFICIENTS, 25)
"""Numbers of spherical-harmonic coefficients of degree 0 to 4."""
STANDARD = "Export the file in the standard 3DGS layout."
Columns = dict[str, NDArray[Any]]


def check_names(path: Path, header: Header) -> None:
    """Refuse a PLY file that lacks the columns that Gaussians need.

    Raises:
        InputError: If the file has no rows, lacks a column, or has a layout that is not supported.
    """
    names = set(header.row.names or ())
    if "packed_position" in names:
        limit = "it is compressed by SuperSplat, not a plain PLY."
        raise refusal(path, limit, f"Run `phy124 convert {path.name} plain.ply`.")
    if not header.count:
        raise refusal(
            path, "it contains no Gaussians.", "Export the file again, including its Gaussians."
        )
    if not names & set(SPLATS):
        limit = "it is a plain point cloud or mesh: it has no scales, rotations and opacities."
        remedy = "Give a Gaussian splatting PLY, as LGM, TRELLIS or a 3DGS training write it."
        raise refusal(path, limit, remedy)
    if names & set(ANCHORS):
        limit = "it contains anchors of Scaffold-GS, which need a network, instead of Gaussians."
        raise refusal(path, limit, "Export the Gaussians of a view with that program.")
    wanted = (*CENTRE, "scale_0", *QUATS, "opacity")
    missing = [name for name in wanted if name not in names]
    missing += [] if names >= set(RGB) else [name for name in DC if name not in names]
    missing += ["scale_1"] if "scale_2" in names and "scale_1" not in names else []
    if missing:
        limit = f"it has no {', '.join(missing)}."
        raise refusal(path, limit, STANDARD)


def read_columns(path: Path, table: NDArray[Any]) -> tuple[Columns, list[str]]:
    """Return the decoded columns, keyed by the fields of `Gaussians`, and notes about the columns.

    The rows of `table` belong to the element `vertex` and have passed `check_names`.

    Raises:
        InputError: If the number of harmonics belongs to no degree from 0 to 4.
    """
    names = table.dtype.names or ()
    scales, opacities, notes = _activate(table)
    if FILTER in names:
        scales, opacities = _apply_filter(scales, opacities, table[FILTER])
        notes.append(f"The filter of Mip-Splatting ({FILTER}) was applied to its Gaussians.")
    sh, remarks = _harmonics(path, table)
    columns: Columns = {
        "means": _group(table, CENTRE, np.float64),
        "quats": _group(table, QUATS),
        "scales": scales,
        "opacities": opacities,
        "sh": sh,
    }
    if OBJECT in names:
        columns[OBJECT] = _group(table, (OBJECT,))[:, 0]
    unknown = (name for name in names if name not in KNOWN and not name.startswith("f_rest_"))
    return columns, [*notes, *remarks, *describe_unread(unknown)]


def _group(
    table: NDArray[Any], names: tuple[str, ...], kind: type[np.floating] = np.float32
) -> NDArray[Any]:
    """Copy columns to an array [N,len(names)]; values that are too large for `kind` become
    infinite.
    """
    out = np.empty((len(table), len(names)), kind)
    with np.errstate(over="ignore", invalid="ignore"):
        for i, name in enumerate(names):
            out[:, i] = table[name]
    return out


def _activate(table: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Return standard deviations [N,3], opacities [N] in 0..1, and notes."""
    sides = tuple(name for name in SCALES if name in (table.dtype.names or ()))
    scales, notes = _group(table, sides, np.float64), []
    opacities = table["opacity"].astype(np.float64)
    if _are_activated(scales, opacities):
        notes.append(
            "Its scales are read as lengths, not logarithms, and its opacities as fractions, "
            "not logits: every scale is above 0 and every opacity within 0..1."
        )
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            scales, opacities = np.exp(scales), 1 / (1 + np.exp(-opacities))
    if len(sides) == 2:
        flat = FLAT * scales.min(axis=1, keepdims=True)
        scales = np.concatenate([scales, flat], axis=1)
        notes.append("Its Gaussians are flat, like those of 2DGS, because it has no scale_2.")
    if len(sides) == 1:
        scales = np.repeat(scales, 3, axis=1)
        notes.append("Its Gaussians are round, because it has no scale_1 and scale_2.")
    return scales, opacities, notes


def _are_activated(scales: NDArray[np.float64], opacities: NDArray[np.float64]) -> bool:
    """The scales alone do not show whether they are logarithms: in a capture in millimetres, for
    example, all logarithms may be positive.
    """
    sound = np.isfinite(scales).all(axis=1) & np.isfinite(opacities)
    scales, opacities = scales[sound], opacities[sound]
    within = (opacities >= 0) & (opacities <= 1)
    return bool(sound.any() and (scales > 0).all() and within.all())


def _apply_filter(
    scales: NDArray[np.float64], opacities: NDArray[np.float64], widths: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convolve each Gaussian with an isotropic Gaussian, as the renderer of Mip-Splatting does.

    The variance of the filter is added. Opacities are multiplied by sqrt(det before / det after),
    where det is the determinant of the covariance.
    """
    with np.errstate(all="ignore"):
        before = np.square(scales)
        after = before + np.square(widths.astype(np.float64))[:, None]
        thinner = np.where(after > 0, before / np.where(after > 0, after, 1), 1)
        thinner[np.isnan(after)] = np.nan
        return np.sqrt(after), opacities * np.sqrt(thinner.prod(axis=1))


def _harmonics(path: Path, table: NDArray[Any]) -> tuple[NDArray[np.float32], list[str]]:
    names = table.dtype.names or ()
    first = _group(table, DC) if set(DC) <= set(names) else _first_of_rgb(table)
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in [3 * (k - 1) for k in COEFFICIENTS] or any(
        f"f_rest_{i}" not in names for i in range(rest)
    ):
        limit = (
            f"it has {rest} f_rest values, but harmonics of degree 0 to 4 have 0, 9, 24, 45 or 72."
        )
        raise refusal(path, limit, STANDARD)
    each = rest // 3
    kept = min(each, LARGEST_SH - 1)
    wanted = tuple(f"f_rest_{channel * each + k}" for channel in range(3) for k in range(kept))
    sh = np.empty((len(table), 1 + kept, 3), np.float32)
    sh[:, 0] = first
    sh[:, 1:] = _group(table, wanted).reshape(len(table), 3, kept).transpose(0, 2, 1)
    return sh, [DEGREE_4] if kept < each else []


def _first_of_rgb(table: NDArray[Any]) -> NDArray[np.float64]:
    rgb = _group(table, RGB, np.float64)
    kind = table.dtype["red"]
    # All columns of an ascii file are float64. Values above 1 show that the colours are bytes.
    most = np.iinfo(kind).max if kind.kind in "ui" else 255.0 if (rgb > 1).any() else 1.0
    return (rgb / most - 0.5) / SH_C0


def describe_unread(names: Iterable[str]) -> list[str]:
    """Return a note that lists the ignored columns, or no note if there are none."""
    shown: list[str] = []
    for _, group in groupby(map(_printable, names), lambda name: name.rstrip("0123456789")):
        alike = list(group)
        shown += alike if len(alike) < 3 else [f"{alike[0]} to {alike[-1]}"]
    if not shown:
        return []
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    return [f"Unknown columns are ignored: {', '.join(shown[:MOST_NAMED])}{more}."]


def _printable(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name[:40])


SCALE_FLOOR = 1e-12
"""Smallest scale that is written [m]; the scale 0 of a flat Gaussian has no logarithm."""
OPACITY_MARGIN = 1e-7
"""Written opacities differ from 0 and 1 by at least this, since 0 and 1 have infinite logits."""
COMMENT = "phy124: x right, y down, z into the picture; the world's (x, y, z) is (-z, x, -y) here"
VERTICAL = re.compile(r"vertical axis:\s*(-?[xyz])\s*", re.IGNORECASE)
"""Pattern of the comment in which Nerfstudio and Brush state the vertical axis."""
MIP = ("SplatRenderMode: mip", "antialiased 1")
"""Comments with which Brush and Postshot mark files trained with Mip-Splatting's filter."""
NOT_MIP = ("SplatRenderMode: default", "antialiased 0")
NO_NUMBER = re.compile(rb"[-+]?(nan\([^)]*\)|1\.#\w+)", re.IGNORECASE)
"""Texts that Windows programs write for NaN and infinity: -nan(ind), 1.#QNAN, -1.#INF00."""


class Ply(NamedTuple):
    """The Gaussians of a PLY file; unlike `phy124.io.formats.read_gaussians`, without notes."""

    gaussians: Gaussians
    """The Gaussians in the axes of phy124, in the file's unit of length (assumed to be the metre).
    The Gaussians are moved to the origin if float32 could not resolve their positions.
    """
    dropped: int
    """Number of the file's rows that were removed because a value was NaN or infinite."""


def read_ply(
    path: str | os.PathLike[str],
    *,
    up: str | None = None,
    front: str | None = None,
    dialect: str | None = None,
) -> Ply:
    """Read a 3DGS PLY: ascii or binary, any property order, any float type, degree 0 to 4.

    Args:
        path: The file.
        up: Direction in the file that points up, in the notation of `phy124.io.axes.orientation`.
        front: Direction of the object's front, in the file's axes.
        dialect: The program that wrote the file. If `up` is None, the program determines the axes.
            Default: the axes that comments in the file state, or else the usual axes.

    Raises:
        InputError: If the file is missing or cut short, is no PLY file, or has no Gaussians.
    """
    rotation = None if up is None and dialect is None else orientation(up, front, dialect)
    content = read(Path(path)).in_place
    if rotation is None:
        rotation = orientation(content.axes[0], front or content.axes[1])
    return Ply(rotate_gaussians(content.gaussians, rotation), content.dropped)


def read(path: Path) -> Content:
    """Read the Gaussians of a PLY file in the file's axes.

    Raises:
        InputError: If the file is missing or cut short, is no PLY file, or has no Gaussians.
    """
    header = read_header(path)
    check_names(path, header)
    raw, notes = read_columns(path, _rows(path, header))
    axes, antialiased = read_comments(header.comments)
    return content_of("PLY", path, raw, axes, antialiased=antialiased, notes=notes)


def read_comments(comments: tuple[str, ...]) -> tuple[tuple[str, str | None], bool]:
    """Return the axes stated in the comments, and whether a comment mentions Mip-Splatting."""
    axes: tuple[str, str | None] = Y_DOWN
    antialiased = False
    for text in comments:
        if match := VERTICAL.fullmatch(text):
            # Brush writes y for any up axis, so y without a sign does not show whether +y or -y is
            # up.
            axes = Y_DOWN if match[1].lower() in ("y", "-y") else (match[1].lower(), None)
        antialiased |= text in MIP
    return axes, antialiased


def write_ply(
    path: str | os.PathLike[str], gaussians: Gaussians, *, antialiased: bool = False
) -> None:
    """Write Gaussians in the Inria layout (binary little-endian float32), atomically."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        for start in range(0, max(len(gaussians), 1), BLOCK):
            some = gaussians.select(slice(start, start + BLOCK))
            table = raw_table(rotate_gaussians(some, orientation().T))
            if start == 0:
                file.write(_header(table, len(gaussians), antialiased=antialiased))
            table.tofile(file)


def encode(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """Return the bytes of a PLY file; the axes of the Gaussians must be x right, y down."""
    table = raw_table(gaussians)
    return _header(table, len(table), antialiased=antialiased) + table.tobytes()


def _header(table: NDArray[Any], count: int, *, antialiased: bool) -> bytes:
    names = table.dtype.names or ()
    tags = [COMMENT, "Vertical axis: -y", *(MIP if antialiased else NOT_MIP)]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {tag}" for tag in tags)]
    lines += [f"element vertex {count}", *(f"property float {name}" for name in names)]
    return "\n".join([*lines, "end_header\n"]).encode("ascii")


def read_rows(path: Path) -> NDArray[Any]:
    """Read the rows of element `vertex` of any PLY file as a structured array.

    Raises:
        InputError: If the file is missing, too large or cut short, or is not a PLY file.
    """
    return _rows(path, read_header(path))


def _rows(path: Path, header: Header) -> NDArray[Any]:
    if header.ascii:
        check_size("PLY", path, header.count, more=TEXT * len(header.row.names or ()))
        return _read_ascii(path, header)
    available = max(path.stat().st_size - header.start, 0) // header.row.itemsize
    # checked before memory is allocated
    if available < header.count <= MAX_GAUSSIANS:
        raise _cut_short(path, available, header.count)
    check_size("PLY", path, header.count, more=WIDER * max(header.row.itemsize - PLAIN, 0))
    rows = np.fromfile(path, header.row, header.count, offset=header.start)
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
        raise refusal(
            path, f"it contains a number that cannot be parsed ({error}).", "Export the file again."
        ) from error
    rows = len(values) // len(names)
    if rows < header.count:
        raise _cut_short(path, rows, header.count)
    if len(values) != header.count * len(names):
        raise refusal(path, "its rows do not have one value per property.", "Export it again.")
    table = np.empty(header.count, [(name, np.float64) for name in names])
    for name, column in zip(names, values.reshape(-1, len(names)).T, strict=True):
        table[name] = column
    return table


def _cut_short(path: Path, rows: int, wanted: int) -> InputError:
    limit = f"it is cut short: only {rows:,} of {wanted:,} Gaussians are present."
    return refusal(path, limit, "Copy or download the file again.")


def raw_table(gaussians: Gaussians) -> NDArray[Any]:
    """Return the rows of the Inria layout (logits, log scales) in the axes of the Gaussians."""
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
    if gaussians.object_id is not None:  # float32 is exact, because there are few objects
        groups[OBJECT] = gaussians.object_id.astype(np.float32)[:, None]
    names = " ".join(groups).split()
    values = np.concatenate(list(groups.values()), axis=1, dtype="<f4", casting="same_kind")
    return values.view([(name, "<f4") for name in names])[:, 0]
