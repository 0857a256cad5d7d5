"""Many particles, few numbers: sums at the nodes of the grid, sums and maxima over all.

Atomic operations on one address queue on a GPU, so a thread first adds up its part by itself. To
nodes, from compute capability 9.0 on, a GPU adds four float32 in one transaction; older ones,
float64 and the CPU add component by component.
"""

from typing import Any

import warp as wp

EACH, MOST_THREADS = 32, 2**14
"""Particles that one thread of the CPU adds up, and threads of a GPU that share all."""


def shared_out(particles: int, device: str) -> tuple[int, int, int, int]:
    """Threads that make a sum or a maximum of all, and their shares: first, each, stride.

    A thread has the particles `thread * first + k * stride`, k < each. On the CPU they are
    neighbours; on a GPU those of neighbouring threads are, which read memory together.
    """
    if device == "cpu":
        return -(-particles // EACH), EACH, EACH, 1
    threads = min(particles, MOST_THREADS)
    return threads, 1, -(-particles // threads), threads


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


@wp.func
def finite(a: Any):
    """Whether a number is neither infinite nor NaN; on the CPU `wp.isfinite` is a call."""
    return a - a == type(a)(0.0)


@wp.func
def greater(a: Any, b: Any):
    """The greater of two numbers: `wp.max` would also ask whether they are."""
    return wp.where(b > a, b, a)


@wp.func
def raise_to(maxima: wp.array(dtype=Any), index: int, value: Any):
    """Raise a maximum. Asking first spares most of the atomic operations, which would queue."""
    if value > maxima[index]:
        wp.atomic_max(maxima, index, value)
