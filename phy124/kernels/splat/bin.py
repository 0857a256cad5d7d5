"""Assigns each splat to the screen tiles it touches, front to back (a counting sort by tile)."""

import warp as wp

from phy124.kernels.build import kernel

BIN = r"""
    int* __restrict slots = ends_out.data;
    int* __restrict lists = pairs_out.data;
    const auto* __restrict boxes = tiles.data;
    const int* __restrict sorted = order.data;
    for (int k = 0; k < count; ++k) {
        // Splats lie anywhere in memory: fetch one that comes soon.
        if (k + 16 < count) __builtin_prefetch(&boxes[sorted[k + 16]]);
        const int i = sorted[k];
        const auto box = boxes[i];
        for (int row = box[1]; row < box[3]; ++row)
            for (int tile = row * columns + box[0]; tile < row * columns + box[2]; ++tile)
                if (tile >= first && tile < last) lists[slots[tile]++] = i;
    }
"""


@wp.func_native(BIN)
def bin_all(
    count: int,
    columns: int,
    first: int,
    last: int,
    order: wp.array(dtype=int),
    tiles: wp.array(dtype=wp.vec4i),
    ends_out: wp.array(dtype=int),
    pairs_out: wp.array(dtype=int),
):
    """Append every splat, front to back, to the lists of the tiles that it touches."""
    ...


@kernel("phy124_bin_serial")
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
    bin_all(count, columns, first, last, order, tiles, ends_out, pairs_out)


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
