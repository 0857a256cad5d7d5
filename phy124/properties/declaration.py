"""The section `[properties]` of a scene, and the evaluation of its values at the particles."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from phy124.errors import InputError
from phy124.io.axes import orientation
from phy124.properties.table import Table, read_table
from phy124.schema.bounds import FileName
from phy124.schema.section import Section

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
ALIKE = 0.2
"""Largest difference between corresponding sides of the bounding boxes of the points and of the
object, as a fraction of the longest side.
"""
SAME = 0.99
"""Least covariance of corresponding positions, relative to that of equal positions."""


class Properties(Section):
    """Material properties of each point of the object (such as E or its fraction), from a file."""

    file: FileName = Field(examples=["materials.npz"])
    """A .ply file with points and columns, a .npz file with arrays per Gaussian, point or voxel, or
    a .npy file with a fraction of E per Gaussian.
    """
    sampling: Literal["nearest", "trilinear"] = "nearest"
    """Interpolation between points; trilinear interpolation needs voxels."""
    up: Axis = "z"
    """Axis of the file's coordinates that points up."""
    front: Axis | None = None
    """Axis of the file's coordinates towards which the object faces. Default: as for a .ply file
    with the same up axis.
    """

    def laws(self) -> frozenset[str]:
        """Return the names of the laws in the file.

        Raises:
            InputError: If the file cannot be read.
        """
        return frozenset(read_table(self.file).columns.get("law", ()))

    def columns(
        self,
        x: NDArray,
        means: NDArray,
        survivors: NDArray[np.bool_] | None,
        is_object: NDArray[np.bool_] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return the values of the file's columns (names in `EVERY`) at each particle [P].

        Args:
            x: Particles at rest [P,3], m.
            means: Centres of all Gaussians at rest [N,3], m.
            survivors: Mask of the Gaussians before cleaning that cleaning kept; None: all were
                kept.
            is_object: Mask [N] of the Gaussians of the object, without surroundings; None: all.

        Raises:
            InputError: If the file cannot be read or does not fit the object.
        """
        # Imported here, because importing SciPy takes longer than reading most scenes.
        from phy124.properties.sampling import nearest, trilinear

        table = read_table(self.file)
        count = len(means) if survivors is None else len(survivors)
        if len(table) == count and survivors is not None and not survivors.all():
            if _in_order(table.points, means, survivors):
                values = {name: column[survivors] for name, column in table.columns.items()}
                return nearest(x, means, values)
        elif (
            len(table) == len(means)
            and self.sampling == "nearest"
            and _in_order(table.points, means)
        ):
            return nearest(x, means, table.columns)
        means = means if is_object is None else means[is_object]
        if table.points is None and len(table) == len(means):
            return nearest(x, means, table.columns)
        points = self._fit_points(table, means)
        if self.sampling == "nearest":
            return nearest(x, points, table.columns)
        return trilinear(x, points, table.columns)

    def _fit_points(self, table: Table, means: NDArray) -> NDArray[np.float64]:
        if table.points is None:
            raise InputError(
                "properties.file",
                self.file,
                f"it holds {len(table):,} values without positions, but "
                f"the object has {len(means):,} "
                "Gaussians.",
                "Add x, y, z to the file, or write one value for each Gaussian in the file "
                "gaussians.ply of a run.",
            )
        turned = orientation(self.up, self.front).T
        points = table.points @ turned
        low, high = points.min(axis=0), points.max(axis=0)
        first, last = means.min(axis=0).astype(np.float64), means.max(axis=0).astype(np.float64)
        if table.whole:
            points = points - np.minimum(np.ones(3) @ turned, 0)
            return first + points * (last - first)
        longest = (last - first).max()
        scale = longest / max((high - low).max(), 1e-12)
        if np.abs(scale * (high - low) - (last - first)).max() > ALIKE * longest:
            raise InputError(
                "properties.file",
                self.file,
                f"its points fill a box of {_sides(scale * (high - low))} m, but the "
                f"object fills a box of {_sides(last - first)} m.",
                "Set properties.up and properties.front to the axes of the file.",
            )
        return (points - (low + high) / 2) * scale + (first + last) / 2


def _sides(sides: NDArray) -> str:
    return " x ".join(f"{side:.2g}" for side in sides)


def _in_order(
    points: NDArray | None, means: NDArray, kept: NDArray[np.bool_] | slice = slice(None)
) -> bool:
    """Return whether each row of a file belongs to the Gaussian with the same index.

    The result is True for rows without positions. For rows with positions, it is True if a
    rotation, a scale and a displacement map the positions `points[kept]` [N,3] to the centres
    `means` [N,3], m.
    """
    if points is None:
        return True
    a, b = (p - p.mean(axis=0) for p in (points[kept].astype(np.float64), means.astype(np.float64)))
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    if not np.isfinite(size):
        return True
    # Umeyama 1991: the sum of the singular values is the largest covariance of any rotation.
    return float(np.linalg.svd(a.T @ b, compute_uv=False).sum()) >= SAME * size
