"""Operations of many threads on common data: sums, maxima, stores, and a barrier.

On a GPU, atomic operations on one address are serialised. Therefore each thread first reduces its
own items, then the 32 threads of a warp combine their results. If threads of a warp are inactive,
each thread writes its own result. At the barrier, CPU threads spin for some tens of microseconds
without Python's global lock. The caller then yields the core and tries again.
"""

from collections.abc import Iterable
from typing import Any

import warp as wp

from phy124.kernels.native import code, native_kernel

EACH, MOST_THREADS, BLOCK = 32, 2**14, 256
"""Particles per CPU thread, largest number of GPU threads, and threads per GPU block."""


def shared_out(particles: int, device: str, most: int = MOST_THREADS) -> tuple[int, int, int, int]:
    """Divide particles among threads; return the number of threads, `first`, `each` and `stride`.

    A thread handles the particles `thread * first + k * stride` for k < `each`. On a GPU,
    neighbouring threads have neighbouring particles, so that memory reads coalesce.
    """
    if device == "cpu":
        return -(-particles // EACH), EACH, EACH, 1
    threads = BLOCK * -(-min(particles, most) // BLOCK)
    return threads, 1, -(-particles // threads), threads


def along_rows(extent: Iterable[int], device: str) -> tuple[tuple[int, int, int], int]:
    """Return the shape (i, j, segment) of a launch over a box of nodes, and the nodes per thread.

    Each thread handles a whole row on the CPU, or one node on a GPU.
    """
    x, y, z = (int(count) for count in extent)
    return ((x, y, min(z, 1)), z) if device == "cpu" else ((x, y, z), 1)


@wp.func_native(code("reduction:run"))
def run_of(node: int) -> int:
    """Return the group of neighbouring GPU threads that add to the same nodes; 0 on a CPU.

    After this call, either all threads of a warp must call `add` equally often, or none of them.
    """
    ...


@wp.func_native(code("reduction:sum_run", "reduction:add"))
def add(grid: wp.array(dtype=wp.vec4), node: int, value: wp.vec4, run: int):
    """Add values to nodes, with one addition for each group of threads (`run_of`)."""
    ...


@wp.func_native(code("reduction:sum_run") + "wp::atomic_add(grid, node, value);")
def add(grid: wp.array(dtype=wp.vec4d), node: int, value: wp.vec4d, run: int):  # noqa: F811
    """Add a value to a node."""
    ...


@wp.func
def finite(a: Any):
    """Return whether a number is finite; faster than `wp.isfinite` on the CPU."""
    return a - a == type(a)(0.0)


@wp.func
def greater(a: Any, b: Any):
    """Return the larger of two numbers, without the NaN check of `wp.max`."""
    return wp.where(b > a, b, a)


@wp.func_native(code("reduction:load"))
def load(grid: wp.array(dtype=wp.vec4), node: int) -> wp.vec4:
    """Return the value of a node, read in one access on a GPU."""
    ...


@wp.func_native("return wp::index(grid, node);")
def load(grid: wp.array(dtype=wp.vec4d), node: int) -> wp.vec4d:  # noqa: F811
    """Return the value of a node."""
    ...


@wp.func_native(code("reduction:sum", "reduction:warp", "reduction:add_to"))
def add_to(sums: wp.array(dtype=wp.float64), index: int, value: wp.float64):
    """Add a thread's value to a sum over all threads.

    All threads of a warp that call this function together must have the same array and index, since
    the first one of them adds the sum of their values.
    """
    ...


@wp.func_native(code("reduction:raise_all"))
def raise_all(maxima: wp.array(dtype=Any), values: Any):
    """Raise the component-wise maxima over all threads to at least this thread's vector.

    On a GPU, all threads of a block must call this function, so the number of threads is a multiple
    of `BLOCK`.
    """
    ...


@wp.func_native(code("reduction:most", "reduction:warp", "reduction:raise_to"))
def raise_to(maxima: wp.array(dtype=Any), index: int, value: Any):
    """Raise a maximum over all threads to at least a value; array and index as in `add_to`."""
    ...


@wp.func_native(code("reduction:least", "reduction:warp", "reduction:lower_to"))
def lower_to(minima: wp.array(dtype=int), index: int, value: int):
    """Lower a minimum over all threads to at most a value; array and index as in `add_to`."""
    ...


@wp.func_native(code("reduction:store"))
def store(matrices: wp.array(dtype=wp.mat33), particle: int, value: wp.mat33):
    """Write a particle's matrix; on a GPU, 32 neighbouring threads write their matrices
    together.
    """
    ...


@wp.func_native("wp::array_store(matrices, particle, value);")
def store(matrices: wp.array(dtype=wp.mat33d), particle: int, value: wp.mat33d):  # noqa: F811
    """Write the matrix of a particle."""
    ...


@native_kernel("phy124_barrier", code("reduction:meet"))
def meet(
    parties: int, spins: int, counter_out: wp.array(dtype=int), ticket_out: wp.array(dtype=int)
):
    """Check up to `spins` times whether all threads have arrived at the barrier.

    If all have arrived, `ticket_out[0]` is cleared.
    """
    ...
