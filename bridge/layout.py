"""Profiles of a PointCloud2: fields and byte layout of a point.

All fields are little-endian float32, except in `small`. The 32 bits of `rgb` are 0x00RRGGBB, as
RViz and Foxglove expect. phy124's world already follows REP-103 (metres, x forward, y left, z up),
so nothing is rotated.

- `viz`, 16 bytes: x y z rgb.
- `full`, 60 bytes: x y z rgb, then alpha 0..1, standard deviations sx sy sz [m], the orientation
  qw qx qy qz, and the velocity vx vy vz [m/s]. With several objects a point has 64 bytes; the last
  field is then `object_id`, an uint32.
- `small`, 10 bytes: x y z as int16, r g b a as uint8. After its last point the row has 16 more
  bytes: four float32 with the centre x y z [m] and the quantisation step [m]. A position is
  centre + step * (x, y, z); -32768 encodes NaN.
- `splats` is not a PointCloud2 but a SplatArray, which the function `splat_array` encodes.
- `ply`, 68 bytes or more: names and raw values of a 3DGS PLY (Kerbl et al. 2023), which splat
  viewers read. Colours are harmonics, opacities are logits, scales are logarithms, and rot_0 is w.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Frame, Gaussians
from phy124.io.ply import raw_table
from phy124.runtime.installation import needs_extra

from .cdr import ENCAPSULATION, NANO

Profile = Literal["viz", "full", "small", "ply", "splats"]
FLOAT32 = 7
"""`sensor_msgs/msg/PointField.FLOAT32`."""
DATATYPES = {"<f4": FLOAT32, "<i2": 3, "<u4": 6, "|u1": 2}
"""Constant of `sensor_msgs/msg/PointField` for each NumPy type."""
VIZ = ("x", "y", "z", "rgb")
SMALL = np.dtype([*((axis, "<i2") for axis in "xyz"), *((colour, "u1") for colour in "rgba")])
LARGEST_STEP = 32767
"""Largest magnitude of a quantised coordinate. The value -32768 encodes NaN."""
FULL = (*VIZ, "alpha", "sx", "sy", "sz", "qw", "qx", "qy", "qz", "vx", "vy", "vz")
OBJECT = "object_id"
FIRST = 4
"""Offset of the first splat in a SplatArray [bytes]; the number of splats precedes it."""


def cloud(frame: Frame, profile: Profile, header: dict[str, Any]) -> dict[str, Any]:
    """Return the PointCloud2 of a frame, ready for `cdr.encode`.

    If the frame has no velocities, the velocities in `full` are NaN. `is_dense` is false if a
    position or a velocity of the message is not finite.
    """
    table, tail = small_points(frame) if profile == "small" else (points(frame, profile), b"")
    dense = np.isfinite(frame.gaussians.means).all()
    if profile == "full":
        dense &= frame.velocities is not None and np.isfinite(frame.velocities).all()
    data = table.view(np.uint8)
    return {
        "header": header,
        "height": 1,
        "width": len(table),
        "fields": [_field(table.dtype, name) for name in table.dtype.names or ()],
        "point_step": table.itemsize,
        "row_step": table.nbytes + len(tail),
        "data": np.concatenate([data, np.frombuffer(tail, np.uint8)]) if tail else data,
        "is_dense": bool(dense),
    }


def draco_cloud(frame: Frame, bits: int, header: dict[str, Any]) -> dict[str, Any]:
    """Return a frame in the profile `viz`, compressed in the format of draco_point_cloud_transport.

    The decoder of that package writes attribute number i of the Draco data at the offset of field
    number i. Attribute 0 contains the three coordinates, and attribute 1 the four bytes of `rgb`,
    so `rgb` is the second field. Points that are not finite are removed. `bits` is the number of
    bits per coordinate.
    """
    import DracoPy

    means = frame.gaussians.means
    finite = np.isfinite(means).all(axis=1)
    table = points(frame, "viz")[finite]
    colours = table["rgb"].copy().view(np.uint8).reshape(-1, 4)
    # With another order of the points, Draco would need more bytes and more time.
    how = {"quantization_bits": bits, "preserve_order": True}
    # DracoPy cannot encode an empty cloud.
    data = DracoPy.encode(means[finite], colors=colours, **how) if len(table) else b""
    return {
        "header": header,
        "height": 1,
        "width": len(table),
        "fields": [_field(table.dtype, name) for name in ("x", "rgb", "y", "z")],
        "point_step": table.itemsize,
        "row_step": table.nbytes,
        "compressed_data": data,
        "is_dense": True,
        "format": "draco",
    }


def require_draco() -> None:
    """Check that DracoPy can be imported.

    Raises:
        InputError: DracoPy is not installed.
    """
    limit = "Draco needs the package DracoPy, which is not installed."
    with needs_extra("draco", "draco", "DracoPy", limit):
        import DracoPy  # noqa: F401


def points(frame: Frame, profile: Profile) -> NDArray[Any]:
    """Return a structured array [N] with 4 bytes per field, for all profiles except `small`."""
    gaussians = frame.gaussians
    if profile == "ply":
        return raw_table(gaussians)
    members = [(name, "<f4") for name in (FULL if profile == "full" else VIZ)]
    if profile == "full" and gaussians.object_id is not None:
        members.append((OBJECT, "<u4"))
    table = np.empty((len(gaussians), len(members)), "<f4")
    table[:, :3] = gaussians.means
    # The values are copied as integers, because copying floats may change the bits of a NaN.
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
    """Return the points of a frame in the profile `small` [N], and 16 bytes to decode them.

    These bytes are the centre of the frame's bounding box and the quantisation step, which is the
    longest side of the box divided by 65,534. The error of a position is at most half a step along
    each axis.
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
    """Return colours as integers 0x00RRGGBB [N]."""
    red, green, blue = np.rint(gaussians.rgb * 255).astype(np.uint32).T
    return red << 16 | green << 8 | blue


def evenly(count: int, limit: int | None) -> NDArray[np.intp] | None:
    """Return the indices of `limit` evenly spaced Gaussians of `count`; None if all are sent.

    The indices are the same in every frame and every run.
    """
    if limit is None or count <= limit:
        return None
    return np.arange(limit) * count // limit


def splat_array(gaussians: Gaussians, stamp: int, frame: str) -> bytes:
    """Return the CDR payload of a SplatArray.

    `stamp` is the time of the message [ns since 1970], `frame` the coordinate frame.
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
    """Return the offset of each splat in the message, modulo 8; the result is 0 or 4."""
    phases = np.full(count, FIRST)
    if (FIRST + sizes[FIRST]) % 8 == 0:
        # The second splat begins at a multiple of 8. The offset of later splats, modulo 8, is that
        # of the first or the second splat.
        phases[1 :: 2 if sizes[0] % 8 else 1] = 0
    return phases


def _layout(phase: int, frame: str, numbers: int) -> np.dtype[Any]:
    """Return the byte layout of a splat; `phase` is its offset in the payload modulo 8."""
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
    """Return Gaussians as splats in the byte layout of a SplatArray [N, size]."""
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
