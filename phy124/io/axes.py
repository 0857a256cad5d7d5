"""Axes: converts the directions of a file to ours, and rotates Gaussians.

Our world is z up with the object facing +x (docs/reference/conventions.md). A file is first rotated
by `rotate`, if that is given; then `up` and `front`, or its dialect, say which of its directions
are which.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions, rotate_sh, rotation_matrices

DIALECTS = {
    "3dgs": ("-y", "-z"),
    "phy124": ("-y", "-z"),
    "trellis": ("-y", "-z"),
    "sharp": ("-y", "-z"),
    "triposplat": ("-y", "x"),
    "lgm": ("y", "z"),
    "dreamgaussian": ("y", "z"),
    "sam3d": ("z", "-y"),
}
"""Axes of the file that point up and out of the object's front, by the program that wrote it.

TRELLIS rotates its z-up world to y down while saving; SAM 3D Objects, made by the same people,
saves z up.
"""
FRONTS = {"y": "z", "-y": "-z", "z": "x", "-z": "-x", "x": "y", "-x": "-y"}
"""The assumed front of a file for which only the up axis is given."""
ACROSS = 0.02
"""Smallest sine of the angle between front and up."""


def orientation(
    up: str | None = None,
    front: str | None = None,
    dialect: str | None = None,
    rotate: str | None = None,
) -> NDArray[np.float64]:
    """Rotation [3,3] from the file's axes to ours.

    Args:
        up: Direction that points up: "x", "-y", ..., or three numbers such as "0.1,-1,0.2".
        front: Direction that the object faces; only its level part counts; default: `FRONTS`.
        dialect: Key of `DIALECTS`, used where `up` is not given; default: 3dgs.
        rotate: Rotation applied to the file before: angles about x, y and z [degrees], in this
            order about fixed axes, or a quaternion w,x,y,z.

    Raises:
        InputError: If one of them cannot be read or they contradict each other.
    """
    if up is None:
        dialect = dialect or "3dgs"
        if dialect not in DIALECTS:
            known = ", ".join(DIALECTS)
            raise InputError("dialect", dialect, "It is not known.", f"Choose one of {known}.")
        up, front = DIALECTS[dialect][0], front or DIALECTS[dialect][1]
    z = direction("up", up)
    x = direction("front", front) if front else _usual_front(z)
    level = x - z * (x @ z)
    if np.linalg.norm(level) < ACROSS:
        limit = "The front cannot lie along the up axis."
        raise InputError("front", front, limit, f"Choose an axis across {up}.")
    x = level / np.linalg.norm(level)
    axes = np.stack([x, np.cross(z, x), z])
    return axes if rotate is None else axes @ turn(rotate)


def direction(field: str, text: str) -> NDArray[np.float64]:
    """The unit vector given by the name of an axis or by three numbers.

    Raises:
        InputError: If the text is neither, or the vector has no length.
    """
    if text in FRONTS:
        vector = np.zeros(3)
        vector["xyz".index(text[-1])] = -1 if text.startswith("-") else 1
        return vector
    vector = numbers(text, 3)
    if vector is None or not np.linalg.norm(vector):
        raise InputError(
            field, text, "It is not an axis or a direction.",
            f"Choose one of {', '.join(FRONTS)}, or three numbers such as 0.1,-1,0.2.",
        )  # fmt: skip
    return vector / np.linalg.norm(vector)


def turn(text: str) -> NDArray[np.float64]:
    """The rotation [3,3] given by three angles [degrees] or by a quaternion wxyz.

    Raises:
        InputError: If the text is neither.
    """
    angles, quaternion = numbers(text, 3), numbers(text, 4)
    if angles is not None:
        return euler(angles)
    if quaternion is None or not np.linalg.norm(quaternion):
        raise InputError(
            "rotate", text, "It is neither three angles nor a quaternion.",
            "Write degrees about x, y and z, such as 10,0,-25, or a quaternion w,x,y,z.",
        )  # fmt: skip
    return rotation_matrices(quaternion[None])[0]


def euler(degrees: Sequence[float] | NDArray) -> NDArray[np.float64]:
    """Rotation about x, then y, then z, all three fixed: Rz Ry Rx."""
    matrix = np.eye(3)
    for axis, angle in enumerate(np.radians(degrees).tolist()):
        c, s = math.cos(angle), math.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
        matrix = step @ matrix
    return matrix


def upright(normal: NDArray) -> NDArray[np.float64]:
    """The smallest rotation [3,3] that takes a unit vector to +z."""
    x, y, z = np.asarray(normal, np.float64).tolist()
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues about normal x z, whose length is the sine and whose partner 1 + z the cosine.
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)


def numbers(text: str, count: int) -> NDArray[np.float64] | None:
    """Exactly `count` finite numbers separated by commas or spaces, or None."""
    try:
        values = np.array(text.replace(",", " ").split(), np.float64)
    except ValueError:
        return None
    return values if len(values) == count and np.isfinite(values).all() else None


def turned(gaussians: Gaussians, rotation: NDArray[np.float64]) -> Gaussians:
    """The Gaussians rotated about the origin by `rotation [3,3]`: centres, shapes and colours.

    A signed permutation of the axes is exact: the quaternion's vector part and the scales are
    permuted like the centres, and only harmonics above degree 0 need arithmetic.
    """
    if not np.array_equal(np.abs(rotation), np.abs(rotation).round()):
        means = gaussians.means.astype(np.float64) @ rotation.T
        quats = quaternions(rotation @ rotation_matrices(gaussians.quats))
        sh = _turned_sh(gaussians.sh, rotation)
        means, quats = means.astype(np.float32), quats.astype(np.float32)
        return replace(gaussians, means=means, quats=quats, sh=sh)
    order, sign = np.abs(rotation).argmax(axis=1), rotation.sum(axis=1).astype(np.float32)
    vector = gaussians.quats[:, 1:][:, order] * sign
    return replace(
        gaussians,
        means=gaussians.means[:, order] * sign,
        quats=np.concatenate([gaussians.quats[:, :1], vector], axis=1),
        scales=gaussians.scales[:, order],
        sh=_turned_sh(gaussians.sh, rotation),
    )


def _turned_sh(sh: NDArray, rotation: NDArray[np.float64]) -> NDArray:
    count = sh.shape[1]
    if count == 1:
        return sh
    # One turn for all: its matrix is what it does to each harmonic alone.
    unit = np.repeat(np.eye(count, dtype=np.float32)[:, :, None], 3, axis=2)
    matrix = rotate_sh(unit, np.repeat(quaternions(rotation[None]), count, axis=0))[:, :, 0]
    return np.einsum("kj,nkc->njc", matrix, sh, optimize=True)


def _usual_front(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """The assumed front for the axis closest to up."""
    nearest = max(FRONTS, key=lambda axis: float(direction("up", axis) @ z))
    return direction("front", FRONTS[nearest])
