"""Writes the surface of Gaussians as a watertight triangle mesh with colours.

The surface consists of the points at which the density of the Gaussians is 1/2. The density is the
sum of opacity * exp(-d^2 / 2), where d is the Mahalanobis distance. The density is sampled on a
grid with `CELLS` cells along the longest side. Gaussians thinner than `BLUR` cells are widened to
this thickness, because a grid cannot resolve thinner Gaussians. The surface differs by at most one
cell from the surface on a grid that is four times as fine. Enclosed cavities are filled, even if
small gaps between Gaussians connect them to the outside. The triangles are computed by marching
cubes (Lewiner et al. 2003, in scikit-image). A vertex has the mean colour of the Gaussians nearest
to it.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians, rotation_matrices
from phy124.runtime.installation import install_command

CELLS = 80
LEVEL = 0.5
GAP = 0.05
"""Largest density outside the object; in gaps between wide Gaussians, the density is larger."""
BLUR = 0.3
"""Smallest standard deviation of a Gaussian, in units of cells; thinner Gaussians are widened."""
REACH = 2.5
"""Distance beyond which a Gaussian's density is neglected [standard deviations]."""
WIDEST = 12
"""Largest distance along each axis at which a Gaussian adds to the density [cells]."""
NEAREST = 4
"""Number of nearest Gaussians whose mean colour is the colour of a vertex."""
TINT = "tint"
"""Attribute of the vertices of a mesh [N,3]: linear colours, 0..1, that multiply its material."""
BATCH = 4_000_000


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh with colours."""

    vertices: NDArray[np.float64]
    """Positions [V,3], m."""
    faces: NDArray[np.int64]
    """Vertex indices of each triangle [F,3], anticlockwise if seen from outside."""
    rgb: NDArray[np.float64]
    """Colours of the vertices [V,3], 0..1."""
    cell: float
    """Edge length of a cell of the grid [m]."""


def find_surface(gaussians: Gaussians, cells: int = CELLS, blur: float = BLUR) -> Surface:
    """Return the surface at which the density of Gaussians is 1/2.

    The grid has `cells` cells along the object's longest side. Gaussians with a standard deviation
    below `blur` cells are widened.

    Raises:
        InputError: scikit-image is not installed, or the density is below 1/2 everywhere.
    """
    if find_spec("skimage") is None or find_spec("trimesh") is None:
        limit = "A mesh needs the packages scikit-image and trimesh, which are not installed."
        raise InputError("to", "mesh", limit, f"Run `{install_command('mesh')}`.")
    from skimage.measure import marching_cubes

    finite: Any = np.isfinite(gaussians.means).all(axis=1)
    gaussians = gaussians.select(finite)
    low, high = gaussians.means.min(axis=0), gaussians.means.max(axis=0)
    cell = max(float((high - low).max()), 1e-6) / cells
    density, corner = sample_density(gaussians, cell, blur)
    _fill_cavities(density)
    if not density.max() > LEVEL:
        limit = f"The density of its Gaussians is below {LEVEL} everywhere."
        raise InputError("clip", "faint", limit, "Give a clip of a visible object.")
    vertices, faces, _, _ = marching_cubes(density, LEVEL, allow_degenerate=False)
    points = corner + cell * vertices.astype(np.float64)
    # scikit-image orders the vertices of triangles clockwise if the density decreases outwards.
    return Surface(points, faces[:, ::-1].astype(np.int64), _colours(gaussians, points), cell)


def sample_density(
    gaussians: Gaussians, cell: float, blur: float = BLUR
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return the density of Gaussians at the nodes of a grid [X,Y,Z], and the first node [3], m.

    The outermost two layers of nodes are zero. Nodes are `cell` apart [m]. Gaussians with a
    standard deviation below `blur` cells are widened.
    """
    turns = rotation_matrices(gaussians.quats)
    spread = np.maximum(gaussians.scales / cell, blur)
    covariance = np.einsum("nij,nj,nkj->nik", turns, spread**2, turns)
    inverse = np.einsum("nij,nj,nkj->nik", turns, 1 / spread**2, turns)
    reach = np.ceil(REACH * np.sqrt(covariance[:, [0, 1, 2], [0, 1, 2]])).astype(np.int64)
    reach = np.clip(reach, 1, WIDEST)
    margin = int(reach.max()) + 3
    first = np.floor(gaussians.means.min(axis=0) / cell).astype(np.int64) - margin
    at = gaussians.means / cell - first
    shape = np.ceil(at.max(axis=0)).astype(np.int64) + margin + 1
    density = np.zeros(int(shape.prod()), np.float64)
    nearest = np.rint(at).astype(np.int64)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    for window in np.unique(reach, axis=0):
        chosen = np.flatnonzero((reach == window).all(axis=1))
        offsets = np.stack(
            np.meshgrid(*(np.arange(-r, r + 1) for r in window), indexing="ij"), axis=-1
        ).reshape(-1, 3)
        step = max(BATCH // len(offsets), 1)
        for part in np.split(chosen, range(step, len(chosen), step)):
            values = _evaluate(inverse[part], at[part] - nearest[part], offsets)
            values *= gaussians.opacities[part, None]
            nodes = (nearest[part] @ strides)[:, None] + offsets @ strides
            density += np.bincount(nodes.ravel(), values.ravel(), len(density))
    return density.reshape(shape).astype(np.float32), first * cell


def _evaluate(inverse: NDArray, shift: NDArray, offsets: NDArray) -> NDArray[np.float32]:
    """Return exp(-d^2 / 2) of each Gaussian at the K nodes around its centre [N,K].

    The centres `shift` [N,3] and the nodes `offsets` [K,3] are relative to the nearest node, in
    units of cells.
    """
    pulled = np.einsum("nij,nj->ni", inverse, shift)
    i, j = np.triu_indices(3)
    twice = np.where(i == j, 1.0, 2.0)
    constant = np.einsum("ni,ni->n", pulled, shift)
    rows = np.concatenate([inverse[:, i, j] * twice, -2 * pulled, constant[:, None]], axis=1)
    columns = np.concatenate(
        [offsets[:, i] * offsets[:, j], offsets, np.ones((len(offsets), 1))], axis=1
    )
    exponent = rows.astype(np.float32) @ columns.astype(np.float32).T
    exponent *= -0.5
    return np.exp(exponent, out=exponent)


def _fill_cavities(density: NDArray[np.float32]) -> None:
    """Fill enclosed cavities, even if small gaps between Gaussians connect them to the outside."""
    from scipy import ndimage

    for level in (LEVEL, GAP):
        labels: Any = ndimage.label(density <= level)
        regions = labels[0]
        outside = regions == regions[0, 0, 0]
        cavity = (regions > 0) & ~outside
        if cavity.any():
            away, out = (ndimage.distance_transform_edt(~mask) for mask in (cavity, outside))
            density[(density <= LEVEL) & (np.asarray(away) < np.asarray(out))] = 2 * LEVEL


def _colours(gaussians: Gaussians, points: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial import KDTree

    gaussians = gaussians.select(gaussians.opacities > 0)
    count = min(NEAREST, len(gaussians))
    distance, index = KDTree(gaussians.means).query(points, count)
    distance, index = distance.reshape(-1, count), index.reshape(-1, count)
    weights = gaussians.opacities[index] / (distance + 1e-9)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("vk,vkc->vc", weights, gaussians.rgb[index]).clip(0, 1)


def to_linear(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert sRGB colours to linear colours, both 0..1."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def to_srgb(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert linear colours to sRGB colours, both 0..1."""
    return np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)


def to_trimesh(surface: Surface, *, linear: bool = False) -> Any:
    """Return a surface as a mesh of trimesh; glTF needs `linear` colours instead of sRGB."""
    import trimesh

    rgb = to_linear(surface.rgb) if linear else surface.rgb
    rgba = np.concatenate([rgb, np.ones((len(rgb), 1))], axis=1)
    return trimesh.Trimesh(
        surface.vertices,
        surface.faces,
        vertex_colors=np.rint(255 * rgba).astype(np.uint8),
        process=False,
    )


def encode(gaussians: Gaussians, *, antialiased: bool = False, kind: str = "glb") -> bytes:
    """Return the surface of Gaussians as the bytes of a file: glb, obj or ply.

    A mesh has no property for `antialiased`.

    Raises:
        InputError: For the reasons listed at `find_surface`.
    """
    data = to_trimesh(find_surface(gaussians), linear=kind == "glb").export(file_type=kind)
    return data.encode() if isinstance(data, str) else data
