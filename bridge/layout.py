"""Field profiles: which numbers of a Gaussian stand in one point of a PointCloud2, and where.

All fields are little-endian float32; `rgb` holds 0x00RRGGBB in its 32 bits, as RViz and Foxglove
expect. The world is REP-103 already (metres, x forward, y left, z up), so nothing is turned.

- `viz`, 16 bytes: x y z rgb.
- `full`, 60 bytes: and alpha 0..1, standard deviations sx sy sz [m], the orientation qw qx qy qz,
  the velocity vx vy vz [m/s].
- `ply`, 68 bytes and more: the names and raw values of a 3DGS PLY (Kerbl et al. 2023), which
  splat viewers read: colours as harmonics, opacity as logit, scales as logarithm, rot_0 = w.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Frame, Gaussians
from phy124.ply import raw_table

Profile = Literal["viz", "full", "ply"]
FLOAT32 = 7
"""`sensor_msgs/msg/PointField.FLOAT32`."""
VIZ = ("x", "y", "z", "rgb")
FULL = (*VIZ, "alpha", "sx", "sy", "sz", "qw", "qx", "qy", "qz", "vx", "vy", "vz")


def cloud(frame: Frame, profile: Profile, header: dict[str, Any]) -> dict[str, Any]:
    """The PointCloud2 of a frame, ready for `cdr.encode`.

    Velocities the frame does not have are NaN; the message says so by `is_dense` false.
    """
    table = points(frame, profile)
    known = profile != "full" or frame.velocities is not None
    return {
        "header": header,
        "height": 1,
        "width": len(table),
        "fields": [
            {"name": name, "offset": 4 * i, "datatype": FLOAT32, "count": 1}
            for i, name in enumerate(table.dtype.names or ())
        ],
        "point_step": table.itemsize,
        "row_step": table.nbytes,
        "data": table.view(np.uint8),
        "is_dense": bool(known and np.isfinite(frame.gaussians.means).all()),
    }


def points(frame: Frame, profile: Profile) -> NDArray[Any]:
    """One structured row per Gaussian [N], all members float32."""
    gaussians = frame.gaussians
    if profile == "ply":
        return raw_table(gaussians)
    names = FULL if profile == "full" else VIZ
    table = np.empty((len(gaussians), len(names)), "<f4")
    table[:, :3] = gaussians.means
    # As integers: a float copy may change the bits of what looks like a NaN.
    table.view("<u4")[:, 3] = packed_rgb(gaussians)
    if profile == "full":
        table[:, 4] = gaussians.opacities
        table[:, 5:8] = gaussians.scales
        table[:, 8:12] = gaussians.quats
        table[:, 12:] = np.nan if frame.velocities is None else frame.velocities
    return table.view([(name, "<f4") for name in names])[:, 0]


def packed_rgb(gaussians: Gaussians) -> NDArray[np.uint32]:
    """Colours 0x00RRGGBB [N]."""
    red, green, blue = np.rint(gaussians.rgb * 255).astype(np.uint32).T
    return red << 16 | green << 8 | blue


def evenly(count: int, limit: int | None) -> NDArray[np.intp] | None:
    """Which of `count` Gaussians to keep so that at most `limit` remain; None: all of them.

    Evenly spaced, so the choice is the same in every frame and every run.
    """
    if limit is None or count <= limit:
        return None
    return np.arange(limit) * count // limit
