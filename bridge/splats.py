"""SplatArray: Gaussians as `splat_interfaces/msg/SplatArray`, which RVizSplat shows.

Every splat repeats the header and is a pose with its covariance [m^2], an opacity of 0 to 255, the
degree of its harmonics, and their coefficients one after the other, each red, green and blue: 384
bytes without harmonics above degree 0. CDR aligns numbers of eight bytes, so a splat is laid out in
one of two ways, by whether it begins at a multiple of eight or between two.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians

from .cdr import ENCAPSULATION, NANO

FIRST = 4
"""Where the first splat begins, behind the number of splats [bytes]."""


def splat_array(gaussians: Gaussians, stamp: int, frame: str) -> bytes:
    """The CDR payload of a SplatArray.

    Args:
        gaussians: The Gaussians.
        stamp: Time [ns since 1970].
        frame: The frame in which they are.
    """
    count, numbers = len(gaussians), 3 * gaussians.sh.shape[1]
    layouts = {phase: _layout(phase, frame, numbers) for phase in (0, 4)}
    phases = _phases(count, {phase: each.itemsize for phase, each in layouts.items()})
    sizes = np.where(phases == 0, layouts[0].itemsize, layouts[4].itemsize)
    starts = np.cumsum(sizes) - sizes
    body = np.zeros(int(sizes.sum()), np.uint8)
    for phase, layout in layouts.items():
        which = np.flatnonzero(phases == phase)
        rows = _rows(gaussians.select(which), stamp, frame, layout)
        body[starts[which, None] + np.arange(layout.itemsize)] = rows
    return ENCAPSULATION + struct.pack("<I", count) + body.tobytes()


def _phases(count: int, sizes: dict[int, int]) -> NDArray[np.int64]:
    """Where each splat begins, modulo 8: 0 or 4."""
    phases = np.full(count, FIRST)
    if (FIRST + sizes[FIRST]) % 8 == 0:
        # The second one begins at a multiple of eight, and the others like it or like the first.
        phases[1 :: 2 if sizes[0] % 8 else 1] = 0
    return phases


def _layout(phase: int, frame: str, numbers: int) -> np.dtype[Any]:
    """The members of a splat that begins at `phase` modulo 8, and the bytes between them."""
    text = len(frame.encode()) + 1
    gap = -(phase + 12 + text) % 8
    return np.dtype(
        [
            ("stamp", "<i4", 2),
            ("length", "<u4"),
            ("frame", f"S{text}"),
            ("gap", "u1", gap),
            ("pose", "<f8", 7),
            ("covariance", "<f8", (6, 6)),
            ("opacity", "u1"),
            ("degree", "u1"),
            ("gap_2", "u1", 2),
            ("count", "<u4"),
            ("harmonics", "<f4", numbers),
        ]
    )


def _rows(gaussians: Gaussians, stamp: int, frame: str, layout: np.dtype[Any]) -> NDArray[np.uint8]:
    """The bytes of splats [N, size]."""
    table = np.zeros(len(gaussians), layout)
    table["stamp"] = divmod(stamp, NANO)
    table["length"], table["frame"] = len(frame.encode()) + 1, frame.encode()
    quats = gaussians.quats.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    table["pose"][:, :3], table["pose"][:, 3:] = gaussians.means, quats[:, [1, 2, 3, 0]]
    table["covariance"][:, :3, :3] = gaussians.covariances()
    table["opacity"] = np.rint(np.clip(gaussians.opacities, 0, 1) * 255)
    coefficients = gaussians.sh.shape[1]
    table["degree"], table["count"] = round(coefficients**0.5) - 1, 3 * coefficients
    table["harmonics"] = gaussians.sh.reshape(len(gaussians), 3 * coefficients)
    return table.view(np.uint8).reshape(len(gaussians), layout.itemsize)
