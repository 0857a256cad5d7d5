"""Converts the axes of a file to the axes of phy124, and rotates Gaussians.

In the world of phy124, z is up and the object faces +x (docs/reference/conventions.md).
"""

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
"""Up and front directions in a file, by the program that wrote the file."""
FRONTS = {"y": "z", "-y": "-z", "z": "x", "-z": "-x", "x": "y", "-x": "-y"}
"""Assumed front direction for each up direction, if only the up direction is known."""
ACROSS = 0.02
"""Smallest allowed sine of the angle between the front and up directions."""


def orientation(
    up: str | None = None,
    front: str | None = None,
    dialect: str | None = None,
    rotate: str | None = None,
) -> NDArray[np.float64]:
    """Return the rotation [3,3] from the file's axes to the axes of phy124.

    Args:
        up: Direction that points up: "x", "-y", ..., or three numbers such as "0.1,-1,0.2".
        front: Direction that the object faces; only its horizontal component is used. Default: the
            entry of `FRONTS` for `up`.
        dialect: Key of `DIALECTS` that determines the axes if `up` is None; default: 3dgs.
        rotate: Rotation that is applied to the file first: angles about the fixed axes x, y and z
            [degrees], applied in this order, or a quaternion w,x,y,z.

    Raises:
        InputError: If an argument cannot be parsed, or `front` is parallel to `up`.
    """
    if up is None:
        dialect = dialect or "3dgs"
        if dialect not in DIALECTS:
            known = ", ".join(DIALECTS)
            raise InputError("dialect", dialect, "It is not known.", f"Choose one of {known}.")
        up, front = DIALECTS[dialect][0], front or DIALECTS[dialect][1]
    z = parse_direction("up", up)
    x = parse_direction("front", front) if front else _usual_front(z)
    level = x - z * (x @ z)
    if np.linalg.norm(level) < ACROSS:
        limit = "The front cannot lie along the up axis."
        raise InputError("front", front, limit, f"Choose an axis perpendicular to {up}.")
    x = level / np.linalg.norm(level)
    axes = np.stack([x, np.cross(z, x), z])
    return axes if rotate is None else axes @ parse_rotation(rotate)


def parse_direction(field: str, text: str) -> NDArray[np.float64]:
    """Return the unit vector of an axis name, such as "-y", or of three numbers.

    Raises:
        InputError: If the text is neither an axis name nor three numbers, or the vector is zero.
    """
    if text in FRONTS:
        vector = np.zeros(3)
        vector["xyz".index(text[-1])] = -1 if text.startswith("-") else 1
        return vector
    vector = parse_numbers(text, 3)
    if vector is None or not np.linalg.norm(vector):
        limit = "It is not an axis or a direction."
        remedy = f"Choose one of {', '.join(FRONTS)}, or three numbers such as 0.1,-1,0.2."
        raise InputError(field, text, limit, remedy)
    return vector / np.linalg.norm(vector)


def parse_rotation(text: str) -> NDArray[np.float64]:
    """Return the rotation [3,3] that three angles [degrees] or a quaternion wxyz describe.

    Raises:
        InputError: If the text is neither three angles nor a quaternion.
    """
    angles, quaternion = parse_numbers(text, 3), parse_numbers(text, 4)
    if angles is not None:
        return euler(angles)
    if quaternion is None or not np.linalg.norm(quaternion):
        limit = "It is neither three angles nor a quaternion."
        remedy = "Write degrees about x, y and z, such as 10,0,-25, or a quaternion w,x,y,z."
        raise InputError("rotate", text, limit, remedy)
    return rotation_matrices(quaternion[None])[0]


def euler(degrees: Sequence[float] | NDArray) -> NDArray[np.float64]:
    """Return the rotation [3,3] about the fixed axes x, then y, then z: Rz Ry Rx."""
    matrix = np.eye(3)
    for axis, angle in enumerate(np.radians(degrees).tolist()):
        c, s = math.cos(angle), math.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
        matrix = step @ matrix
    return matrix


def upright(normal: NDArray) -> NDArray[np.float64]:
    """Return the smallest rotation [3,3] that maps a unit vector to +z."""
    x, y, z = np.asarray(normal, np.float64).tolist()
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # This is Rodrigues' formula. The axis is normal x z; its length is the sine of the angle, and z
    # is the cosine.
    cross = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)


def parse_numbers(text: str, count: int) -> NDArray[np.float64] | None:
    """Read `count` finite numbers separated by commas or spaces; return None for any other text."""
    try:
        values = np.array(text.replace(",", " ").split(), np.float64)
    except ValueError:
        return None
    return values if len(values) == count and np.isfinite(values).all() else None


def rotate_gaussians(gaussians: Gaussians, rotation: NDArray[np.float64]) -> Gaussians:
    """Rotate the centres, shapes and colours of Gaussians about the origin by `rotation [3,3]`.

    If the rotation only permutes axes and changes signs, the result is exact, apart from harmonics
    above degree 0, which are rounded.
    """
    if not np.array_equal(np.abs(rotation), np.abs(rotation).round()):
        means = gaussians.means.astype(np.float64) @ rotation.T
        quats = quaternions(rotation @ rotation_matrices(gaussians.quats))
        sh = _rotate_colours(gaussians.sh, rotation)
        means, quats = means.astype(np.float32), quats.astype(np.float32)
        return replace(gaussians, means=means, quats=quats, sh=sh)
    order, sign = np.abs(rotation).argmax(axis=1), rotation.sum(axis=1).astype(np.float32)
    vector = gaussians.quats[:, 1:][:, order] * sign
    return replace(
        gaussians,
        means=gaussians.means[:, order] * sign,
        quats=np.concatenate([gaussians.quats[:, :1], vector], axis=1),
        scales=gaussians.scales[:, order],
        sh=_rotate_colours(gaussians.sh, rotation),
    )


def _rotate_colours(sh: NDArray, rotation: NDArray[np.float64]) -> NDArray:
    count = sh.shape[1]
    if count == 1:
        return sh
    # The rotated unit harmonics are the rows of a matrix. This matrix rotates the harmonics of all
    # Gaussians.
    unit = np.repeat(np.eye(count, dtype=np.float32)[:, :, None], 3, axis=2)
    matrix = rotate_sh(unit, np.repeat(quaternions(rotation[None]), count, axis=0))[:, :, 0]
    return np.einsum("kj,nkc->njc", matrix, sh, optimize=True)


def _usual_front(z: NDArray[np.float64]) -> NDArray[np.float64]:
    nearest = max(FRONTS, key=lambda axis: float(parse_direction("up", axis) @ z))
    return parse_direction("front", FRONTS[nearest])
