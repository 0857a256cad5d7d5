"""Gaussians, particles and frames.

The world is right-handed and in metres; z is up, and the object faces +x
(docs/reference/conventions.md). Quaternions are wxyz. Values are stored after activation: opacities
in 0..1, and scales in metres. The field names are gsplat's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
SH_C0 = 0.28209479177387814
"""Value of the spherical harmonic of degree 0: rgb = 0.5 + SH_C0 * sh[:, 0]."""
SH_C1 = 0.4886025119029199
SH_C2 = (
    1.0925484305920792,
    -1.0925484305920792,
    0.31539156525252005,
    -1.0925484305920792,
    0.5462742152960396,
)
SH_C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)
"""Constant factors of the spherical harmonics of degrees 1 to 3, with the signs and in the order of
Kerbl et al. 2023.
"""
SH_COEFFICIENTS = (1, 4, 9, 16)


BLOCK = 1 << 15
"""Number of rows of an array that are processed at a time; these rows fit into the cache."""


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N anisotropic 3D Gaussians, Sigma = R(q) diag(s)^2 R(q)^T.

    Arrays are converted to C-contiguous float32.

    Raises:
        ValueError: The shapes of the arrays disagree, which is a programming error; readers refuse
            such files.
    """

    means: Array
    """Centres [N,3], m."""
    quats: Array
    """Orientations [N,4], unit quaternions wxyz."""
    scales: Array
    """Standard deviations along the local axes [N,3], m."""
    opacities: Array
    """Opacities [N], 0..1."""
    sh: Array
    """Spherical-harmonic colours [N,K,3], K in 1, 4, 9, 16."""
    object_id: NDArray[np.int32] | None = None
    """Object of each Gaussian [N]; None: a single object."""

    def __post_init__(self) -> None:
        for name in ("means", "quats", "scales", "opacities", "sh"):
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            object.__setattr__(self, name, value)
        n = len(self.means)
        if self.object_id is not None:
            ids = np.ascontiguousarray(self.object_id, dtype=np.int32)
            object.__setattr__(self, "object_id", ids)
            if ids.shape != (n,):
                raise ValueError(f"object_id has shape {ids.shape}, wanted ({n},)")
        shapes = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "opacities": (n,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, wanted {shape}")
        if self.sh.ndim != 3 or self.sh.shape[::2] != (n, 3):
            raise ValueError(f"sh has shape {self.sh.shape}, wanted ({n}, K, 3)")
        if self.sh.shape[1] not in SH_COEFFICIENTS:
            raise ValueError(f"sh has {self.sh.shape[1]} coefficients, wanted one of 1, 4, 9, 16")

    def __len__(self) -> int:
        return len(self.means)

    @classmethod
    def from_rgb(
        cls, means: NDArray, quats: NDArray, scales: NDArray, opacities: NDArray, rgb: NDArray
    ) -> Gaussians:
        """Return Gaussians with colours that do not depend on direction.

        Args:
            means: Centres [N,3], m.
            quats: Orientations wxyz [N,4].
            scales: Standard deviations along the local axes [N,3], m.
            opacities: Opacities [N], 0..1.
            rgb: Colours [N,3], 0..1.
        """
        arrays = (means, quats, scales, opacities, ((rgb - 0.5) / SH_C0)[:, None, :])
        means, quats, scales, opacities, sh = (np.asarray(array, np.float32) for array in arrays)
        return cls(means, quats, scales, opacities, sh)

    @property
    def rgb(self) -> Array:
        """Colours [N,3] in 0..1 from the harmonics of degree 0."""
        return np.clip(0.5 + SH_C0 * self.sh[:, 0], 0, 1)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return SH_COEFFICIENTS.index(self.sh.shape[1])

    def select(self, which: NDArray | slice) -> Gaussians:
        """Return the Gaussians of a mask, an index array or a slice."""
        if isinstance(which, np.ndarray) and which.dtype == bool and which.all():
            return self
        return Gaussians(
            self.means[which],
            self.quats[which],
            self.scales[which],
            self.opacities[which],
            self.sh[which],
            None if self.object_id is None else self.object_id[which],
        )

    def of_object(self, index: int) -> Gaussians:
        """Return the Gaussians of an object, without `object_id`."""
        if self.object_id is None:
            return self if index == 0 else self.select(np.zeros(0, int))
        return replace(self.select(self.object_id == index), object_id=None)

    def transform(self, scale: float, offset: NDArray) -> Gaussians:
        """Return a copy, scaled about the origin and then shifted by `offset` [3], m."""
        means = self.means * scale + np.asarray(offset)
        return replace(self, means=means, scales=self.scales * scale)

    @property
    def longest(self) -> Array:
        """Largest standard deviation of each Gaussian [N], m."""
        x, y, z = self.scales.T  # several times faster than np.max over rows of three
        return np.maximum(np.maximum(x, y), z)

    @property
    def cover(self) -> Array:
        """Visible area of each Gaussian [N], m^2: opacity x product of the two longest axes."""
        x, y, z = self.scales.T
        return self.opacities * np.maximum(np.maximum(x * y, y * z), z * x)

    def deviations(self) -> NDArray[np.float64]:
        """Return standard deviations along the world axes [N,3], m."""
        axes = rotation_matrices(self.quats) * self.scales[:, None, :].astype(np.float64)
        return np.sqrt(np.einsum("nij,nij->ni", axes, axes))

    def covariances(self) -> NDArray[np.float64]:
        """Return covariance matrices [N,3,3], m^2."""
        axes = rotation_matrices(self.quats) * self.scales[:, None, :].astype(np.float64)
        return axes @ axes.transpose(0, 2, 1)


def finite_rows(array: NDArray) -> NDArray[np.bool_]:
    """Return a mask of the rows [N,...] in which all values are finite."""
    flat = array.reshape(len(array), math.prod(array.shape[1:]))
    finite = np.ones(len(array), bool)
    with np.errstate(invalid="ignore"):
        for start in range(0, len(flat), BLOCK):
            part = flat[start : start + BLOCK]
            total = np.zeros(len(part))  # NaN if any value of a row is NaN or infinite
            for column in part.T:
                total += column
            finite[start : start + BLOCK] = np.isfinite(total)
    return finite


def join(sets: Sequence[Gaussians]) -> Gaussians:
    """Join sets of Gaussians in order; missing higher harmonics are zero."""
    most = max(item.sh.shape[1] for item in sets)

    def stack(name: str) -> NDArray:
        return np.concatenate([getattr(item, name) for item in sets])

    sh = [np.pad(item.sh, ((0, 0), (0, most - item.sh.shape[1]), (0, 0))) for item in sets]
    ids = None if any(item.object_id is None for item in sets) else stack("object_id")
    means, quats, scales, opacities = map(stack, ("means", "quats", "scales", "opacities"))
    return Gaussians(means, quats, scales, opacities, np.concatenate(sh), ids)


def as_objects(objects: dict[int, Gaussians]) -> Gaussians:
    """Join the Gaussians of several objects; the keys become `object_id`."""
    return join(
        [
            replace(item, object_id=np.full(len(item), index, np.int32))
            for index, item in objects.items()
        ]
    )


class Wrench(NamedTuple):
    """Mean force and torque of the object on a wall in the last frame interval."""

    force: NDArray[np.float64]
    """Force [3], N."""
    torque: NDArray[np.float64]
    """Torque about the object's centre of mass [3], N m."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The Gaussians at one time of the simulation."""

    index: int
    time: float
    """Time since the start, s."""
    gaussians: Gaussians
    velocities: Array | None = None
    """Velocities of the centres [N,3], m/s, if requested."""
    contacts: Array | None = None
    """Mean force of the walls on each Gaussian in the last frame interval [N,3], N."""
    wrenches: dict[str, Wrench] | None = None
    """Force and torque on each wall, by name, if requested."""
    carried: tuple[Array, Array] | None = None
    """Positions [C,3], m, and deformation gradients [C,3,3] of the particles that carry the
    Gaussians; None if frames are not kept.
    """


@dataclass(frozen=True, eq=False)
class Particles:
    """P material points at rest, in spatial order."""

    x: NDArray[np.float32]
    """Positions [P,3], m."""
    volume: NDArray[np.float64]
    """Volumes [P], m^3, which add up to that of the object."""
    density: NDArray[np.float64]
    """Densities [P], kg/m^3."""
    material: NDArray[np.int32]
    """Index of each particle's material [P]."""
    gaussian: NDArray[np.int32]
    """Index of the Gaussian at each particle [P]; -1: none."""
    body: NDArray[np.int32] | None = None
    """Object of each particle [P]; None: a single object."""
    surface: NDArray[np.float64] | None = None
    """Surface points of bodies on lattices [S,8], or None: position [m], outward normal, object
    index, and 1 if the point is a Gaussian outside the material.
    """
    copies: NDArray[np.integer] | None = None
    """For each cell of a lattice, the copies of its 27 nodes that the cell uses [C,27]; None: no
    node has copies (phy124/particles/pieces.py).
    """
    cell: NDArray[np.int64] | None = None
    """If each particle stands for a cell of a lattice: the index of the cell [P]."""
    piece: NDArray[np.int32] | None = None
    """Separate piece of its object to which each particle belongs [P]; None: objects of one piece
    (phy124/particles/islands.py).
    """

    def __len__(self) -> int:
        return len(self.x)

    @property
    def mass(self) -> NDArray[np.float64]:
        """Masses [P], kg."""
        return self.volume * self.density


def by_object(
    gaussians: Gaussians, particles: Particles
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield the Gaussians and the particles of each object."""
    if particles.body is None or gaussians.object_id is None:
        yield np.arange(len(gaussians)), np.arange(len(particles.x))
        return
    for body in np.unique(gaussians.object_id):
        yield np.flatnonzero(gaussians.object_id == body), np.flatnonzero(particles.body == body)


def rotation_matrices(quats: NDArray) -> NDArray[np.float64]:
    """Return the rotation matrices [N,3,3] of quaternions wxyz [N,4] of any length."""
    q = np.asarray(quats, dtype=np.float64)
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def quaternions(rotations: NDArray) -> NDArray[np.float64]:
    """Return the unit quaternions wxyz [N,4] of rotation matrices [N,3,3] (Shepperd's method)."""
    r = np.asarray(rotations, dtype=np.float64)
    diagonal = np.einsum("nii->ni", r)
    trace = diagonal.sum(axis=1, keepdims=True)
    # The rows below are the columns of 4 q q^T. The column with the largest diagonal entry is well
    # conditioned.
    squares = np.concatenate([1 + trace, 1 + 2 * diagonal - trace], axis=1)
    best = squares.argmax(axis=1)
    xy, xz, yz = r[:, 1, 0] + r[:, 0, 1], r[:, 0, 2] + r[:, 2, 0], r[:, 2, 1] + r[:, 1, 2]
    wx, wy, wz = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    columns = np.stack(
        [
            np.stack([squares[:, 0], wx, wy, wz], axis=1),
            np.stack([wx, squares[:, 1], xy, xz], axis=1),
            np.stack([wy, xy, squares[:, 2], yz], axis=1),
            np.stack([wz, xz, yz, squares[:, 3]], axis=1),
        ],
        axis=1,
    )
    q = columns[np.arange(len(r)), best]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def sh_basis(directions: NDArray, count: int) -> NDArray[np.float64]:
    """Return the first `count` (1, 4, 9 or 16) harmonics at unit directions [..., 3]."""
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    values = [np.full_like(x, SH_C0), -SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    values += [SH_C2[0] * x * y, SH_C2[1] * y * z, SH_C2[2] * (2 * zz - xx - yy), SH_C2[3] * x * z]
    values += [SH_C2[4] * (xx - yy), SH_C3[0] * y * (3 * xx - yy), SH_C3[1] * x * y * z]
    values += [SH_C3[2] * y * (4 * zz - xx - yy), SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy)]
    values += [
        SH_C3[4] * x * (4 * zz - xx - yy),
        SH_C3[5] * z * (xx - yy),
        SH_C3[6] * x * (xx - 3 * yy),
    ]
    return np.stack(values[:count], axis=-1)


def rotate_sh(sh: NDArray, quats: NDArray) -> NDArray[np.float32]:
    """Rotate the direction-dependent colours `sh` [N,K,3] by `quats` wxyz [N,4].

    The rotated colour is c'(d) = c(R^T d). A rotation mixes only harmonics of equal degree.
    """
    turned = np.array(sh, dtype=np.float64)
    rotations = rotation_matrices(quats)
    directions = spread_directions(16)
    for degree, band in ((1, slice(1, 4)), (2, slice(4, 9)), (3, slice(9, 16))):
        if sh.shape[1] < (degree + 1) ** 2:
            break
        solve = np.linalg.pinv(sh_basis(directions, 16)[:, band])
        # A row vector times R is R^T d, which is the direction before the rotation.
        before = sh_basis(directions @ rotations, 16)[:, :, band]
        turned[:, band] = np.einsum("jd,ndk,nkc->njc", solve, before, turned[:, band])
    return turned.astype(np.float32)


def mirror_signs(count: int) -> NDArray[np.float64]:
    """Return 1 for harmonics that are even in x, and -1 for those that are odd [count]."""
    direction = np.array([0.3, 0.5, np.sqrt(0.66)])
    return np.sign(sh_basis(direction * [-1, 1, 1], count) * sh_basis(direction, count))


def spread_directions(count: int) -> NDArray[np.float64]:
    """Return unit vectors, evenly spread (Fibonacci lattice) [count,3]."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def walls_of(frames: Sequence[Frame]) -> tuple[str, ...]:
    """Return the names of all walls in the frames; walls may be added and removed in a run."""
    return tuple(dict.fromkeys(name for frame in frames for name in frame.wrenches or ()))


def stack_wrenches(frames: Sequence[Frame]) -> NDArray[np.float64]:
    """Return the wrenches on all walls in all frames [T,W,2,3]; zero on absent walls."""
    walls, absent = walls_of(frames), np.zeros((2, 3))
    rows = [[(frame.wrenches or {}).get(wall, absent) for wall in walls] for frame in frames]
    return np.array(rows, np.float64).reshape(len(frames), len(walls), 2, 3)


def of_walls(walls: Sequence[str], wrenches: NDArray) -> dict[str, Wrench]:
    """Return the wrenches of a frame [W,2,3] by the names of the walls."""
    return {wall: Wrench(*wrench) for wall, wrench in zip(walls, wrenches, strict=True)}
