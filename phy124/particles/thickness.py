"""Computes the proportions of an object that determine how well a grid resolves the object.

The local thickness at a point is the diameter of the largest ball that contains the point and lies
inside the object (Hildebrand and Ruegsegger 1997, Journal of Microscopy 185).

The compliance is the deflection that the object, as an upright beam, would have if its own weight
acted sideways (Euler and Bernoulli).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.solid import ACROSS, Solid

FRACTION = 0.1
"""Fraction of an object's volume that may be thinner than the reported thickness."""
FOOT = 0.12
"""Fraction of an object's height that is clamped, measured from the foot."""


class Proportions(NamedTuple):
    """Proportions of an object, independent of its size."""

    thickness: float
    """Local thickness that nine tenths of the volume exceed, relative to the longest side."""
    compliance: float
    """Mean deflection if the weight acts sideways, in units of L rho g L / E, where L is the
    object's size.
    """
    pieces: int = 1
    """Number of separate pieces of an object; the largest number if there are several objects."""

    @classmethod
    def of_report(cls, report: Mapping[str, Any]) -> Proportions | None:
        """Return the proportions in a report; None if they are missing."""
        thickness, compliance = report.get("thickness"), report.get("compliance")
        if thickness is None or compliance is None:
            return None
        return cls(thickness, compliance, report.get("pieces") or 1)


def measure_proportions(*objects: tuple[Solid, float]) -> Proportions:
    """Return the smallest thickness, the largest compliance and the largest number of separate
    pieces of upright objects.

    `objects` are pairs of interior (`find_interior`) and longest side [m]. The thickness is
    relative to the longest side of the first object.
    """
    shapes = [interior.resample(size / ACROSS) for interior, size in objects]
    pairs = zip(shapes, (size for _, size in objects), strict=True)
    softest = max(compliance(shape) / size for shape, size in pairs)
    thickness = min(local_thickness(shape) for shape in shapes) / objects[0][1]
    pieces = max(interior.islands(0.0).number for interior, _ in objects)
    return Proportions(thickness, softest, pieces)


@lru_cache(maxsize=4)
def compliance(shape: Solid) -> float:
    """Return the mean deflection of an upright object in its softest horizontal direction [m].

    The beam is loaded sideways by an acceleration `a` with `rho a / E = 1 / L`, where L is the
    object's longest side.
    """
    inside = _inside(shape)
    length, (_, _, height) = shape.voxel * max(inside.shape), inside.shape
    voxel = shape.voxel / length
    areas, moments = np.zeros(height), np.zeros(height)
    for layer in range(height):
        points = np.argwhere(inside[:, :, layer]) * voxel
        areas[layer] = len(points) * voxel**2
        if len(points):
            squares = ((points - points.mean(axis=0)) ** 2).sum(axis=0).min()
            moments[layer] = squares * voxel**2 + len(points) * voxel**4 / 12
    heights = voxel * np.arange(height)
    above = (heights[None] - heights[:, None]).clip(min=0)
    bending = above @ areas * voxel
    curvature = np.divide(bending, moments, out=np.zeros(height), where=moments > 0)
    curvature[: int(np.ceil(FOOT * height))] = 0
    deflection = np.cumsum(np.cumsum(curvature)) * voxel**2
    return float(length * np.sqrt(areas @ deflection**2 / areas.sum()))


def _inside(shape: Solid) -> NDArray[np.bool_]:
    inside = shape.fraction > 0.5 * min(1.0, shape.fraction.max())
    return inside[scipy.ndimage.find_objects(inside.astype(np.int8))[0]]


@lru_cache(maxsize=4)
def local_thickness(shape: Solid) -> float:
    """Return the local thickness [m] that only `FRACTION` of the object's volume does not reach; at
    least the side of a voxel.
    """
    # Removing the empty voxels around the solid halves the time to compute distances.
    inside = np.pad(_inside(shape), 1)
    depth = scipy.ndimage.distance_transform_edt(inside)
    radii = np.arange(1.0, depth.max() + 0.5, 0.5)
    fits, too_large = 0, len(radii)
    while too_large - fits > 1:
        middle = (fits + too_large) // 2
        core = depth >= radii[middle]
        opened = scipy.ndimage.distance_transform_edt(~core) < radii[middle]
        removed = 1 - np.count_nonzero(opened & inside) / np.count_nonzero(inside)
        fits, too_large = (middle, too_large) if removed <= FRACTION else (fits, middle)
    # The centres of the outermost voxels of a ball are half a voxel inside the ball.
    return float((2 * radii[fits] - 1) * shape.voxel)
