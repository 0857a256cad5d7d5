"""Computes the shapes of a liquid's Gaussians: discs on the surface, balls where the liquid tears.

The fraction phi of space that the liquid fills is computed from the volumes of the Gaussians and
smoothed over `BLUR` cells. The liquid's surface is where phi = `LEVEL`. Gaussians near the surface
move onto it and become discs; Gaussians deep inside are not drawn; Gaussians in thin spray become
balls. Near flat walls, phi is the filled fraction of the space in front of the walls. The opacity
of a disc follows from the thickness of the liquid behind the disc (Beer-Lambert): each face of a
layer has half of the layer's optical depth, which overlapping discs share in proportion to their
volumes. Fast liquid in the air that is thinner than at rest becomes white foam.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import SH_C0, Gaussians
from phy124.kernels.splat import discs, fields
from phy124.kernels.splat.discs import BLUR, FINE, LEVEL

WHOLE = 0.945
"""The eight cells around a point and the filter spread the point on the grid. This is the standard
deviation of the spread [cells].
"""
MOST = 4_000_000
"""Largest number of cells; for a scattered liquid, the cells are made larger."""
SAMPLE = 8192
"""Number of a liquid's points from which the extent of the grid is determined."""
LITTLE = 0.02
"""Averages over the space in front of walls are divided by the fraction of this space, but by at
least this value.
"""
THICKER = 4.0
"""Largest factor by which volumes are increased where the liquid is thin at rest."""
CLEAR = 1e6
"""Optical depth of one grid cell of an opaque liquid."""


class Planes(NamedTuple):
    """The flat walls that a liquid may touch."""

    normals: NDArray
    """Unit normals that point out of the walls [W,3]."""
    offsets: NDArray
    """Distances of the walls from the origin along their normals [W], m."""


NOWHERE = Planes(np.zeros((0, 3)), np.zeros(0))


class Surface(NamedTuple):
    """The Gaussians of a liquid, shaped for rendering."""

    means: NDArray
    """Centres [N,3], m."""
    quats: NDArray
    """Orientations [N,4]. The z axis of a disc points out of the liquid."""
    scales: NDArray
    """Standard deviations [N,3], m."""
    opacities: NDArray
    """Opacities [N]. A Gaussian inside the liquid has the opacity 0."""
    rgb: NDArray
    """Colours without reflection [N,3]."""
    normals: NDArray
    """Outward unit normals of discs [N,3]; 0 for balls."""


WIDTHS = (3, 4, 3, 1, 3, 3)
"""Number of values per Gaussian in each array of a `Surface`, in the order of its fields."""


class Field:
    """A grid on which values of a liquid's points are added up and smoothed."""

    def __init__(self, x: NDArray, cell: float, planes: Planes = NOWHERE) -> None:
        """Place points [N,3] m on a grid with the spacing `cell` [m]; the spacing becomes wider if
        there would be more than `MOST` cells.
        """
        low, high = np.percentile(x[:: 1 + len(x) // SAMPLE], [0.1, 99.9], axis=0)
        spare = 4 * BLUR * cell
        extent = high - low + 2 * spare
        self.cell = cell = max(cell, float(np.prod(extent) / MOST) ** (1 / 3))
        self.size: Any = tuple(int(side) + 1 for side in np.ceil(extent / cell))
        self.x = np.ascontiguousarray(x, np.float32)
        corner = np.asarray(low - spare, np.float32)
        self.grid = fields.Grid()
        self.grid.corner, self.grid.cell = wp.vec3(*corner.tolist()), cell
        self.grid.size = wp.vec3i(*self.size)
        self.open, self._room = self._before(planes, corner)

    def _before(self, planes: Planes, corner: NDArray) -> tuple[NDArray | float, NDArray | float]:
        """Return the unsmoothed and the smoothed fraction of each cell in front of all walls.

        `corner` is the centre of the first cell [3], m.
        """
        shares: tuple[Any, Any] = 1.0, 1.0
        axes = [corner[a] + self.cell * np.arange(self.size[a]) for a in range(3)]
        for normal, offset in zip(*planes, strict=True):
            along = np.flatnonzero(normal)
            terms = np.ix_(*(normal[a] * axes[a] if a in along else np.zeros(1) for a in range(3)))
            away = ((terms[0] + terms[1] + terms[2] - offset) / self.cell).astype(np.float32)
            if away.min() < 3 * BLUR:
                part = np.clip(0.5 + away, 0, 1), scipy.special.ndtr(away / WHOLE)
                shares = shares[0] * part[0], shares[1] * part[1]
        return shares[0], np.maximum(shares[1], LITTLE)

    def blur(self, values: NDArray, width: float = BLUR) -> NDArray[np.float32]:
        """Smooth the values of the grid's cells with a Gaussian filter, and return them.

        `width` is the standard deviation of the filter [cells].
        """
        smooth: Any = scipy.ndimage.gaussian_filter(
            values.reshape(self.size), width, mode="constant", truncate=3
        )
        return smooth

    def smooth(self, values: NDArray) -> NDArray[np.float32]:
        """Smooth the values of the grid's cells; averages do not include space behind walls."""
        return np.asarray(self.blur(values) / self._room, np.float32)

    def fill(self, volumes: NDArray) -> NDArray[np.float32]:
        """Return phi, the smoothed fraction of each cell that the liquid's points fill.

        `volumes` [N] are the points' volumes [m^3]. The fraction is limited to 1, because the
        points of a compressed liquid lie too close together.
        """
        return self.smooth(np.minimum(self.add(volumes), 1))

    def add(self, volumes: NDArray) -> NDArray[np.float32]:
        """Return the unsmoothed fraction of each cell that points of `volumes` [N], m^3, fill."""
        filled = np.zeros(self.size, np.float32)
        self.launch(fields.fill, len(self.x), [self.x, volumes], [filled])
        return filled

    def sample(self, field: NDArray) -> NDArray[np.float32]:
        """Interpolate a field of the grid linearly at the liquid's points; return values [N]."""
        values = np.empty(len(self.x), np.float32)
        self.launch(fields.sample, len(self.x), [self.x, field], [values])
        return values

    def spread(self, phi: NDArray) -> NDArray[np.float32]:
        """Return the factor by which smoothing lowers phi, the filled fraction, in each cell.

        The factor is about 1/2 in jets and 0.7 in sheets.
        """
        return np.asarray(self.smooth(phi * self.open) / np.maximum(phi, 1e-6), np.float32)

    def slopes(self, phi: NDArray) -> NDArray[np.float32]:
        """Return the gradient of phi, the filled fraction, in each cell [cells,3], per cell."""
        slopes = np.empty((phi.size, 3), np.float32)
        self.launch(fields.differentiate, phi.size, [phi], [slopes])
        return slopes

    def lengths(self, filled: NDArray) -> NDArray[np.float32]:
        """Return the length of the liquid along each axis through each cell [cells,3], in cells."""
        lengths = np.empty((filled.size, 3), np.float32)
        for axis, count in enumerate(self.size):
            self.launch(discs.measure_lengths, filled.size // count, [axis, filled], [lengths])
        return lengths

    def launch(self, kernel: Any, count: int, inputs: list[Any], outputs: list[Any]) -> None:
        """Launch a kernel of `fields` or `discs` on the CPU.

        Args:
            kernel: The kernel, whose first argument is the grid.
            count: Number of threads.
            inputs: Other values and arrays of NumPy or Warp that the kernel reads.
            outputs: Arrays that the kernel writes.
        """
        inputs, outputs = (
            [_wrap(item) if isinstance(item, np.ndarray) else item for item in items]
            for items in (inputs, outputs)
        )
        wp.launch(kernel, count, [self.grid, *inputs], outputs, device="cpu")


def _wrap(array: NDArray) -> wp.array:
    if array.dtype.kind == "i":
        return wp.array(array, dtype=wp.int32, device="cpu", copy=False)
    kinds: dict[int, Any] = {3: wp.vec3, 4: wp.vec4}
    if array.ndim == 2:
        kind = kinds[array.shape[1]]
    else:
        kind, array = wp.float32, array.reshape(-1)
    return wp.array(np.asarray(array, np.float32), dtype=kind, device="cpu", copy=False)


class Liquid:
    """Computes the shapes of the Gaussians of one liquid of a clip."""

    def __init__(
        self,
        x: NDArray,
        cell: float,
        visibility: float | None,
        planes: Planes = NOWHERE,
        volumes: NDArray | None = None,
        calm: bool = False,
    ) -> None:
        """Measure the liquid at rest, whose Gaussians have their centres at x [N,3], m.

        `cell` is the cell size of the simulation's grid [m]. The liquid dims light to 1/e over the
        distance `visibility` [m]; None means opaque. Without volumes [N], m^3, equal volumes fill
        the liquid at rest. `calm` states that the liquid is very viscous; the gloss of such a
        liquid is smoothed, because it would show the rows of the particles.
        """
        self._cell, self._visibility, field = cell, visibility, Field(x, cell, planes)
        self._calm = calm
        if volumes is None:
            ones = np.full(len(x), field.cell**3)
            density = np.median(field.sample(field.smooth(field.add(ones))))
            volumes = np.full(len(x), field.cell**3 / max(float(density), 2.0))
        # Thin parts have few particles and would not be drawn without additional volume.
        here = np.maximum(field.sample(field.fill(volumes)), 1e-6)
        self._rows = _find_rows(x, float(np.cbrt(np.max(volumes))))
        self._volumes = (volumes * np.clip(LEVEL / here, 1, THICKER)).astype(np.float32)
        self._spread = field.sample(field.spread(field.fill(self._volumes)))

    def shape(
        self, part: Gaussians, planes: Planes = NOWHERE, speeds: NDArray | None = None
    ) -> Surface:
        """Return the liquid's Gaussians, shaped for rendering next to flat walls.

        Without the speeds of the Gaussians [N], m/s, the liquid has no foam.
        """
        field = Field(part.means, self._cell, planes)
        x, n = field.x, len(part)
        speeds = np.zeros(n) if speeds is None else speeds
        phi = field.fill(self._volumes)
        filled = np.asarray(phi * field.open, np.float32)
        walls = np.column_stack([planes.normals, planes.offsets]).astype(np.float32)
        per_cell = field.cell / self._visibility if self._visibility else CLEAR
        kind: Any = discs.Shape
        shapes = wp.empty(n, dtype=kind, device="cpu")
        sums: Any = np.zeros((2, *field.size), np.float32)
        slopes = field.slopes(phi)
        calm = field.slopes(field.blur(field.blur(phi))) if self._calm else slopes
        fields = [phi, filled, slopes, calm, field.spread(phi), field.lengths(filled)]
        largest = float(self._volumes.max())
        inputs = [walls, per_cell, x, self._volumes, largest, self._spread, speeds, *fields]
        field.launch(discs.find_surface, n, inputs, [shapes, *sums])
        rgb = np.clip(0.5 + SH_C0 * part.sh[:, 0], 0, 1)
        drawn = Surface(*(np.empty((n, k) if k > 1 else n, np.float32) for k in WIDTHS))
        inputs = [per_cell, x, self._volumes, largest, self._rows, rgb, shapes]
        inputs += [field.blur(values, FINE) for values in sums]
        field.launch(discs.shape_gaussians, n, inputs, [*drawn])
        return drawn


def _find_rows(x: NDArray, spacing: float) -> NDArray[np.int32]:
    """Return the indices of each point's two neighbours along each axis [3,2,N].

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
    return rows.astype(np.int32)


def smoothstep(x: NDArray, low: float, high: float) -> NDArray:
    """Return a smooth cubic step that rises from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
