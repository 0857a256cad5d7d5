"""The grid update between scatter and gather: momentum to velocity."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
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
    """Kernel: as `update`, after adding what two workers scattered into nodes of their own.

    Worker A covers the nodes first_a <= n < last_a of the shared window, worker B likewise.
    """
    t = types(real)

    @kernel(f"phy124_merge_{real.__name__}")
    def merge(
        # model
        start: int, first_a: int, last_a: int, first_b: int, last_b: int,
        clock: wp.array(dtype=real), values: wp.array(dtype=t.vec4),
        # state in
        nodes_a: wp.array(dtype=t.vec4), nodes_b: wp.array(dtype=t.vec4),
        # out
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        n = start + wp.tid()
        q = t.vec4()
        if n >= first_a and n < last_a:
            q = nodes_a[n - first_a]
        if n >= first_b and n < last_b:
            q += nodes_b[n - first_b]
        m = q[3]
        if m > real(0.0):
            a = values[0]
            kick = clock[0]
            q = wp.vector(q[0] / m + kick * a[0], q[1] / m + kick * a[1], q[2] / m + kick * a[2], m)
        grid_out[n] = q

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
            if square > fastest_out[0]:
                wp.atomic_max(fastest_out, 0, square)

    return grid_speed
