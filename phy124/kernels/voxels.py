"""Fills partly filled voxels up to a surface, and finds the moments of the filled parts.

A voxel is filled below a plane or within a cylinder. It is divided into equal samples; a sample at
the surface counts as a fraction. A bisection finds the position of the surface from the filled
fraction of the voxel. The unit of length is a voxel.
"""

import warp as wp

from phy124.kernels.native import code, native_kernel

HALVINGS = 12
"""Number of bisection steps that find the position of the surface in a voxel."""
MOST = 1000
"""Largest number of samples into which a voxel is divided."""
AT_ONCE = 8
"""Number of voxels that a thread fills at a time."""


@native_kernel(
    "phy124_voxels",
    f"enum {{ HALVINGS = {HALVINGS}, MOST = {MOST} }};\n{code('voxels')}",
    seconds=0.3,
)
def fill_voxels(
    side: wp.float64,  # of a sample
    rods: bool,  # whether the surfaces are cylinders instead of planes
    samples: wp.array(dtype=wp.vec3d),  # middles of the samples, relative to the voxel's middle
    fractions: wp.array(dtype=wp.float64),
    middles: wp.array(dtype=wp.vec3d),  # a point of each plane or axis, as for the samples
    axes: wp.array(dtype=wp.vec3d),  # normals of the planes, or directions of the cylinders
    widths: wp.array(dtype=wp.float64),  # extents of the voxels across the surfaces
    # out: centres of the filled parts, and second moments about these centres, per volume
    centres_out: wp.array(dtype=wp.vec3d),
    spreads_out: wp.array(dtype=wp.mat33d),
):
    """Fill `AT_ONCE` voxels."""
