"""Profiles of a PointCloud2: which numbers of a Gaussian a point holds, and where.

All fields are little-endian float32, except in `small`. `rgb` holds 0x00RRGGBB in its 32 bits, as
RViz and Foxglove expect. The world follows REP-103 already (metres, x forward, y left, z up), so
nothing is rotated.

- `viz`, 16 bytes: x y z rgb.
- `full`, 60 bytes: the same, then alpha 0..1, standard deviations sx sy sz [m], the orientation
  qw qx qy qz, and the velocity vx vy vz [m/s]; of several objects 64 bytes, the last an uint32
  `object_id`.
- `small`, 10 bytes: x y z as int16 steps, r g b a as uint8. The row has 16 bytes after its last
  point: four float32, the centre x y z [m] and the step [m]. A position is centre + step * (x, y,
  z); -32768 stands for NaN.
- `splats` is no PointCloud2, see `splats`.
- `ply`, 68 bytes or more: the names and raw values of a 3DGS PLY (Kerbl et al. 2023), which splat
  viewers read: colours as harmonics, opacity as logit, scales as logarithm, rot_0 = w.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Frame, Gaussians
from phy124.io.ply import raw_table

from .cdr import ENCAPSULATION, NANO

Profile = Literal["viz", "full", "small", "ply", "splats"]
FLOAT32 = 7
"""`sensor_msgs/msg/PointField.FLOAT32`."""
DATATYPES = {"<f4": FLOAT32, "<i2": 3, "<u4": 6, "|u1": 2}
"""NumPy's type -> that of `sensor_msgs/msg/PointField`."""
VIZ = ("x", "y", "z", "rgb")
SMALL = np.dtype([*((axis, "<i2") for axis in "xyz"), *((colour, "u1") for colour in "rgba")])
LARGEST_STEP = 32767
"""Largest step in int16, positive or negative; -32768 has a meaning of its own."""
FULL = (*VIZ, "alpha", "sx", "sy", "sz", "qw", "qx", "qy", "qz", "vx", "vy", "vz")
OBJECT = "object_id"
FIRST = 4
"""Where the first splat begins, behind the number of splats [bytes]."""


def cloud(frame: Frame, profile: Profile, header: dict[str, Any]) -> dict[str, Any]:
    """The PointCloud2 of a frame, ready for `cdr.encode`.

    Without velocities in the frame, theirs are NaN and `is_dense` is false.
    """
    table, tail = small_points(frame) if profile == "small" else (points(frame, profile), b"")
    known = profile != "full" or frame.velocities is not None
    data = table.view(np.uint8)
    return {
        "header": header,
        "height": 1,
        "width": len(table),
        "fields": [_field(table.dtype, name) for name in table.dtype.names or ()],
        "point_step": table.itemsize,
        "row_step": table.nbytes + len(tail),
        "data": np.concatenate([data, np.frombuffer(tail, np.uint8)]) if tail else data,
        "is_dense": bool(known and np.isfinite(frame.gaussians.means).all()),
    }


def points(frame: Frame, profile: Profile) -> NDArray[Any]:
    """A structured row per Gaussian [N] with members of 4 bytes, for all profiles but `small`."""
    gaussians = frame.gaussians
    if profile == "ply":
        return raw_table(gaussians)
    members = [(name, "<f4") for name in (FULL if profile == "full" else VIZ)]
    if profile == "full" and gaussians.object_id is not None:
        members.append((OBJECT, "<u4"))
    table = np.empty((len(gaussians), len(members)), "<f4")
    table[:, :3] = gaussians.means
    # Copied as integers, since copying floats may change the bits of a NaN.
    table.view("<u4")[:, 3] = packed_rgb(gaussians)
    if profile == "full":
        table[:, 4] = gaussians.opacities
        table[:, 5:8] = gaussians.scales
        table[:, 8:12] = gaussians.quats
        table[:, 12:15] = np.nan if frame.velocities is None else frame.velocities
        if gaussians.object_id is not None:
            table.view("<u4")[:, 15] = gaussians.object_id
    return table.view(members)[:, 0]


def small_points(frame: Frame) -> tuple[NDArray[Any], bytes]:
    """Rows of `small` [N], and the 16 bytes with centre and step.

    A position is wrong by at most half a step along each axis; the step is the longest side of the
    frame's bounding box divided by 65,534.
    """
    gaussians = frame.gaussians
    means = gaussians.means.astype(np.float64)
    known = np.asarray(np.isfinite(means).all(axis=1))
    inside = means[known] if known.any() else np.zeros((1, 3))
    low, high = inside.min(axis=0), inside.max(axis=0)
    centre = ((low + high) / 2).astype("<f4")
    reach = np.abs(inside - centre).max()
    step = np.nextafter(np.float32(reach / LARGEST_STEP), np.float32(np.inf), dtype="<f4")
    table = np.empty(len(means), SMALL)
    for axis, places in zip("xyz", np.where(known[:, None], means - centre, 0).T, strict=True):
        table[axis] = np.where(known, np.rint(places / float(step)), -LARGEST_STEP - 1)
    colours = np.concatenate([gaussians.rgb, gaussians.opacities[:, None]], axis=1)
    for colour, values in zip("rgba", np.rint(np.clip(colours, 0, 1) * 255).T, strict=True):
        table[colour] = values
    return table, centre.tobytes() + step.tobytes()


def _field(dtype: Any, name: str) -> dict[str, Any]:
    kind, offset = dtype.fields[name][:2]
    return {"name": name, "offset": offset, "datatype": DATATYPES[kind.str], "count": 1}


def packed_rgb(gaussians: Gaussians) -> NDArray[np.uint32]:
    """Colours as 0x00RRGGBB [N]."""
    red, green, blue = np.rint(gaussians.rgb * 255).astype(np.uint32).T
    return red << 16 | green << 8 | blue


def evenly(count: int, limit: int | None) -> NDArray[np.intp] | None:
    """Indices of the Gaussians to keep, so that at most `limit` of `count` remain; None: all.

    They are evenly spaced, so the choice is the same in every frame and every run.
    """
    if limit is None or count <= limit:
        return None
    return np.arange(limit) * count // limit


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
