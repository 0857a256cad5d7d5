"""Reductions: sums at the nodes of the grid, and sums and maxima over all particles.

On a GPU, atomic operations on one address are serialised, so each thread first reduces its own
part, and then the 32 threads of a warp theirs: one of them writes for all. Where some of a warp
are elsewhere (at the end of a launch, or in another branch), each writes for itself. From compute
capability 9.0 on, a GPU adds four float32 to a node in one transaction; older ones, float64 and
the CPU add component by component.
"""

from collections.abc import Iterable
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


def along_rows(extent: Iterable[int], device: str) -> tuple[tuple[int, int, int], int]:
    """Threads (i, j, part) over a box of nodes, and how many nodes of row (i, j) each has.

    On the CPU that is the whole row, on a GPU one node.
    """
    x, y, z = (int(count) for count in extent)
    return ((x, y, min(z, 1)), z) if device == "cpu" else ((x, y, z), 1)


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


LOAD = """
#if defined(__CUDA_ARCH__)
const float4 q = *(const float4*)((const float*)grid.data + 4 * (long long)node);
return wp::vec_t<4, float>(q.x, q.y, q.z, q.w);
#else
return wp::index(grid, node);
#endif
"""


@wp.func_native(LOAD)
def load(grid: wp.array(dtype=wp.vec4), node: int) -> wp.vec4:
    """A node; a GPU reads its four numbers at once, which Warp's alignment of 4 bytes forbids."""
    ...


@wp.func_native("return wp::index(grid, node);")
def load(grid: wp.array(dtype=wp.vec4d), node: int) -> wp.vec4d:  # noqa: F811
    """A node in float64."""
    ...


def by_warp(combine: str, write: str) -> str:
    """Native code that combines `value` over a warp before one thread of it writes."""
    return f"""
auto whole = value;
#if defined(__CUDA_ARCH__)
if (__activemask() == 0xffffffffu) {{
    for (int step = 16; step > 0; step >>= 1) {{
        const auto other = __shfl_xor_sync(0xffffffffu, whole, step);
        whole = {combine};
    }}
    if ((threadIdx.x & 31) != 0) return;
}}
#endif
{write}
"""


SUM = by_warp("whole + other", "if (whole != 0.0) wp::atomic_add(sums, index, whole);")
# Comparing first avoids most of the atomic operations.
RAISE = by_warp(
    "other > whole ? other : whole",
    "if (whole > wp::index(maxima, index)) wp::atomic_max(maxima, index, whole);",
)


LOWER = by_warp(
    "other < whole ? other : whole",
    "if (whole < wp::index(minima, index)) wp::atomic_min(minima, index, whole);",
)


@wp.func_native(SUM)
def add_to(sums: wp.array(dtype=wp.float64), index: int, value: wp.float64):
    """Add to a sum over all threads."""
    ...


@wp.func_native(RAISE)
def raise_to(maxima: wp.array(dtype=wp.float32), index: int, value: wp.float32):
    """Raise a maximum over all threads."""
    ...


@wp.func_native(RAISE)
def raise_to(maxima: wp.array(dtype=wp.float64), index: int, value: wp.float64):  # noqa: F811
    """Raise a maximum over all threads in float64."""
    ...


@wp.func_native(RAISE)
def raise_to(maxima: wp.array(dtype=int), index: int, value: int):  # noqa: F811
    """Raise a maximum over all threads of integers."""
    ...


@wp.func_native(LOWER)
def lower_to(minima: wp.array(dtype=int), index: int, value: int):
    """Lower a minimum over all threads of integers."""
    ...
