"""The columns of a PLY of Gaussians: what the programs of others keep in them, and what they mean.

The usual ones are those of Kerbl et al. 2023. Known columns of other trainers that change the
Gaussians are applied; columns that are not known are named, since they may change them, too.

    program                           columns                     read as
    Mip-Splatting, GOF, RaDe-GS       filter_3D                   its filter widens and thins
    2DGS                              no scale_2                  flat
    isotropic trainings               scale_0 alone               round
    trainings of plain colours        red, green, blue, no f_dc   colours that do not change
    Scaffold-GS, Octree-GS, HAC       f_anchor_feat, f_offset     refused: a network makes them
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import SH_C0, SH_COEFFICIENTS
from phy124.io.content import DEGREE_4, LARGEST_SH, OBJECT
from phy124.io.plyheader import Header, refusal

FILTER = "filter_3D"
"""Standard deviation of Mip-Splatting's filter, in the file's unit (Yu et al. 2023, eq. 7)."""
PLACE = ("x", "y", "z")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
RGB = ("red", "green", "blue")
SCALES = ("scale_0", "scale_1", "scale_2")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
SPLATS = (*SCALES, *QUATS, "opacity")
KNOWN = {*PLACE, *DC, *RGB, *SPLATS, OBJECT, FILTER, "nx", "ny", "nz"}
"""Columns that are read, repeat others (red, green, blue), or mean nothing here (normals)."""
ANCHORS = ("f_anchor_feat_0", "f_offset_0")
FLAT = 0.01
"""Thickness of a Gaussian without one, in its shorter sides."""
MOST_NAMED = 12
"""Unknown columns that a note names, of which a numbered group counts once."""
COEFFICIENTS = (*SH_COEFFICIENTS, 25)
"""Harmonics of degree 0 to 4."""
STANDARD = "Export it in the standard 3DGS layout."
Columns = dict[str, NDArray[Any]]


def check_names(path: Path, header: Header) -> None:
    """Make sure that a PLY has the columns that Gaussians need.

    Raises:
        InputError: It does not.
    """
    names = set(header.row.names or ())
    if "packed_position" in names:
        limit = "it is compressed by SuperSplat, not a plain PLY."
        raise refusal(path, limit, f"Run `phy124 convert {path.name} plain.ply`.")
    if not header.count:
        raise refusal(path, "it holds no Gaussians.", "Export it again with Gaussians.")
    if not names & set(SPLATS):
        limit = "it is a plain point cloud or mesh: it has no scales, rotations and opacities."
        remedy = "Give a Gaussian splatting PLY, as LGM, TRELLIS or a 3DGS training write it."
        raise refusal(path, limit, remedy)
    if names & set(ANCHORS):
        limit = "it holds anchors of Scaffold-GS, from which a network makes the Gaussians."
        raise refusal(path, limit, "Export the Gaussians of a view with that program.")
    wanted = (*PLACE, "scale_0", *QUATS, "opacity")
    missing = [name for name in wanted if name not in names]
    missing += [] if names >= set(RGB) else [name for name in DC if name not in names]
    missing += ["scale_1"] if "scale_2" in names and "scale_1" not in names else []
    if missing:
        limit = f"it has no {', '.join(missing)}."
        raise refusal(path, limit, STANDARD)


def columns(path: Path, table: NDArray[Any]) -> tuple[Columns, list[str]]:
    """Columns by the names of `Gaussians`, activated, and what is said about them.

    Args:
        path: The file.
        table: Its rows of element `vertex`, whose names `check_names` has accepted.

    Raises:
        InputError: It has another number of harmonics.
    """
    names = table.dtype.names or ()
    scales, opacities, notes = _activated(table)
    if FILTER in names:
        scales, opacities = _filtered(scales, opacities, table[FILTER])
        notes.append(f"The filter of Mip-Splatting ({FILTER}) was applied to its Gaussians.")
    sh, said = _harmonics(path, table)
    found: Columns = {
        "means": _group(table, PLACE, np.float64),
        "quats": _group(table, QUATS),
        "scales": scales,
        "opacities": opacities,
        "sh": sh,
    }
    if OBJECT in names:
        found[OBJECT] = _group(table, (OBJECT,))[:, 0]
    unknown = (one for one in names if one not in KNOWN and not one.startswith("f_rest_"))
    return found, [*notes, *said, *passed_over(unknown)]


def _group(
    table: NDArray[Any], names: tuple[str, ...], kind: type[np.floating] = np.float32
) -> NDArray[Any]:
    """Columns side by side [N,len(names)]; a double too large for float32 becomes infinite."""
    out = np.empty((len(table), len(names)), kind)
    with np.errstate(over="ignore", invalid="ignore"):
        for i, name in enumerate(names):
            out[:, i] = table[name]
    return out


def _activated(table: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Standard deviations [N,3], opacities [N] in 0..1, and what is said about them."""
    sides = tuple(name for name in SCALES if name in (table.dtype.names or ()))
    scales, notes = _group(table, sides, np.float64), []
    opacities = table["opacity"].astype(np.float64)
    if _are_activated(scales, opacities):
        notes.append(
            "Its scales are read as lengths, not logarithms, and its opacities as 0..1, not "
            "logits: every scale is above 0 and every opacity within 0..1."
        )
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            scales, opacities = np.exp(scales), 1 / (1 + np.exp(-opacities))
    if len(sides) == 2:
        flat = FLAT * scales.min(axis=1, keepdims=True)
        scales = np.concatenate([scales, flat], axis=1)
        notes.append("Its Gaussians are flat, as those of 2DGS: it has no scale_2.")
    if len(sides) == 1:
        scales = np.repeat(scales, 3, axis=1)
        notes.append("Its Gaussians are round: it has no scale_1 and scale_2.")
    return scales, opacities, notes


def _are_activated(scales: NDArray[np.float64], opacities: NDArray[np.float64]) -> bool:
    """Whether a file stores values that are usually logarithms and logits as they are.

    Only both at once tell: in a capture in millimetres all logarithms may be above 0.
    """
    sound = np.isfinite(scales).all(axis=1) & np.isfinite(opacities)
    scales, opacities = scales[sound], opacities[sound]
    within = (opacities >= 0) & (opacities <= 1)
    return bool(sound.any() and (scales > 0).all() and within.all())


def _filtered(
    scales: NDArray[np.float64], opacities: NDArray[np.float64], widths: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gaussians convolved with round ones of a width, as Mip-Splatting draws them.

    Variances add, and opacities fall as sqrt(det before / det after).
    """
    with np.errstate(all="ignore"):
        before = np.square(scales)
        after = before + np.square(widths.astype(np.float64))[:, None]
        thinner = np.where(after > 0, before / np.where(after > 0, after, 1), 1)
        thinner[np.isnan(after)] = np.nan
        return np.sqrt(after), opacities * np.sqrt(thinner.prod(axis=1))


def _harmonics(path: Path, table: NDArray[Any]) -> tuple[NDArray[np.float32], list[str]]:
    """Colours [N,K,3] up to degree 3, and what is said about them."""
    names = table.dtype.names or ()
    first = _group(table, DC) if set(DC) <= set(names) else _first_of_rgb(table)
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in [3 * (k - 1) for k in COEFFICIENTS] or any(
        f"f_rest_{i}" not in names for i in range(rest)
    ):
        limit = f"it has {rest} f_rest values; harmonics of degree 0 to 4 have 0, 9, 24, 45 or 72."
        raise refusal(path, limit, STANDARD)
    each = rest // 3
    kept = min(each, LARGEST_SH - 1)
    wanted = tuple(f"f_rest_{channel * each + k}" for channel in range(3) for k in range(kept))
    sh = np.empty((len(table), 1 + kept, 3), np.float32)
    sh[:, 0] = first
    sh[:, 1:] = _group(table, wanted).reshape(len(table), 3, kept).transpose(0, 2, 1)
    return sh, [DEGREE_4] if kept < each else []


def _first_of_rgb(table: NDArray[Any]) -> NDArray[np.float64]:
    """Harmonics of degree 0 from plain colours: bytes, or fractions where the column is float."""
    rgb = _group(table, RGB, np.float64)
    kind = table.dtype["red"]
    # Columns of an ascii file are all read as float64: colours above 1 are bytes.
    most = np.iinfo(kind).max if kind.kind in "ui" else 255.0 if (rgb > 1).any() else 1.0
    return (rgb / most - 0.5) / SH_C0


def passed_over(names: Iterable[str]) -> list[str]:
    """A sentence that names columns which are not read, if there are any."""
    shown: list[str] = []
    for _, group in groupby(map(_printable, names), lambda name: name.rstrip("0123456789")):
        alike = list(group)
        shown += alike if len(alike) < 3 else [f"{alike[0]} to {alike[-1]}"]
    if not shown:
        return []
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    return [f"Columns that are not known are passed over: {', '.join(shown[:MOST_NAMED])}{more}."]


def _printable(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name[:40])
