"""Contacts: what walls give to each particle in a substep.

A wall changes the velocity of nodes. With the weights w_ip by which the particles' mass came to a
node, its impulse m_i (v_after - v_before) is shared out as m_p w_ip (v_after - v_before): the
shares of all particles are the whole, since m_i = sum_p m_p w_ip.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.reduction import lower_to, raise_to
from phy124.kernels.rows import row_in_copy, row_in_grid
from phy124.kernels.spline import spline
from phy124.kernels.transfer import first_node, in_window, types


@cache
def make_contact_copy(real: Any):
    """Kernel over parts of rows in a box, `each` nodes long: stores what they are before a wall."""
    t = types(real)

    @kernel(f"phy124_contact_copy_{real.__name__}", seconds=0.15)
    def contact_copy(
        # model
        each: int, box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # state in
        grid: wp.array(dtype=t.vec4),
        # out
        kept_out: wp.array(dtype=t.vec4), low_out: wp.array(dtype=int),
        high_out: wp.array(dtype=int),
    ):  # fmt: skip
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        for k in range(part * each, part * each + each):
            kept_out[copy + k] = grid[row + k]
        if i == 0 and j == 0 and part == 0:
            for axis in range(3):
                low_out[axis] = window[1][axis]
                high_out[axis] = -1

    return contact_copy


@cache
def make_contact_reach(real: Any):
    """Kernel over the same parts: how the wall has changed each velocity, in place of the kept one,
    and the lowest and the highest node that it has changed.
    """
    t = types(real)

    @kernel(f"phy124_contact_reach_{real.__name__}", seconds=0.2)
    def contact_reach(
        # model
        each: int, box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i),
        # state in
        grid: wp.array(dtype=t.vec4),
        # out
        kept_out: wp.array(dtype=t.vec4), low_out: wp.array(dtype=int),
        high_out: wp.array(dtype=int),
    ):  # fmt: skip
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        lowest = box[1][2]
        highest = int(-1)
        for k in range(part * each, part * each + each):
            q = grid[row + k]
            n = copy + k
            d = q - kept_out[n]
            if q[3] <= real(0.0):
                d = t.vec4()
            kept_out[n] = d
            if d[0] != real(0.0) or d[1] != real(0.0) or d[2] != real(0.0):
                lowest = wp.min(lowest, k)
                highest = k
        first = window[1]
        last = wp.vec3i(-1)
        if highest >= 0:
            first = box[0] + wp.vec3i(i, j, lowest)
            last = box[0] + wp.vec3i(i, j, highest)
        for axis in range(3):
            lower_to(low_out, axis, first[axis])
            raise_to(high_out, axis, last[axis])

    return contact_reach


@cache
def make_contacts(real: Any):
    """Kernel over particles: adds its share of what changed since `contact_copy`."""
    t = types(real)

    @kernel(f"phy124_contacts_{real.__name__}", seconds=0.4)
    def contacts(
        # model
        mass: wp.array(dtype=real), lattice: t.vec4, box: wp.array(dtype=wp.vec3i),
        window: wp.array(dtype=wp.vec3i),
        # state in
        x: wp.array(dtype=t.vec3), changes: wp.array(dtype=t.vec4),
        lowest: wp.array(dtype=int), highest: wp.array(dtype=int),
        # out
        impulse_out: wp.array(dtype=wp.vec3d),
    ):  # fmt: skip
        p = wp.tid()
        g = (x[p] - wp.vector(lattice[0], lattice[1], lattice[2])) / lattice[3]
        low = first_node(g)
        size = window[1]
        first = low - window[0]
        if not in_window(first, size):
            return
        for axis in range(3):
            if first[axis] + 2 < lowest[axis] or first[axis] > highest[axis]:
                return
        start = first - box[0]
        count = box[1]
        wx = spline(g[0] - real(low[0]))
        wy = spline(g[1] - real(low[1]))
        wz = spline(g[2] - real(low[2]))
        change = t.vec4()
        for i in range(3):
            a = start[0] + i
            for j in range(3):
                b = start[1] + j
                if a >= 0 and a < count[0] and b >= 0 and b < count[1]:
                    w = wx[i] * wy[j]
                    n = (a * count[1] + b) * count[2] + start[2]
                    for k in range(3):
                        if start[2] + k >= 0 and start[2] + k < count[2]:
                            change += (w * wz[k]) * changes[n + k]
        impulse_out[p] += wp.float64(mass[p]) * wide(change)

    return contacts
