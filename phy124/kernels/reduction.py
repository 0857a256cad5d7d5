"""The scatter of `transfer` for CUDA in float32: four sums in one memory transaction.

From compute capability 9.0 on a GPU adds a whole four-vector to global memory at once; older ones,
and the CPU, which the tests use, add its components.
"""

import warp as wp

from phy124.kernels.spline import offsets, spline

ADD = """
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
    :: "l"((float*)grid.data + 4 * (long long)node),
       "f"(value[0]), "f"(value[1]), "f"(value[2]), "f"(value[3]) : "memory");
#else
wp::atomic_add(grid, node, value);
#endif
"""


@wp.func_native(ADD)
def add(grid: wp.array(dtype=wp.vec4), node: int, value: wp.vec4):
    """Add a four-vector to a node."""
    ...


@wp.func
def scatter(
    grid: wp.array(dtype=wp.vec4), size: wp.vec3i, first: wp.vec3i, f: wp.vec3,
    base: wp.vec4, column_x: wp.vec4, column_y: wp.vec4, column_z: wp.vec4,
):  # fmt: skip
    """Add w (base + i X + j Y + k Z) to the 27 nodes around a particle."""
    wx = spline(f[0])
    wy = spline(f[1])
    wz = spline(f[2])
    step = offsets(f[0])
    for i in range(3):
        for j in range(3):
            w = wx[i] * wy[j]
            low = w * (base + step[i] * column_x + step[j] * column_y)
            rise = w * column_z
            n = ((first[0] + i) * size[1] + first[1] + j) * size[2] + first[2]
            add(grid, n, wz[0] * low)
            add(grid, n + 1, wz[1] * (low + rise))
            add(grid, n + 2, wz[2] * (low + rise + rise))
