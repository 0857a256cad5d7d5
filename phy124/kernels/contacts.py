"""Computes the impulses of each wall in a substep, per particle (contacts) and in total (wrenches).

Particle p receives m_p w_ip (v_after - v_before) of the impulse m_i (v_after - v_before) on a node.
The particles' impulses add up to the node's impulse, since m_i = sum_p m_p w_ip.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import add3, wide
from phy124.kernels.grid import row_in_copy, row_in_grid
from phy124.kernels.reduction import lower_to, raise_to
from phy124.kernels.transfer import in_window, place_in, spline


@build_once
def make_contact_copy(real: Any):
    """Kernel: stores a copy of the nodes in a box before a wall acts."""

    @kernel(f"phy124_contact_copy_{real.__name__}", real, seconds=0.15)
    def contact_copy(each, box, window, grid, kept_out, low_out: Ints, high_out: Ints):
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


@build_once
def make_contact_reach(real: Any):
    """Kernel: subtracts the copies stored by `make_contact_copy` from the nodes after a wall
    acted.
    """
    t = types(real)

    @kernel(f"phy124_contact_reach_{real.__name__}", real, seconds=0.2)
    def contact_reach(each, box, window, grid, kept_out, low_out: Ints, high_out: Ints):
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


@build_once
def make_contacts(real: Any):
    """Kernel over particles: adds the wall's impulse on each particle to the particle's total."""
    t = types(real)

    @kernel(f"phy124_contacts_{real.__name__}", real, seconds=0.4)
    def contacts(mass, lattice, box, window, x, changes, lowest: Ints, highest: Ints, impulse_out):
        p = wp.tid()
        first, f = place_in(x[p], lattice, window)
        if not in_window(first, window[1]):
            return
        for axis in range(3):
            if first[axis] + 2 < lowest[axis] or first[axis] > highest[axis]:
                return
        start = first - box[0]
        count = box[1]
        wx = spline(f[0])
        wy = spline(f[1])
        wz = spline(f[2])
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


IMPULSE, MOMENT, SUMS = 0, 3, 6


@build_once
def make_wall_wrench(real: Any):
    """Kernel over rows of nodes: adds the wrench that a wall exerted since `make_wall_copy` ran.

    The moment is about the origin of the world. The gather preserves the angular momentum of the
    nodes (APIC, Jiang et al. 2015), so the sum equals the wrench on the material.
    """

    @kernel(f"phy124_wall_wrench_{real.__name__}", real, seconds=0.2)
    def wall_wrench(lattice, each, box, window, grid, kept, sums_out):
        i, j, part = wp.tid()
        row = row_in_grid(box, window, i, j)
        copy = row_in_copy(box, i, j)
        origin = wide(wp.vector(lattice[0], lattice[1], lattice[2]))
        dx = wp.float64(lattice[3])
        impulse = wp.vec3d()
        moment = wp.vec3d()
        for k in range(part * each, part * each + each):
            q = grid[row + k]
            if q[3] > real(0.0):
                d = q - kept[copy + k]
                if d[0] != real(0.0) or d[1] != real(0.0) or d[2] != real(0.0):
                    node = window[0] + box[0] + wp.vec3i(i, j, k)
                    at = origin + dx * wp.vec3d(
                        wp.float64(node[0]), wp.float64(node[1]), wp.float64(node[2])
                    )
                    J = wp.float64(q[3]) * wide(d)
                    impulse += J
                    moment += wp.cross(at, J)
        add3(sums_out, IMPULSE, impulse)
        add3(sums_out, MOMENT, moment)

    return wall_wrench
