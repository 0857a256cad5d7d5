"""Assigns each splat to the screen tiles it touches, front to back (a counting sort by tile)."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.screen import Splat, tiles_of


@kernel("phy124_bin")
def bin_serial(
    # model
    count: int,
    columns: int,
    first: int,
    last: int,
    # state in
    order: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    # in place: start of each tile's list, then its end
    ends_out: wp.array(dtype=int),
    # out
    pairs_out: wp.array(dtype=int),
):
    """A single thread, for CPUs: following `order` keeps every list in depth order."""
    for k in range(count):
        i = order[k]
        tiles = tiles_of(splats[i])
        for row in range(tiles[1], tiles[3]):
            for column in range(tiles[0], tiles[2]):
                tile = row * columns + column
                if tile >= first and tile < last:
                    slot = ends_out[tile]
                    pairs_out[slot] = i
                    ends_out[tile] = slot + 1


@kernel("phy124_bin")
def bin_parallel(
    # model
    columns: int,
    first: int,
    last: int,
    # state in
    order: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    # in place: start of each tile's list, then its end
    ends_out: wp.array(dtype=int),
    # out
    ranks_out: wp.array(dtype=int),
    pairs_out: wp.array(dtype=int),
):
    """One thread per splat, for GPUs: the lists are unordered and are then sorted by rank."""
    k = wp.tid()
    i = order[k]
    tiles = tiles_of(splats[i])
    for row in range(tiles[1], tiles[3]):
        for column in range(tiles[0], tiles[2]):
            tile = row * columns + column
            if tile >= first and tile < last:
                slot = wp.atomic_add(ends_out, tile, 1)
                ranks_out[slot] = k
                pairs_out[slot] = i
