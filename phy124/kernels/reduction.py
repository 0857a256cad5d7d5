"""Adding a four-vector to a node of the grid, which many particles do at once.

From compute capability 9.0 on a GPU adds four float32 to global memory in one transaction; older
ones, float64 and the CPU add component by component.
"""

import warp as wp

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
    """Add to a node in float32."""
    ...


@wp.func_native("wp::atomic_add(grid, node, value);")
def add(grid: wp.array(dtype=wp.vec4d), node: int, value: wp.vec4d):  # noqa: F811
    """Add to a node in float64."""
    ...
