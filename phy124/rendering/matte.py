"""Lights matte, tinted grains such as sand and snow by a lamp and a sky.

A tinted substance has the same colour everywhere, so only light and shadow show its shape. The
light of the picture belongs to the object at rest; therefore, light is computed in each frame. The
normal of the surface is the direction in which phi, the smoothed fraction of space that the grains
fill, decreases most. Hollows receive less light, because the material around them hides the sky
(ambient occlusion).
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import SH_C0

SMOOTH = 1.4
"""Standard deviation of the filter that smooths phi for normals [cells]."""
WIDE = 3.0
"""Standard deviation of the wider filter that smooths phi for occlusion [cells]."""
SPARE = 6
"""Width of the empty margin of the grid around the grains [cells]."""
TAILS = 2.5
"""Distance at which both smoothing filters are cut off [standard deviations]."""
MOST = 2_000_000
"""Largest number of cells; for scattered grains, the cells are made larger."""
SKY = np.array([0.56, 0.59, 0.65], np.float32)
LAMP_LIGHT = np.array([0.50, 0.46, 0.37], np.float32)
"""Red, green and blue light from the sky, and from the lamp on surfaces that face the lamp."""
CERTAIN = 0.03
"""The normal is certain if the gradient of phi per cell is above this value. Below this value, the
light of the lamp tends to `EVEN`.
"""
EVEN = 0.8
"""Light of the lamp on grains with an uncertain normal, relative to its light on grains that face
the lamp.
"""
HOLLOW, DEEP = 0.48, 0.72
"""Phi after the wide filter: on a flat surface, and in a fully shaded hollow."""
DARKEST = 0.6
"""Light in a fully shaded hollow, relative to the light on a flat surface."""


class Matte:
    """The light on the grains of one material of a clip."""

    def __init__(self, which: NDArray[np.int64], volumes: NDArray, cell: float) -> None:
        self.which, self._volumes, self._cell = which, volumes, cell

    def light(self, x: NDArray, lamp: NDArray) -> NDArray[np.float32]:
        """Return the light at points x [n,3] m, as factors for red, green and blue [n,3].

        `lamp` [3] is the unit vector towards the lamp.
        """
        cell, place, size = locate(x, self._cell)
        low = np.floor(place)
        corner, nearest = number(low, size), number(np.rint(place), size)
        total = np.bincount(nearest, self._volumes, minlength=math.prod(size))
        steps = size[1] * size[2], size[2], 1
        # The light is computed only in the eight cells around each grain.
        around = np.zeros(len(total), bool)
        around[corner] = True
        for step in steps:
            around[step:] |= around[:-step]
        used = np.flatnonzero(around)
        phi = blur(np.minimum(total / cell**3, 1).reshape(size), SMOOTH)
        wide = blur(phi, WIDE).reshape(-1)[used]
        phi = phi.reshape(-1)
        slopes = [(phi[used + step] - phi[used - step]) / 2 for step in steps]
        steep = np.sqrt(sum(slope * slope for slope in slopes))
        along = sum(slope * part for slope, part in zip(slopes, lamp.tolist(), strict=True))
        facing = -along / np.maximum(steep, 1e-9)
        certain = np.minimum(steep / CERTAIN, 1)
        lit = EVEN + certain * (((1 + facing) / 2) ** 1.2 - EVEN)
        hidden = np.clip((wide - HOLLOW) / (DEEP - HOLLOW), 0, 1)
        # Without interpolation, the surface would show the cells as blocks.
        shares = (place - low).astype(np.float32)
        lit, hidden = (
            interpolate(values, used, len(total), corner, shares, steps) for values in (lit, hidden)
        )
        open_sky = 1 - (1 - DARKEST) * hidden
        channels = zip(SKY, LAMP_LIGHT, strict=True)
        return np.stack([(sky + bright * lit) * open_sky for sky, bright in channels], axis=1)


def find_matte(rows: Sequence[dict[str, Any]], cell: float) -> list[Matte]:
    """Return the matte materials of a clip from its report.

    Args:
        rows: For each material, the spans of its Gaussians (`runs`), and the volume of each
            Gaussian of a span (`volumes`), m^3.
        cell: Cell size of the simulation's grid, m.
    """
    matte = []
    for row in rows:
        counts = [last - first for first, last in row["runs"]]
        which = [np.arange(*run) for run in row["runs"]]
        if sum(counts) and cell > 0:
            matte.append(Matte(np.concatenate(which), np.repeat(row["volumes"], counts), cell))
    return matte


def illuminate(sh: NDArray, light: NDArray) -> NDArray:
    """Return spherical harmonics [n,K,3] of grains' colours `sh` under the light `light` [n,3]."""
    lit = np.zeros_like(sh)
    rgb = np.clip(0.5 + SH_C0 * sh[:, 0], 0, 1) * light
    lit[:, 0] = (np.minimum(rgb, 1) - 0.5) / SH_C0
    return lit


def locate(x: NDArray, cell: float) -> tuple[float, NDArray[np.float64], tuple[int, int, int]]:
    """Place points x [n,3] on a grid.

    Return the grid's cell size [m], the points' coordinates in cells [3,n], and the number of cells
    per axis. The centres of cells have integer coordinates. Points far away from all others are
    placed near the boundary. The outermost cells are empty.
    """
    low, high = np.percentile(x[:: 1 + len(x) // 8192], [0.1, 99.9], axis=0)
    cell = max(cell, float(np.prod(high - low + 2 * SPARE * cell) / MOST) ** (1 / 3))
    across, along, up = (np.ceil((high - low) / cell).astype(int) + 2 * SPARE).tolist()
    place = np.empty((3, len(x)))
    for row, coordinates, start, count in zip(place, x.T, low, (across, along, up), strict=True):
        np.clip((coordinates - start) / cell + SPARE, 1, count - 2.001, out=row)
    return cell, place, (across, along, up)


def number(place: NDArray[np.float64], size: tuple[int, int, int]) -> NDArray[np.intp]:
    """Return the indices [n] of grid cells from their integer coordinates along the axes [3,n]."""
    return ((place[0] * size[1] + place[1]) * size[2] + place[2]).astype(np.intp)


def interpolate(
    values: NDArray[np.float32],
    cells: NDArray[np.intp],
    count: int,
    corner: NDArray[np.intp],
    shares: NDArray[np.float32],
    steps: tuple[int, int, int],
) -> NDArray[np.float32]:
    """Interpolate values of cells linearly at n points, between the eight cells around each point.

    Args:
        values: Values of K of the cells [K].
        cells: Indices of these K cells [K].
        count: Number of all cells.
        corner: For each point, the index of the lowest of the eight cells [n].
        shares: Distance of the point from the centre of this cell along each axis [3,n], in cells.
        steps: Along each axis, the difference between the indices of neighbouring cells.
    """
    every = np.zeros(count, np.float32)
    every[cells] = values
    # Along each axis, the number of values is halved.
    offsets = [sum(offset) for offset in product(*((0, step) for step in steps))]
    ends = [every[offset:].take(corner) for offset in offsets]
    for share in shares:
        half = len(ends) // 2
        ends = [a + share * (b - a) for a, b in zip(ends[:half], ends[half:], strict=True)]
    return ends[0]


def blur(values: NDArray, sigma: float) -> NDArray[np.float32]:
    """Smooth values of cells with a Gaussian filter, whose standard deviation is in cells."""
    reach = np.arange(-round(TAILS * sigma), round(TAILS * sigma) + 1)
    weights = np.exp(-0.5 * (reach / sigma) ** 2)
    weights /= weights.sum()
    smooth = np.array(values, np.float32, order="C")
    # OpenCV filters along the rows and columns of pictures.
    rows = smooth.reshape(len(smooth), -1)
    cv2.sepFilter2D(rows, -1, np.ones(1), weights, rows, borderType=cv2.BORDER_REFLECT)
    for layer in smooth:
        cv2.sepFilter2D(layer, -1, weights, weights, layer, borderType=cv2.BORDER_REFLECT)
    return smooth
