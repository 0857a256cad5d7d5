"""Assigns each splat to the screen tiles it touches, front to back (a counting sort by tile)."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.native import code, native_kernel


@native_kernel("phy124_bin_serial", code("bin"))
def bin_serial(
    # model
    count: int,
    columns: int,
    first: int,
    last: int,
    # state in
    order: wp.array(dtype=int),
    tiles: wp.array(dtype=wp.vec4i),
    # in place: start of each tile's list, then its end
    ends_out: wp.array(dtype=int),
    # out
    pairs_out: wp.array(dtype=int),
):
    """A single thread, for CPUs: following `order` keeps every list in depth order."""
    ...


@kernel("phy124_bin")
def bin_parallel(
    # model
    columns: int,
    first: int,
    last: int,
    # state in
    order: wp.array(dtype=int),
    tiles: wp.array(dtype=wp.vec4i),
    # in place: start of each tile's list, then its end
    ends_out: wp.array(dtype=int),
    # out
    ranks_out: wp.array(dtype=int),
    pairs_out: wp.array(dtype=int),
):
    """One thread per splat, for GPUs: the lists are unordered and are then sorted by rank."""
    k = wp.tid()
    i = order[k]
    box = tiles[i]
    for row in range(box[1], box[3]):
        for column in range(box[0], box[2]):
            tile = row * columns + column
            if tile >= first and tile < last:
                slot = wp.atomic_add(ends_out, tile, 1)
                ranks_out[slot] = k
                pairs_out[slot] = i
