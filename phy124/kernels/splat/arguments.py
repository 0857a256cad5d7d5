"""Declares the type and meaning of each argument of the kernels that draw Gaussians.

A kernel's signature states the types only of arguments that no other kernel uses. A written array
has the name of the read array, followed by `_out`.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints
from phy124.kernels.splat.glass import Outline, Solid
from phy124.kernels.splat.screen import Splat, View

_READ: dict[str, Any] = {
    "view": View,
    "background": wp.vec3,
    "columns": int,  # number of tiles per row
    "first": int,  # the first tile or solid that the launch handles
    "last": int,  # the tile or the solid after the last
    "room": int,  # number of entries for which the lists of all tiles have space
    "degree": int,  # degree of the spherical harmonics
    "before": int,  # number of glass solids in front of all Gaussians
    "solids": wp.array(dtype=Solid),
    "means": wp.array(dtype=wp.vec3),  # centres of the Gaussians [m]
    "quats": wp.array(dtype=wp.vec4),
    "scales": wp.array(dtype=wp.vec3),  # standard deviations [m]
    "opacities": wp.array(dtype=float),
    "sh": wp.array2d(dtype=wp.vec3),  # coefficients of the spherical harmonics
    "picture": wp.array(dtype=wp.vec3),  # pixels of the backdrop; empty if it has two colours
    "shade": wp.array2d(dtype=wp.uint16),  # fraction of the light that the shadow removes
    "values": wp.array(dtype=wp.vec3),  # values of the pixels
    "low": wp.vec3,  # lowest corner of a box around all Gaussians [m]
    "high": wp.vec3,  # highest corner of the box [m]
    "total": Ints,  # number of entries of all lists [1]
    "coverage": wp.array(dtype=float),  # alpha of the Gaussians at each pixel
}
_WRITTEN: dict[str, Any] = {
    "starts": Ints,  # first entry of each tile's list in `pairs`
    "ends": Ints,  # end of each tile's list
    "pairs": Ints,  # indices of splats, in the lists of all tiles
    "splats": wp.array(dtype=Splat),
    "tiles": wp.array(dtype=wp.vec4i),  # tiles of each splat (screen.py, `tiles_of`)
    "order": Ints,  # indices of the splats, sorted by depth
    "depths": wp.array(dtype=float),  # depths of the splats [m]
    "corners": wp.array2d(dtype=int),  # marks at the corners of each splat's tiles
    "counts": Ints,
    "outlines": wp.array(dtype=Outline),  # outlines of the solids
    "image": wp.array(dtype=wp.vec3),  # colour of each pixel
    "alpha": wp.array(dtype=float),  # alpha of each pixel
    "sums": wp.array(dtype=wp.vec3),
    "weights": wp.array(dtype=float),
    "ranks": Ints,  # for each entry of the tiles' lists, the splat's position in `order`
}
DRAWN = {**_READ, **_WRITTEN, **{f"{name}_out": kind for name, kind in _WRITTEN.items()}}
