"""Shapes the Gaussians of a liquid into discs on the surface, and drops where the liquid tears.

Each Gaussian represents a volume of liquid. The fraction phi of space that the liquid fills is
computed from these volumes, smoothed over `BLUR` cells. The liquid's surface is where phi =
`LEVEL`. Gaussians near the surface move onto it and become discs. Gaussians deeper inside are not
drawn, and Gaussians in thin spray become balls. Near flat walls, phi is the filled fraction of the
space in front of the walls. Gaussians that are closer to a wall than to the free surface move onto
the wall. The opacity of a disc follows from the thickness of the liquid behind the disc
(Beer-Lambert). Each face of a layer has half of the layer's optical depth, divided by the number of
overlapping discs. A thin film on a wall has only one face.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import SH_C0, Gaussians

BLUR, WHOLE = 0.85, 0.945
"""Two standard deviations, in cells of the simulation's grid.

The first belongs to the smoothing filter. The second also includes the distribution of each point
to the eight cells around it.
"""
LEVEL = 0.45
"""Fraction of space that is filled with liquid at the liquid's surface."""
MOST = 4_000_000
"""Largest number of cells. If the liquid is too scattered for this number, the cells are larger."""
SAMPLE = 8192
"""Number of points that determine the extent of the grid."""
AHEAD, FILLED = 1.2, (0.22, 0.42)
"""Distance outwards from a disc, in cells, and two values of phi at this distance.

The disc begins to fade at the first value, and has vanished at the second value.
"""
STEEP = (0.2, 0.35)
"""Two values of the gradient of phi relative to phi, per cell.

Discs are invisible below the first value, and do not fade above the second value.
"""
MOVES = (-0.35, 0.9)
"""Largest displacements of a Gaussian onto the surface: inwards and outwards, in cells."""
OVERLAP, NARROW, BROAD, WIDEST, FLAT = 0.95, 0.4, 0.55, 0.7, 0.3
"""Sizes of discs: the radius relative to the distance between discs; the lower bound of the radius,
the lower bound for a film on a wall, and the upper bound, all in cells; the thickness relative to
the radius."""
EVEN, CLOSED = 0.3, 0.5
"""Both relative to the distance between rows of Gaussians, which a liquid that is stretched evenly
has: the largest distance of a Gaussian from the middle between its two neighbours, and the smallest
radius of discs."""
TOUCH, FILM, EDGE = 0.75, (1.5, 2.5), 0.5
"""All in cells: the largest distance from a wall at which Gaussians are drawn on the wall; two
thicknesses of a film on a wall, between which the film's face on the wall fades in; the smallest
depth below the free surface at which Gaussians are drawn on a wall."""
WETTED = 0.6
"""Smallest value of phi at which a liquid touches a wall."""
LONG = 3.0
"""Largest length of liquid along a line of sight, relative to the liquid's smallest thickness at
that point."""
RIM = 0.3
"""Length of the normals of discs at the rim of a liquid on a wall.

Short normals reduce the gloss, because these normals differ from disc to disc.
"""
LITTLE = 0.02
"""Lower bound of the fraction of space in front of walls, by which averages are divided."""
THICKER = 4.0
"""Largest factor by which the volumes of Gaussians are enlarged if they are in thin parts of the
liquid at rest."""
ALONE, DROP = 0.4, 0.42
"""Drops: the largest phi at a drop's centre, relative to the drop's volume in cells; the standard
deviation of a drop, relative to the edge of a cube of the same volume."""
TORN, THINNER, KEPT = 0.62, 0.85, 0.6
"""Jets: the largest spread of a jet, and the largest ratio of this spread to the spread at rest;
the fraction of a jet's Gaussians that are not drawn."""
OPAQUE, LEAST = 6.0, 0.35
"""Largest optical depth of a surface, and smallest opacity of a surface."""
PALE = np.array([0.9, 0.97, 1.0], np.float32)
"""Colour of thin liquid and of spray."""
THIN, SPRAY = 0.2, 0.6
"""Largest fractions of the pale colour: in a thin layer, and in a drop."""


class Planes(NamedTuple):
    """The flat walls that a liquid may touch."""

    normals: NDArray
    """Unit normals that point out of the walls [W,3]."""
    offsets: NDArray
    """Distances of the walls from the origin along their normals [W], m."""


NOWHERE = Planes(np.zeros((0, 3)), np.zeros(0))
"""Value for a liquid that has no walls."""


class Surface(NamedTuple):
    """The Gaussians of a liquid, shaped for rendering."""

    means: NDArray
    """Centres [N,3], m."""
    quats: NDArray
    """Orientations [N,4]. The z axis of a disc points outwards."""
    scales: NDArray
    """Standard deviations [N,3], m."""
    opacities: NDArray
    """Opacities [N]. The opacity is 0 for Gaussians inside the liquid."""
    rgb: NDArray
    """Colours without reflection [N,3]."""
    normals: NDArray
    """Unit normals of discs, pointing outwards [N,3]. The normal is 0 for balls."""


class Field:
    """A grid on which values of points are added up and smoothed."""

    def __init__(self, x: NDArray, cell: float, planes: Planes = NOWHERE) -> None:
        """Place points [N,3] m on a grid with spacing `cell` m, or more if there are too many
        cells.
        """
        low, high = np.percentile(x[:: 1 + len(x) // SAMPLE], [0.1, 99.9], axis=0)
        spare = 4 * BLUR * cell
        extent = high - low + 2 * spare
        self.cell = cell = max(cell, float(np.prod(extent) / MOST) ** (1 / 3))
        self._size: Any = tuple(int(side) + 1 for side in np.ceil(extent / cell))
        corner = np.asarray(low - spare, np.float32)
        self._at = np.ascontiguousarray(((x - corner) / np.float32(cell)).T)
        nearest = np.rint(self._at).astype(np.int32)
        inside = np.clip(nearest, 0, np.array(self._size, np.int32)[:, None] - 1)
        self._flat: Any = np.ravel_multi_index(tuple(inside), self._size)
        self._weights = self._weigh(self._at)
        self.gap, self.facing = _touch(x, planes, cell)
        self.open, self._room = self._before(planes, corner)

    def _before(self, planes: Planes, corner: NDArray) -> tuple[NDArray | float, NDArray | float]:
        """Return the fraction of each cell in front of all walls, before and after smoothing.

        Args:
            planes: The walls.
            corner: Centre of the first cell [3], m.
        """
        shares: tuple[Any, Any] = 1.0, 1.0
        axes = [corner[a] + self.cell * np.arange(self._size[a]) for a in range(3)]
        for normal, offset in zip(*planes, strict=True):
            along = np.flatnonzero(normal)
            terms = np.ix_(*(normal[a] * axes[a] if a in along else np.zeros(1) for a in range(3)))
            away = ((terms[0] + terms[1] + terms[2] - offset) / self.cell).astype(np.float32)
            if away.min() < 3 * BLUR:
                part = np.clip(0.5 + away, 0, 1), scipy.special.ndtr(away / WHOLE)
                shares = shares[0] * part[0], shares[1] * part[1]
        return shares[0], np.maximum(shares[1], LITTLE)

    def sum(self, values: NDArray | None, chosen: NDArray | slice = slice(None)) -> NDArray:
        """Return the sum of the values of chosen points in each cell.

        If there are no values, return the number of points in each cell.
        """
        cells = int(np.prod(self._size))
        return np.bincount(self._flat[chosen], values, minlength=cells).reshape(self._size)

    def blur(self, values: NDArray) -> NDArray[np.float32]:
        """Return the values of the cells after smoothing."""
        smooth: Any = scipy.ndimage.gaussian_filter(
            values.astype(np.float32), BLUR, mode="constant", truncate=3
        )
        return smooth

    def smooth(self, values: NDArray) -> NDArray[np.float32]:
        """Return smoothed values of the cells, averaged over the space in front of all walls."""
        return np.asarray(self.blur(values) / self._room, np.float32)

    def fill(self, volumes: NDArray) -> NDArray[np.float32]:
        """Return the smoothed fraction phi of each cell that points of volumes [N] m^3 fill.

        Each point is distributed among 8 cells. The fraction is at most 1, because points lie
        closer together where a liquid is compressed.
        """
        filled = self._weights.T @ (volumes / self.cell**3).astype(np.float32)
        return self.smooth(np.minimum(filled, 1).reshape(self._size))

    def nearest(self, field: NDArray, chosen: NDArray | slice = slice(None)) -> NDArray[np.float32]:
        """Return the values of a field in the cells that contain the chosen points."""
        return field.reshape(-1)[self._flat[chosen]]

    def sample(
        self, fields: NDArray, chosen: NDArray | None = None, away: NDArray | None = None
    ) -> NDArray[np.float32]:
        """Interpolate fields linearly at chosen points, or at positions `away` from these points.

        Args:
            fields: One field, or several fields of F values per cell.
            chosen: Indices of n points. None means all points.
            away: Distances of the positions from the points [3,n], in cells.

        Returns:
            The values [n] or [n,F].
        """
        weights = self._weights
        if away is not None:
            weights = self._weigh((self._at if chosen is None else self._at[:, chosen]) + away)
        elif chosen is not None:
            weights = weights[chosen]
        values = weights @ fields.reshape(weights.shape[1], -1)
        return values.reshape(-1, *fields.shape[3:])

    def _weigh(self, at: NDArray) -> Any:
        """Return a sparse matrix that interpolates linearly at positions [3,n], in cells.

        It has a row for each position and a column for each cell. Outside the grid, the values at
        the grid's boundary are used.
        """
        size = np.array(self._size, np.int32)[:, None]
        at = np.clip(at, 0, size - 1)
        first = np.minimum(at.astype(np.int32), size - 2)
        upper = (at - first).astype(np.float32)
        x, y, z = np.stack([1 - upper, upper], axis=1)
        shares = (x[:, None, None] * y[None, :, None] * z[None, None]).reshape(8, -1)
        corners = tuple(np.indices((2, 2, 2)).reshape(3, -1))
        steps = np.asarray(np.ravel_multi_index(corners, self._size), np.int32)
        flat = np.asarray(np.ravel_multi_index(tuple(first), self._size), np.int32)
        cells = (flat[:, None] + steps).ravel()
        rows = 8 * np.arange(len(flat) + 1, dtype=np.int32)
        shape = (len(flat), int(np.prod(self._size)))
        return scipy.sparse.csr_matrix((shares.T.ravel(), cells, rows), shape)


def _touch(x: NDArray, planes: Planes, cell: float) -> tuple[NDArray, NDArray]:
    """Return the distances of points [N,3] m from the nearest wall, in cells, and its normals."""
    gap, facing = np.full(len(x), np.inf, np.float32), np.zeros((len(x), 3), np.float32)
    for normal, offset in zip(*planes, strict=True):
        away = (x @ normal.astype(np.float32) - np.float32(offset)) / np.float32(cell)
        nearer = away < gap
        gap[nearer], facing[nearer] = away[nearer], normal
    return gap, facing


class Liquid:
    """Shapes the Gaussians of one liquid of a clip."""

    def __init__(
        self,
        x: NDArray,
        cell: float,
        visibility: float | None,
        planes: Planes = NOWHERE,
        volumes: NDArray | None = None,
    ) -> None:
        """Measure the liquid while it is at rest.

        Args:
            x: Centres of the liquid's Gaussians at rest [N,3], m.
            cell: Cell size of the simulation's grid, m.
            visibility: Distance over which the liquid dims light to 1/e, m. None means that the
                liquid is opaque.
            planes: Flat walls that the liquid may touch.
            volumes: Volumes of the liquid's Gaussians [N], m^3. None means equal volumes that fill
                the liquid at rest.
        """
        self._cell, self._visibility, field = cell, visibility, Field(x, cell, planes)
        if volumes is None:
            density = np.median(field.sample(field.smooth(field.sum(None))))
            volumes = np.full(len(x), field.cell**3 / max(float(density), 2.0))
        # Thin parts have few particles and would not be drawn without additional volume.
        here = np.maximum(field.sample(field.fill(volumes)), 1e-6)
        self._rows = _find_rows(x, float(np.cbrt(np.max(volumes))))
        self._volumes = volumes = volumes * np.clip(LEVEL / here, 1, THICKER)
        self._spread = _measure_spread(field, field.fill(volumes))

    def shape(self, part: Gaussians, planes: Planes = NOWHERE) -> Surface:
        """Return the liquid's Gaussians, shaped for rendering next to flat walls."""
        field = Field(part.means, self._cell, planes)
        phi = field.fill(self._volumes)
        spread = _measure_spread(field, phi)
        torn = (spread < TORN) & (spread < THINNER * self._spread) & (field.gap > TOUCH)
        apart = _measure_rows(part.means, self._rows) / field.cell
        return _shape(
            part, field, phi, self._volumes / field.cell**3, torn, apart, self._visibility
        )


def _find_rows(x: NDArray, spacing: float) -> NDArray[np.int64]:
    """Return the neighbours of points [N,3] m on both sides along each axis [3,2,N].

    If a point does not have both neighbours on a lattice of this spacing, its neighbours are the
    point itself.
    """
    tree, itself = scipy.spatial.KDTree(x, balanced_tree=False), np.arange(len(x))
    rows = np.empty((3, 2, len(x)), np.int64)
    for axis, step in enumerate(spacing * np.eye(3)):
        for side, away in enumerate((-step, step)):
            rows[axis, side] = tree.query(x + away, distance_upper_bound=spacing / 4)[1]
        alone = (rows[axis] == len(x)).any(axis=0)
        rows[axis] = np.where(alone, itself, rows[axis])
    return rows


def _measure_rows(x: NDArray, rows: NDArray) -> NDArray[np.float32]:
    """Return the largest distance from points [N,3] to their neighbours in `rows` [N], m.

    Neighbours count only while the point is still between them, so that the liquid has been
    stretched evenly there.
    """
    apart = np.zeros(len(x), np.float32)
    for pair in rows:
        before, after = x[pair]
        along = _lengths(after - before) / 2
        even = _lengths((after + before) / 2 - x) < EVEN * along
        apart = np.maximum(apart, np.where(even, along, 0))
    return apart


def _measure_spread(field: Field, phi: NDArray) -> NDArray[np.float32]:
    """Return the factor by which smoothing lowers phi at points [N].

    The factor is about 1/2 in jets and 0.7 in sheets.
    """
    return field.nearest(field.smooth(phi * field.open) / np.maximum(phi, 1e-6))


def _shape(
    part: Gaussians,
    field: Field,
    phi: NDArray,
    volumes: NDArray,
    torn: NDArray,
    apart: NDArray,
    visibility: float | None,
) -> Surface:
    """Return a liquid's Gaussians, shaped for rendering.

    Args:
        part: The liquid's Gaussians.
        field: The grid that contains the centres of the liquid's Gaussians.
        phi: Fraction of the space in each cell that the liquid fills, smoothed.
        volumes: Volumes of the Gaussians [N], in cells.
        torn: Mask of the Gaussians in jets. Some of these Gaussians are drawn as drops, and the
            others are not drawn.
        apart: Distances between neighbouring rows of Gaussians [N], in cells.
        visibility: Distance over which the liquid dims light to 1/e, m. None means that the liquid
            is opaque.
    """
    x, n, cell = part.means, len(part), field.cell
    here = field.sample(phi)
    close = field.gap < TOUCH
    near = np.flatnonzero((here < 0.98) | close)
    inside = phi * field.open
    gradient = np.zeros((n, 3), np.float32)
    gradient[near] = field.sample(np.stack(list(np.gradient(phi)), axis=-1), near)
    steep = _lengths(gradient)
    normals = -gradient / np.maximum(steep, 1e-9)[:, None]
    ahead = here.copy()
    ahead[near] = field.sample(inside, near, AHEAD * normals[near].T)
    depth = AHEAD * (here - LEVEL) / np.maximum(here - ahead, 1e-6)
    upright = np.einsum("ni,ni->n", normals, field.facing)
    # The fraction of the face on the wall that is drawn. Sheets in the air have two faces.
    lower = np.where(upright > 0.5, smoothstep(field.gap + depth, *FILM), 1)
    thin = close & (lower == 0)
    rim = (field.gap + depth < FILM[0]) & (upright < 0.9)
    wet = _touches(field, phi, close) & ~thin & (depth > np.maximum(field.gap, EDGE))
    normals[wet], steep[wet], ahead[wet] = -field.facing[wet], here[wet], 0
    chance = 0.618034 * np.arange(n) % 1
    alone = (here < ALONE * volumes) | (torn & (chance > KEPT))
    fade = np.where(alone | torn, 0, 1 - smoothstep(ahead, *FILLED))
    fade *= smoothstep(steep / np.maximum(here, 1e-6), *STEEP) * np.where(wet, lower, 1)
    free = alone | (~torn & ~thin & (fade < 0.5) & (here < LEVEL))
    on, loose = np.flatnonzero((fade > 0) & ~free), np.flatnonzero(free)

    means, scales, opacities = x.copy(), np.full((n, 3), 0.1 * cell), np.zeros(n)
    depth = np.where(wet, field.gap, np.maximum(depth.clip(*MOVES), -field.gap))[on]
    means[on] += normals[on] * (depth * cell)[:, None]
    # The number of discs per cell of the surface. Smoothing lowers the value of a layer to the peak
    # of the filter's Gaussian.
    around = field.sample(field.blur(field.sum(fade[on], on)), on)
    layer = around * np.sqrt(2 * np.pi) * BLUR
    narrow = np.clip(CLOSED * apart[on], BROAD + lower[on] * (NARROW - BROAD), WIDEST)
    radius = np.clip(OVERLAP / np.sqrt(np.maximum(layer, 1e-6)), narrow, WIDEST)
    scales[on] = (radius * cell)[:, None] * np.array([1, 1, FLAT])
    per_cell = cell / visibility if visibility else np.inf
    faces = 1 + lower[on]
    tau = np.minimum(_thickness(inside, field, on, normals[on]) * per_cell / faces, OPAQUE)
    # Without averaging over neighbouring discs, stretched rows of particles would appear as
    # stripes.
    tau = field.sample(field.blur(field.sum(fade[on] * tau, on)), on) / np.maximum(around, 1e-6)
    overlapping = np.maximum(2 * np.pi * radius**2 * layer, 0.5)
    opacities[on] = fade[on] * -np.expm1(-np.maximum(tau, -np.log1p(-LEAST)) / overlapping)
    drop = alone[loose]
    size, opacities[loose] = _balls(volumes[loose], here[loose], drop, chance[loose], per_cell)
    scales[loose] = (size * cell)[:, None]
    normals[free | (fade == 0)] = 0

    pale = np.zeros(n, np.float32)
    pale[on], pale[loose] = THIN * np.exp(-2 * tau), SPRAY * np.where(drop, 1, 0.5)
    rgb = np.clip(0.5 + SH_C0 * part.sh[:, 0], 0, 1)
    rgb = rgb + pale[:, None] * (PALE - rgb)
    quats = np.where(normals.any(axis=1, keepdims=True), _rotations(normals), (1, 0, 0, 0))
    normals[rim & ~wet] *= RIM
    arrays = (means, quats, scales, opacities, rgb, normals)
    return Surface(*(array.astype(np.float32) for array in arrays))


def _balls(
    volumes: NDArray, phi: NDArray, drop: NDArray, chance: NDArray, per_cell: float
) -> tuple[NDArray, NDArray]:
    """Return standard deviations [n], in cells, and opacities [n] of drops and of balls in spray.

    In dense spray, balls overlap. The overlapping balls absorb as much light as their volume of
    liquid.
    """
    apart = np.cbrt(volumes / np.maximum(phi, 1e-3))
    uneven = 0.6 + 0.8 * chance**3
    size = np.where(drop, DROP * np.cbrt(volumes) * uneven, np.minimum(0.6 * apart, WIDEST))
    column = np.minimum(volumes / (2 * np.pi * size**2) * per_cell, OPAQUE)
    return size, np.where(drop, 0.9, np.maximum(-np.expm1(-column), LEAST / 2))


def _touches(field: Field, phi: NDArray, close: NDArray) -> NDArray[np.bool_]:
    """Return a mask over `close` (points near a wall): where the liquid touches the wall."""
    mask, which = close.copy(), np.flatnonzero(close)
    onto = -field.gap[which] * field.facing[which].T
    mask[which] = field.sample(phi, which, onto) > WETTED
    return mask


def _thickness(phi: NDArray, field: Field, on: NDArray, normals: NDArray) -> NDArray:
    """Return the thickness of the liquid along the normals [n,3] of points `on`, in cells.

    The thickness is interpolated between the lengths of the liquid along the three axes. It is
    limited, so that the edge of a film is as pale as the rest of the film.
    """
    sums, least = np.zeros(len(on)), np.full(len(on), np.inf)
    for axis in range(3):
        layers = np.moveaxis(np.minimum(phi, 1), axis, 0)
        forth, back, wet = np.zeros_like(layers), np.zeros_like(layers), layers > 0.03
        for k in range(1, len(layers)):
            forth[k] = (forth[k - 1] + layers[k]) * wet[k]
            back[-1 - k] = (back[-k] + layers[-1 - k]) * wet[-1 - k]
        length = field.nearest(np.moveaxis(forth + back - layers, 0, axis), on)
        length = np.maximum(length, 0.1)
        sums += normals[:, axis] ** 2 / length
        least = np.minimum(least, length)
    return np.minimum(1 / np.maximum(sums, 1e-6), LONG * least)


def _rotations(normals: NDArray) -> NDArray:
    """Return the shortest rotations [N,4] from the z axis to normals; for -z, rotate about x."""
    x, y, z = normals.T
    quats = np.stack([1 + z, np.where(z > -0.9999, -y, 1), x, 0 * z], axis=1)
    return quats / _lengths(quats)[:, None]


def _lengths(vectors: NDArray) -> NDArray:
    """Return the lengths of vectors [N,D]."""
    # NumPy's norm is several times slower for many short vectors.
    return np.sqrt(np.einsum("ni,ni->n", vectors, vectors))


def smoothstep(x: NDArray, low: float, high: float) -> NDArray:
    """Return a smooth cubic step that rises from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
