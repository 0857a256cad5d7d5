"""Reads items of contiguous arrays.

Warp reads the stride of an array from memory, because arrays may have gaps. `item` uses the size of
the type instead, so kernels that read neighbouring cells take up to a quarter less time.
"""

import warp as wp

PLAIN = wp.int32, wp.float32, wp.float64
VECTORS = (wp.vec2, wp.vec3, wp.vec4, wp.vec2d, wp.vec3d, wp.vec4d)


for kind in (*PLAIN, *VECTORS, *(wp.types.vector(8, real) for real in (wp.float32, wp.float64))):

    @wp.func_native("return values.data[n];")
    def item(values: wp.array(dtype=kind), n: int) -> kind:
        """Return item n of a contiguous array."""
        ...
