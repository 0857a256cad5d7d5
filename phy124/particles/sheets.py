"""Fills the voxels of sheets that have no full voxels, such as leaves and the walls of cups.

The material of each voxel lies between two planes. The normal and the middle of these planes follow
from the centres of the filled parts of the surrounding voxels. These centres depend on the planes
in turn, so planes are found by iteration. The middle takes account of two effects: a curved sheet
bends away from its tangential plane, and a cube around a voxel cuts more of a sheet on the side
nearer to the middle of the cube.

At the rim of a sheet, the material is as thick as in the neighbouring voxels, but crosses only a
part of the voxel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.particles.cuts import below, between, fill_between

SHORTEST = 0.1
"""A voxel at the rim of a sheet counts as filled over at least this fraction of its length."""
ROUNDS, FASTER = 3, 1.5
"""`ROUNDS`: number of times that the middle planes of sheets are improved. `FASTER`: factor on the
corrections of the planes, which would otherwise approach their final position slowly.
"""
STEEP = 16
"""Exponent with which the thicknesses around a voxel are averaged. Voxels at the rim of a sheet
seem thinner than the sheet, so the mean must be close to the largest thickness.
"""
AT_ONCE = 4096
"""Number of voxels whose neighbours are in memory at the same time."""
AROUND = np.array(list(np.ndindex(5, 5, 5))) - 2
"""Steps from a voxel to the 125 voxels within two steps [125,3]."""
NEXT = (np.abs(AROUND) <= 1).all(axis=1)
"""Mask of the steps in `AROUND` that lead to a voxel itself or to its 26 neighbours [125]."""


class Planes(NamedTuple):
    """Middle planes of sheets in K voxels; positions are relative to the middles of the voxels."""

    normal: NDArray[np.float64]
    """Unit normals [K,3]."""
    height: NDArray[np.float64]
    """Distances of the planes from the middles of their voxels, along the normals [K]."""
    thick: NDArray[np.float64]
    """Thickness of the material in the 27 voxels around each voxel, if the sheet crossed all of
    them [K].
    """
    inward: NDArray[np.float64]
    """Unit vectors along the sheets, towards the material in the surrounding 27 voxels [K,3]."""

    @classmethod
    def through(cls, normal: NDArray, middle: NDArray) -> Planes:
        """Return planes with the normals `normal` [K,3] through the points `middle` [K,3]."""
        return cls(normal, (middle * normal).sum(axis=1), np.zeros(len(normal)), normal)


def fill_sheets(
    padded: NDArray,
    index: NDArray[np.int64],
    chosen: NDArray[np.int64],
    planes: Planes,
    thick: NDArray[np.float64],
    shift: NDArray[np.float64],
    spread: NDArray[np.float64],
) -> None:
    """Set the centres [V,3] and second moments [V,3,3] of the voxels that belong to sheets.

    Args:
        padded: Filled fractions, padded by 2 voxels [X+4,Y+4,Z+4].
        index: Indices of all voxels that are not empty [V,3].
        chosen: Indices of the K voxels that belong to sheets [K].
        planes: First approximations of the middle planes of these K voxels.
        thick: Thickness of the material around each voxel, followed by a zero [V+1]. This function
            sets the values of sheets.
        shift: Centres of the filled parts [V,3]. This function sets the values of sheets; the
            others must be set before.
        spread: Second moments of the filled parts [V,3,3].
    """
    if not len(chosen):
        return
    fraction = padded[tuple((index + 2).T)]
    number = np.full(padded.shape, -1)
    number[tuple((index + 2).T)] = np.arange(len(index))
    parts = np.array_split(np.arange(len(chosen)), -(-len(chosen) // AT_ONCE))
    near = [number[tuple((index[chosen[part], None] + 2 + AROUND).T)].T for part in parts]
    for _ in range(ROUNDS):
        shift[chosen], _ = fill_between(fraction[chosen], planes.normal, planes.height)
        better = [
            _improve(Planes(*(values[part] for values in planes)), some, fraction, shift)
            for part, some in zip(parts, near, strict=True)
        ]
        planes = Planes(*map(np.concatenate, zip(*better, strict=True)))
    thick[chosen] = planes.thick
    whole = np.concatenate([_steep_mean(thick[some]) for some in near])
    whole = between(planes.normal, planes.height, whole)
    length = np.clip(fraction[chosen] / np.maximum(whole, 1e-9), SHORTEST, 1)
    centre, second = fill_between(fraction[chosen] / length, planes.normal, planes.height)
    inward, missing = planes.inward, (1 - length)[:, None]
    squares = np.einsum("ki,kij,kj->k", inward, second, inward)
    shift[chosen] = centre + missing * np.sqrt(3 * np.maximum(squares, 0))[:, None] * inward
    squeeze = np.eye(3) - missing[:, :, None] * inward[:, :, None] * inward[:, None, :]
    spread[chosen] = squeeze @ second @ squeeze


def _improve(planes: Planes, near: NDArray, fraction: NDArray, shift: NDArray) -> Planes:
    """Return improved planes, computed from the centres of the filled parts of surrounding voxels.

    Args:
        planes: The planes of K voxels.
        near: Numbers of the surrounding voxels [K,125]; -1 if a voxel is empty.
        fraction: Filled fractions of all voxels [V].
        shift: Centres of the filled parts of all voxels [V,3].
    """
    weight = np.where(near >= 0, fraction[near], 0)
    share = weight / weight.sum(axis=1, keepdims=True)
    x = AROUND + shift[near]
    arm = x - share[:, None] @ x
    _, axes = np.linalg.eigh((arm * share[:, :, None]).swapaxes(1, 2) @ arm)
    across = axes[:, :, 0] * np.sign((axes[:, :, 0] * planes.normal).sum(axis=1))[:, None]
    normal = planes.normal + FASTER * (across - planes.normal)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    # A curved sheet is a paraboloid: its height grows in proportion to the squared distance.
    rise, level = (each @ normal[:, :, None] for each in (arm, x))
    rise, square = rise[:, :, 0], (x * x).sum(axis=2) - level[:, :, 0] ** 2
    away = square - (share * square).sum(axis=1)[:, None]
    bend = (share * away * rise).sum(axis=1) / np.maximum((share * away**2).sum(axis=1), 1e-9)
    total = weight[:, NEXT].sum(axis=1)
    share = weight[:, NEXT] / total[:, None]
    centre = (share[:, None] @ x[:, NEXT])[:, 0]
    height = (centre * normal).sum(axis=1)
    area = np.maximum(below(normal, height, 3, order=1), 1)
    thick = total / area
    nearer = np.clip(thick, 0, 2) ** 2 / 12 * below(normal, height, 3, order=2) / area
    height -= nearer + bend * (share * square[:, NEXT]).sum(axis=1)
    height = planes.height + FASTER * (height - planes.height)
    most = 2 * thick
    for _ in range(3):
        volume = np.maximum(between(normal, height, thick, 3), 1e-9)
        thick = np.minimum(thick * total / volume, most)
    along = centre - (centre * normal).sum(axis=1)[:, None] * normal
    inward = along / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    return Planes(normal, height, thick, inward)


def _steep_mean(values: NDArray) -> NDArray[np.float64]:
    """Return power means [K] of values [K,125]; they are close to the largest value of each row."""
    power = (values / np.maximum(values.max(axis=1, keepdims=True), 1e-30)) ** STEEP
    result: NDArray[np.float64] = (power * values).sum(axis=1) / np.maximum(power.sum(axis=1), 1)
    return result
