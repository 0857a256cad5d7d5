"""The grid update between scatter and gather: momentum to velocity."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.reduction import raise_to
from phy124.kernels.rows import add_row, clear_row, copy_row
from phy124.kernels.transfer import types


@cache
def make_update(real: Any):
    """Kernel: (momentum, mass) to (velocity, mass), kicked by the uniform acceleration."""
    t = types(real)

    @kernel(f"phy124_grid_{real.__name__}", seconds=0.15)
    def update(
        # model
        clock: wp.array(dtype=real), values: wp.array(dtype=t.vec4),
        # in place
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        n = wp.tid()
        q = grid_out[n]
        m = q[3]
        if m > real(0.0):
            # Slot 0 of the tracks is the sum of all uniform accelerations, including gravity.
            a = values[0]
            kick = clock[0]
            grid_out[n] = wp.vector(
                q[0] / m + kick * a[0], q[1] / m + kick * a[1], q[2] / m + kick * a[2], m
            )

    return update


@cache
def make_merge(real: Any):
    """Kernel over rows of nodes: adds what several workers scattered.

    Each box of private nodes lies in the window; `boxes` holds its lowest node and its extent,
    `starts` its first node in `pool`, where its nodes follow each other like those of a window.
    The boxes are added in order, whoever adds them.
    """
    t = types(real)

    @kernel(f"phy124_merge_{real.__name__}")
    def merge(
        # model
        layer: int, window: wp.array(dtype=wp.vec3i), boxes: wp.array(dtype=wp.vec3i),
        starts: wp.array(dtype=int),
        # state in
        pool: wp.array(dtype=t.vec4),
        # out
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        i, j = wp.tid()
        size = window[1]
        row = ((layer + i) * size[1] + j) * size[2]
        found = int(0)
        for b in range(starts.shape[0]):
            low = boxes[2 * b] - window[0]
            extent = boxes[2 * b + 1]
            across = layer + i - low[0]
            along = j - low[1]
            if across >= 0 and across < extent[0] and along >= 0 and along < extent[1]:
                own = starts[b] + (across * extent[1] + along) * extent[2]
                if found == 0:
                    clear_row(grid_out, row, low[2])
                    copy_row(grid_out, row + low[2], pool, own, extent[2])
                    clear_row(grid_out, row + low[2] + extent[2], size[2] - low[2] - extent[2])
                else:
                    add_row(grid_out, row + low[2], pool, own, extent[2])
                found += 1
        if found == 0:
            clear_row(grid_out, row, size[2])

    return merge


@cache
def make_grid_speed(real: Any):
    """Kernel: the largest squared speed of a node with mass, which decides about step rejection."""
    t = types(real)

    @kernel(f"phy124_grid_speed_{real.__name__}")
    def grid_speed(
        # state in
        grid: wp.array(dtype=t.vec4),
        # out
        fastest_out: wp.array(dtype=real),
    ):  # fmt: skip
        q = grid[wp.tid()]
        if q[3] > real(0.0):
            square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
            # A comparison with NaN is false, and NaN must not count as slow.
            if not wp.isfinite(square):
                square = real(1.0e38)
            raise_to(fastest_out, 0, square)

    return grid_speed
