"""What many threads do together: sums, maxima, stores, and a barrier.

On a GPU, atomic operations on one address are serialised, so each thread first reduces its own
part, and then the 32 threads of a warp theirs: one of them writes for all. Where some of a warp
are elsewhere (at the end of a launch, or in another branch), each writes for itself. From compute
capability 9.0 on, a GPU adds four float32 to a node in one transaction; older ones, float64 and
the CPU add component by component.

At the barrier CPU threads that run kernels in parallel wait for each other. They spin inside a
kernel, where Warp has released Python's global lock, for tens of microseconds; the caller yields
the core before it tries again.
"""

from collections.abc import Iterable
from typing import Any

import warp as wp

from phy124.kernels.native import code, native_kernel

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


@wp.func_native(code("reduction:add"))
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


@wp.func_native(code("reduction:load"))
def load(grid: wp.array(dtype=wp.vec4), node: int) -> wp.vec4:
    """A node; a GPU reads its four numbers at once, which Warp's alignment of 4 bytes forbids."""
    ...


@wp.func_native("return wp::index(grid, node);")
def load(grid: wp.array(dtype=wp.vec4d), node: int) -> wp.vec4d:  # noqa: F811
    """A node in float64."""
    ...


@wp.func_native(code("reduction:sum", "reduction:warp", "reduction:add_to"))
def add_to(sums: wp.array(dtype=wp.float64), index: int, value: wp.float64):
    """Add to a sum over all threads."""
    ...


@wp.func_native(code("reduction:most", "reduction:warp", "reduction:raise_to"))
def raise_to(maxima: wp.array(dtype=Any), index: int, value: Any):
    """Raise a maximum over all threads."""
    ...


@wp.func_native(code("reduction:least", "reduction:warp", "reduction:lower_to"))
def lower_to(minima: wp.array(dtype=int), index: int, value: int):
    """Lower a minimum over all threads of integers."""
    ...


@wp.func_native(code("reduction:store"))
def store(matrices: wp.array(dtype=wp.mat33), particle: int, value: wp.mat33):
    """Write a particle's matrix; on a GPU 32 neighbouring particles write theirs together."""
    ...


@wp.func_native("wp::array_store(matrices, particle, value);")
def store(matrices: wp.array(dtype=wp.mat33d), particle: int, value: wp.mat33d):  # noqa: F811
    """Write a particle's matrix in float64."""
    ...


@native_kernel("phy124_barrier", code("reduction:meet"))
def meet(
    parties: int,
    spins: int,
    counter_out: wp.array(dtype=int),
    ticket_out: wp.array(dtype=int),
):
    """One thread's attempt to pass in `spins` looks; `ticket_out[0]` is zero once it has."""
    ...
