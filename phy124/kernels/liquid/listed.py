"""Lists the cells of liquid in memory order, and divides the list into parts of equal length.

There is one part per CPU thread, or many parts on a GPU. Sums are added part by part, so a result
depends only on the number of parts.
"""

import warp as wp

from phy124.kernels.arguments import Ints
from phy124.kernels.build import kernel

Vectors = wp.array(dtype=wp.vec3d)
Table = wp.array2d(dtype=wp.float64)


@wp.func
def share(count: int, part: int, parts: int):
    """Return the first index of a part of a list, and the index after its last item."""
    return wp.vec2i(
        int(wp.int64(count) * wp.int64(part) / wp.int64(parts)),
        int(wp.int64(count) * wp.int64(part + 1) / wp.int64(parts)),
    )


@wp.func
def total(sums: Table, row: int):
    """Return the sum of a row of `sums`, whose columns are partial sums over parts of the cells."""
    result = wp.float64(0.0)
    for k in range(sums.shape[1]):
        result += sums[row, k]
    return result


@wp.func
def quotient(sums: Table, row: int, divisor: wp.float64):
    """Return the sum of a row (`total`) divided by a number, or 0 if the number is 0.

    The divisor is 0 if the solution is exact: on a GPU, the iteration continues until the next
    check of convergence.
    """
    result = wp.float64(0.0)
    if divisor > wp.float64(0.0):
        result = total(sums, row) / divisor
    return result


@wp.func
def count_of(counts: Ints):
    """Return the number of cells of liquid in the list."""
    result = int(0)
    for k in range(counts.shape[0]):
        result += counts[k]
    return result


@kernel("phy124_liquid_count", seconds=0.2)
def count_liquid(part: int, active: Ints, ends: Ints, liquid: Ints, counts_out: Ints):
    """Count the cells of liquid in a part of the active cells."""
    p = part + wp.tid()
    span = share(ends[ends.shape[0] - 1], p, counts_out.shape[0])
    wet = int(0)
    for k in range(span[0], span[1]):
        wet += liquid[active[k]]
    counts_out[p] = wet


@kernel("phy124_liquid_list", seconds=0.2)
def list_liquid(part: int, active: Ints, ends: Ints, liquid: Ints, counts: Ints, listed_out: Ints):
    """List the cells of liquid in a part of the active cells."""
    p = part + wp.tid()
    at = int(0)
    for k in range(p):
        at += counts[k]
    span = share(ends[ends.shape[0] - 1], p, counts.shape[0])
    for k in range(span[0], span[1]):
        n = active[k]
        if liquid[n] == 1:
            listed_out[at] = n
            at += 1
