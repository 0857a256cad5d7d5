"""Reads and writes `.splat` (antimatter15): rows of 32 bytes, one per Gaussian, without a header.

    offset  field    type       meaning
    0       centre   3 float32  x right, y down, as in a 3DGS PLY
    12      scale    3 float32  standard deviations, linear
    24      colour   4 uint8    red, green, blue, opacity; value / 255
    28      rotation 4 uint8    wxyz; (value - 128) / 128

The format has no spherical harmonics above degree 0.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import SH_C0, Gaussians
from phy124.io.content import Content, check_count, check_opens, content_of, refusal

ROW = np.dtype(
    [("centre", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)]
)
LOOKED_AT = 1000


def read(path: Path) -> Content:
    """Read the Gaussians of a `.splat` file.

    Raises:
        InputError: If the file is missing, cut short, too large or of another kind, or no Gaussian
            is finite.
    """
    check_opens("splat", path)
    size = path.stat().st_size
    count, rest = divmod(size, ROW.itemsize)
    if rest:
        limit = (
            f"its {size:,} bytes are not a multiple of {ROW.itemsize}: "
            "it is cut short or of another kind."
        )
        raise refusal("splat", path, limit)
    check_count("splat", path, count, ROW.itemsize, size)
    rows = np.fromfile(path, ROW)
    if _sound_share(rows[:LOOKED_AT]) < 0.5:
        limit = (
            "it is of another kind: most of its rows lack a finite centre, positive scales, or a "
            "unit quaternion."
        )
        raise refusal("splat", path, limit)
    colour = rows["colour"].astype(np.float32) / 255
    raw = {
        "means": rows["centre"].copy(),
        "quats": _quats(rows),
        "scales": np.abs(rows["scale"]),
        "opacities": colour[:, 3],
        "sh": ((colour[:, :3] - 0.5) / SH_C0)[:, None],
    }
    return content_of("splat", path, raw)


def encode(gaussians: Gaussians, *, antialiased: bool = False) -> bytes:
    """Return the bytes of a `.splat` file; the format cannot store `antialiased`."""
    rows = np.empty(len(gaussians), ROW)
    rows["centre"], rows["scale"] = gaussians.means, gaussians.scales
    rgba = np.concatenate([gaussians.rgb, gaussians.opacities[:, None]], axis=1)
    rows["colour"] = np.rint(np.clip(rgba, 0, 1) * 255)
    rows["rotation"] = np.rint(gaussians.quats * 128 + 128).clip(0, 255)
    return rows.tobytes()


def likely(path: Path) -> bool:
    """Return whether a file without a signature is probably a `.splat` file."""
    size = path.stat().st_size
    if not size or size % ROW.itemsize:
        return False
    return _sound_share(np.fromfile(path, ROW, LOOKED_AT)) > 0.9


def _sound_share(rows: NDArray) -> float:
    with np.errstate(invalid="ignore", over="ignore"):
        unit = np.abs(np.linalg.norm(_quats(rows), axis=1) - 1) < 0.1
        sound = np.isfinite(rows["centre"]).all(axis=1) & (rows["scale"] >= 0).all(axis=1)
    return float((unit & sound).mean())


def _quats(rows: NDArray) -> NDArray[np.float32]:
    return (rows["rotation"].astype(np.float32) - 128) / np.float32(128)
