"""Reductions: sums at the nodes of the grid, and sums and maxima over all particles.

On a GPU, atomic operations on one address are serialised, so each thread first reduces its own
part. From compute capability 9.0 on, a GPU adds four float32 to a node in one transaction; older
ones, float64 and the CPU add component by component.
"""

from typing import Any

import warp as wp

EACH, MOST_THREADS = 32, 2**14
"""Number of particles per thread on the CPU, and largest number of threads on a GPU."""


def shared_out(particles: int, device: str) -> tuple[int, int, int, int]:
    """Number of threads that reduce all particles, and first, each and stride of their parts.

    A thread has the particles `thread * first + k * stride`, k < each. On the CPU these are
    neighbours; on a GPU those of neighbouring threads are, so that memory reads coalesce.
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
    """Whether a number is finite; on the CPU `wp.isfinite` is a function call and slower."""
    return a - a == type(a)(0.0)


@wp.func
def greater(a: Any, b: Any):
    """The larger of two numbers, without the check for NaN of `wp.max`."""
    return wp.where(b > a, b, a)


@wp.func
def raise_to(maxima: wp.array(dtype=Any), index: int, value: Any):
    """Raise a maximum. Comparing first avoids most of the atomic operations."""
    if value > maxima[index]:
        wp.atomic_max(maxima, index, value)
