"""Colliders: nodes near a wall respond to it between the grid update and the gather.

Node n of the window is at origin + (window[0] + (i, j, k)) dx. A collider is built from a distance
function and a response, so an absent shape or mode costs nothing.

`make_contact` places contact at the wall itself, between the nodes. Along the axis closest to the
wall's normal, the velocity relative to the wall is to be linear in the distance and zero on the
wall: the first node at least half a cell in front of the wall leads, and the two behind it follow
with the ratios g of their distances (quadratic B-splines reproduce linear functions, and reach no
further behind). Momentum is projected onto such velocities, v_1 = sum(g m v) / sum(g^2 m), which
never adds energy and pushes on all three nodes alike; without this a wall is as soft as a layer one
cell thick. (Extended B-splines: Hoellig, Reif, Wipper 2001.) The wall acts once the material has
reached it, as the masses of the nodes on its two sides show: see `covered`.

Held material ends in the same way at the surface of its region: the nodes inside are held, and the
one next to the surface follows the one in front of it so that the velocity is zero where the region
ends, g = (1, -w0 / w1, 0) with the weights w of the nodes there.

`make_collider` is the usual rule, node by node, for regions that are held only in some directions.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.distance import SHAPES
from phy124.kernels.friction import all_of_it, coulomb, none_of_it, separate, slip, sticky
from phy124.kernels.spline import spline
from phy124.kernels.transfer import types


@wp.func
def covered(u: Any):
    """Fraction of a quadratic B-spline beyond a plane that is u cells before its centre."""
    one = type(u)(1.0)
    sixth = type(u)(1.0 / 6.0)
    reach = wp.max(type(u)(1.5) - wp.abs(u), type(u)(0.0))
    tail = sixth * reach * reach * reach
    if u < type(u)(-0.5):
        return tail
    if u > type(u)(0.5):
        return one - tail
    return type(u)(0.5) + u * (type(u)(0.75) - u * u * type(u)(1.0 / 3.0))


@wp.func
def steepest(n: Any):
    """The axis closest to a direction."""
    axis = int(0)
    if wp.abs(n[1]) >= wp.abs(n[0]):
        axis = 1
    if wp.abs(n[2]) >= wp.abs(n[axis]):
        axis = 2
    return axis


@wp.func
def inward(s: Any, axis: int):
    """The step along an axis from one node to the next, towards a wall at the distance s."""
    step = wp.vec3i()
    step[axis] = -int(wp.sign(s[axis]))
    return step


@wp.func
def place(lattice: Any, node: wp.vec3i):
    """Position of a node of the grid [m]."""
    dx = lattice[3]
    return wp.vector(
        lattice[0] + dx * type(dx)(node[0]),
        lattice[1] + dx * type(dx)(node[1]),
        lattice[2] + dx * type(dx)(node[2]),
    )


@wp.func
def front(s: Any, axis: int, dx: Any):
    """Whether a node at the distance s is at least half a cell in front of a wall along an axis."""
    return s[3] >= type(dx)(0.5) * dx * wp.abs(s[axis])


@wp.func
def xyz(q: Any):
    """The first three components: a node's velocity, a distance's normal, or a track's value."""
    return wp.vector(q[0], q[1], q[2])


@wp.func
def relative(q0: Any, q1: Any, q2: Any, wall: Any):
    """The velocities of a column's nodes relative to a wall [node, axis]."""
    return wp.matrix_from_rows(xyz(q0) - wall, xyz(q1) - wall, xyz(q2) - wall)


@wp.func
def holds(size: wp.vec3i, span: wp.vec2i, node: wp.vec3i):
    """Whether a node is in the window and in the layers that a launch may touch."""
    return (
        node[0] >= span[0] and node[1] >= 0 and node[2] >= 0
        and node[0] < span[1] and node[1] < size[1] and node[2] < size[2]
    )  # fmt: skip


@wp.func
def strides(size: wp.vec3i):
    """Distance in memory between neighbours along each axis."""
    return wp.vec3i(size[1] * size[2], size[2], 1)


@wp.func
def laden(grid: wp.array(dtype=Any), size: wp.vec3i, span: wp.vec2i, node: wp.vec3i):
    """Whether a node may be touched by this launch and has mass."""
    if not holds(size, span, node):
        return False
    q = grid[wp.dot(node, strides(size))]
    return q[3] > type(q[3])(0.0)


FULL = wp.constant(0.8)
"""Fraction of the expected mass above which a body has reached the wall (a gap of 0.15 cells)."""


@wp.func
def arrived(m: Any, near: Any, far: Any, lightest: Any):
    """Whether material has reached a wall: nodes `near` and `far` cells in front have masses m.

    A body that touches the wall covers their splines in a known ratio; with a gap, less is on the
    nearer node. The ratio does not depend on how dense or wide the body is. Irregular particles
    scatter about it, and a body must not stand on the few fullest columns only. If something
    heavier lies on it, the farther node counts as at most a full node of the `lightest` material.
    """
    behind = wp.min(m[0], lightest * covered(far))
    full = type(near)(FULL) * behind * covered(near)
    return m[1] > type(near)(0.0) and m[1] * covered(far) >= full


@wp.func
def joined(m: Any, near: Any, far: Any, lightest: Any):
    """Whether the node next to the surface of a region that holds has mass."""
    return not m[1] <= type(near)(0.0)


@wp.func
def linear(distances: Any, across: Any):
    """Ratios g of a velocity that is linear in the distance and zero on the wall."""
    return distances / distances[0]


@wp.func
def ending(distances: Any, across: Any):
    """Ratios g of a velocity that is zero where the region ends; `across` is the cell size [m]."""
    one = type(across)(1.0)
    w = spline(distances[0] / across)
    return wp.vector(one, -w[0] / w[1], type(across)(0.0))


@wp.func
def tied(v: Any, m: Any, g: Any):
    """Change of the velocities [node, axis] of masses m that makes them follow with ratios g."""
    weight = wp.cw_mul(g, m)
    return wp.outer(g, (wp.transpose(v) @ weight) / wp.dot(weight, g)) - v


@wp.func
def along_wall(change: Any, normal: Any):
    """The part of changes [node, axis] that is along a wall."""
    return change - wp.outer(change * normal, normal)


@wp.func
def pressing(pressed: Any):
    """Whether the wall pushes: it lets go of material that leaves."""
    return pressed > type(pressed)(0.0)


@wp.func
def either_way(pressed: Any):
    """Always true: the wall does not let go of material that leaves."""
    return True


@wp.func
def add_rows(grid: wp.array(dtype=Any), first: int, step: int, m: Any, change: Any):
    """Add changes of velocity [node, axis] to a column's nodes, where there is mass."""
    for row in range(3):
        if m[row] > type(m[row])(0.0):
            grid[first + row * step] += wp.vector(
                change[row, 0], change[row, 1], change[row, 2], type(m[row])(0.0)
            )


class Response(NamedTuple):
    """How nodes respond to a wall: one by one, or as a column of three."""

    answer: Any
    """`(v, wall, n, friction) -> v` of a node by itself."""
    acts: Any
    """`(m, near, far, lightest)`: whether the wall acts on a column yet."""
    ratios: Any
    """`(distances, across) -> g`, how the velocities of a column follow the first."""
    pushes: Any
    """`(pressed)`: whether it acts, by the impulse per mass along its normal."""
    hold: Any
    """`(along, pressed, friction)`: the fraction of the motion along the wall that it takes."""


RESPONSES = {
    "sticky": Response(sticky, arrived, linear, either_way, all_of_it),
    "slip": Response(slip, arrived, linear, either_way, none_of_it),
    "separate": Response(separate, arrived, linear, pressing, coulomb),
    "held": Response(sticky, joined, ending, either_way, all_of_it),
}


@cache
def make_contact(shape: str, response: str, moving: bool, real: Any):
    """Kernel over the nodes of a sub-box: columns of three nodes at a wall respond to it.

    The thread of a column's first node handles all three. Nodes further behind, or in columns
    without material in front, respond one by one below `reach` [m] of signed distance; so do
    columns that leave `span`, the layers first <= i < last that this launch may touch. A moving
    shape is displaced by the value of its track, and its wall moves at the track's rate, while the
    track is active. `lightest` is the mass of a node inside the lightest of several materials [kg],
    or infinite.

    Args:
        shape: Name of a distance function.
        response: Name of a response.
        moving: Whether the shape has a track.
        real: wp.float32 or wp.float64.
    """
    t = types(real)
    distance = SHAPES[shape]
    answer, acts, ratios, pushes, hold = RESPONSES[response]
    name = f"phy124_contact_{shape}_{response}_{'moving' if moving else 'still'}_{real.__name__}"

    @kernel(name, seconds=0.4)
    def contact(
        # model
        geometry: t.mat33, friction: real, reach: real, slot: int, start: wp.vec3i, span: wp.vec2i,
        lightest: real,
        lattice: t.vec4, window: wp.array(dtype=wp.vec3i),
        values: wp.array(dtype=t.vec4), rates: wp.array(dtype=t.vec4),
        # in place
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        i, j, k = wp.tid()
        size = window[1]
        here = wp.vec3i(i, j, k) + start
        moved = t.vec3()
        wall = t.vec3()
        active = real(1.0)
        if wp.static(moving):
            moved = xyz(values[slot])
            wall = xyz(rates[slot])
            active = values[slot][3]
        stride = strides(size)
        n = wp.dot(here, stride)
        if active <= real(0.0) or not holds(size, span, here):
            return
        if grid_out[n][3] <= real(0.0):
            return

        # The first of three nodes at the wall leads; this may be that one, or one of those behind.
        low = window[0]
        dx = lattice[3]
        s = distance(place(lattice, low + here) - moved, geometry)
        axis = steepest(s)
        back = inward(s, axis)
        s1 = distance(place(lattice, low + here + back) - moved, geometry)
        leads = front(s, axis, dx)
        if leads and front(s1, axis, dx):
            return
        lead = here
        if not leads:
            lead = here - back
            if not front(distance(place(lattice, low + lead) - moved, geometry), axis, dx):
                lead = lead - back
        step = wp.dot(back, stride)
        end = lead + back + back
        s0 = distance(place(lattice, low + lead) - moved, geometry)
        s2 = distance(place(lattice, low + end) - moved, geometry)
        column = front(s0, axis, dx) and s2[3] <= real(0.0)

        # A node without such a column responds by itself.
        if not (column and laden(grid_out, size, span, lead) and holds(size, span, end)):
            if s[3] < reach:
                v = answer(xyz(grid_out[n]), wall, xyz(s), friction)
                grid_out[n] = wp.vector(v[0], v[1], v[2], grid_out[n][3])
            return
        if not leads:
            return

        # The column follows the wall; masses are shares, for squares of momenta in small units
        # would be nothing in float32.
        q0 = grid_out[n]
        q1 = grid_out[n + step]
        q2 = grid_out[n + 2 * step]
        mass = q0[3] + q1[3] + q2[3]
        m = wp.vector(q0[3], q1[3], q2[3]) / mass
        normal = xyz(s0)
        across = dx * wp.abs(normal[axis])
        g = ratios(wp.vector(s0[3], s1[3], s2[3]), across)
        if acts(m, s1[3] / across, s0[3] / across, lightest / mass):
            change = tied(relative(q0, q1, q2, wall), m, g)
            stop = change * normal
            pressed = wp.dot(m, stop)
            drag = along_wall(change, normal)
            if pushes(pressed):
                taken = hold(wp.transpose(drag) * m, pressed, friction)
                add_rows(grid_out, n, step, m, wp.outer(stop, normal) + drag * taken)

    return contact


@cache
def make_collider(shape: str, response: str, moving: bool, real: Any):
    """Kernel over the nodes of a sub-box: velocities inside a shape respond to its wall.

    A node counts as inside below `reach` [m] of signed distance. A moving shape is displaced by the
    value of its track, and its wall moves at the track's rate, while the track is active.

    Args:
        shape: Name of a distance function.
        response: Name of a response.
        moving: Whether the shape has a track.
        real: wp.float32 or wp.float64.
    """
    t = types(real)
    distance, answer = SHAPES[shape], RESPONSES[response].answer
    name = f"phy124_collide_{shape}_{response}_{'moving' if moving else 'still'}_{real.__name__}"

    @kernel(name, seconds=0.4)
    def collide(
        # model
        geometry: t.mat33, friction: real, reach: real, slot: int, start: wp.vec3i,
        lattice: t.vec4, window: wp.array(dtype=wp.vec3i),
        values: wp.array(dtype=t.vec4), rates: wp.array(dtype=t.vec4),
        # in place
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        i, j, k = wp.tid()
        size = window[1]
        node = wp.vec3i(i, j, k) + start
        if node[0] < size[0] and node[1] < size[1] and node[2] < size[2]:
            n = wp.dot(node, strides(size))
            q = grid_out[n]
            x = place(lattice, window[0] + node)
            wall = t.vec3()
            active = real(1.0)
            if wp.static(moving):
                x -= xyz(values[slot])
                wall = xyz(rates[slot])
                active = values[slot][3]
            s = distance(x, geometry)
            if active > real(0.0) and q[3] > real(0.0) and s[3] < reach:
                v = answer(xyz(q), wall, xyz(s), friction)
                grid_out[n] = wp.vector(v[0], v[1], v[2], q[3])

    return collide
