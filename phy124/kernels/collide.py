"""Colliders: between the grid update and the gather, nodes near a wall respond to the wall.

`make_contact` enforces contact exactly at the wall (docs/design/contact.md). At a curved wall, a
node may belong to several columns. `make_settle` then adds the mean of the columns' velocity
changes to the node. If the changes were summed instead, bodies would be squeezed flat.
`make_collider` treats each node separately, for regions that are fixed only in some directions.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import RESPONSES, add_rows, along_wall, hold_back, relative, tie, xyz
from phy124.kernels.distance import SHAPES
from phy124.kernels.grid import velocity_of
from phy124.kernels.reduction import load
from phy124.kernels.window import holds, in_box, laden, node_at, place, strides


@wp.func
def steepest(n: Any):
    """Return the axis closest to a direction."""
    axis = int(0)
    if wp.abs(n[1]) >= wp.abs(n[0]):
        axis = 1
    if wp.abs(n[2]) >= wp.abs(n[axis]):
        axis = 2
    return axis


@wp.func
def inward(s: Any, axis: int):
    """Return the index step along an axis towards a wall with the normal s[0] to s[2]."""
    step = wp.vec3i()
    step[axis] = -int(wp.sign(s[axis]))
    return step


@wp.func
def front(s: Any, axis: int, dx: Any):
    """Return whether a node is at least half a cell in front of a wall, measured along an axis."""
    return s[3] >= type(dx)(0.5) * dx * wp.abs(s[axis])


@wp.func
def add_velocity(nodes_out: wp.array(dtype=Any), n: int, change: Any):
    """Change a node's velocity without writing its mass, because other threads read the mass."""
    nodes_out[n] += wp.vector(change[0], change[1], change[2], type(change[0])(0.0))


@wp.func
def add_wish(changes_out: wp.array(dtype=Any), n: int, change: Any):
    """Add a velocity change to a node's sums, weighted by the size of the change."""
    weight = wp.length(change)
    changes_out[n] += weight * wp.vector(change[0], change[1], change[2], type(weight)(1.0))


FLAT = {"half_space"}
"""Shapes of walls whose normal is constant. At such a wall, each node belongs to a single column.
"""


@build_once
def make_settle(real: Any):
    """Kernel over a box of nodes: adds the mean of the velocity changes computed for the columns.

    Changes are weighted by their size, so that the mean varies continuously when a column begins to
    push. The kernel resets the sums in `changes_out` to zero.
    """
    t = types(real)

    @kernel(f"phy124_settle_{real.__name__}", real, seconds=0.15)
    def settle(start: wp.vec3i, window, changes_out, grid_out):
        i, j, k = wp.tid()
        n = wp.dot(wp.vec3i(i, j, k) + start, strides(window[1]))
        c = changes_out[n]
        if c[3] > real(0.0):
            q = grid_out[n]
            c /= c[3]
            grid_out[n] = wp.vector(q[0] + c[0], q[1] + c[1], q[2] + c[2], q[3])
            changes_out[n] = t.vec4()

    return settle


@build_once
def make_contact(shape: str, response: str, real: Any, updating: bool = False):
    """Kernel: makes the nodes of a sub-box respond to a wall, in columns of three nodes.

    Each thread handles `each` consecutive nodes of a row. A node that belongs to no column is
    treated separately if its signed distance is below `reach` [m]. The launch may change only the
    layers `span` (first, last) of nodes. The shape is displaced by the current value of the track
    with index `slot`.

    `lightest` is the mass of a node that is full of the lightest material [kg], or infinite for a
    single material. `full` is the fraction of the expected mass above which material touches the
    wall. In columns that the wall does not push, nodes with a signed distance below `loose` [m] are
    treated separately.

    A flat wall changes `grid_out`; other walls change `changes_out` (see `make_settle`). If
    `updating` is set, the kernel also reads momenta from `grid` and updates all nodes of the
    window; the first threads handle the sub-box, whose size is `extent`.

    Args:
        shape: Name of a distance function.
        response: Name of a response.
        real: wp.float32 or wp.float64.
        updating: Whether the kernel includes the grid update.
    """
    t = types(real)
    distance = SHAPES[shape]
    answer, acts, ratios, pushes, hold = RESPONSES[response]
    flat = shape in FLAT
    name = f"phy124_contact_{shape}_{response}_{real.__name__}"
    name += "_update" * updating

    @wp.func
    def velocity(grid: wp.array(dtype=t.vec4), n: int, kick: real, a: t.vec4):
        if wp.static(updating):
            return velocity_of(grid[n], kick, a)
        return grid[n]

    @wp.func
    def begin(nodes_out: wp.array(dtype=t.vec4), n: int, q: t.vec4):
        if wp.static(updating):
            # The thread of an empty node stores the node, also if it is part of a column.
            if q[3] > real(0.0):
                nodes_out[n] = q

    @wp.func
    def respond(
        here: wp.vec3i,
        geometry: t.mat33,
        friction: real,
        reach: real,
        span: wp.vec2i,
        lightest: real,
        full: real,
        loose: real,
        moved: t.vec3,
        wall: t.vec3,
        lattice: t.vec4,
        low: wp.vec3i,
        size: wp.vec3i,
        kick: real,
        a: t.vec4,
        grid: wp.array(dtype=t.vec4),
        grid_out: wp.array(dtype=t.vec4),
        changes_out: wp.array(dtype=t.vec4),
    ):
        stride = strides(size)
        n = wp.dot(here, stride)
        if not holds(size, span, here):
            return
        if grid[n][3] <= real(0.0):
            if wp.static(updating):
                grid_out[n] = grid[n]
            return

        # The column's first node is this node, or one of the two nodes in front of it.
        dx = lattice[3]
        s = distance(place(lattice, low + here) - moved, geometry)
        axis = steepest(s)
        back = inward(s, axis)
        s1 = distance(place(lattice, low + here + back) - moved, geometry)
        leads = front(s, axis, dx)
        if leads and front(s1, axis, dx):
            begin(grid_out, n, velocity(grid, n, kick, a))
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

        # A node without a complete column responds alone.
        if not (column and laden(grid, size, span, lead) and holds(size, span, end)):
            q = velocity(grid, n, kick, a)
            begin(grid_out, n, q)
            if s[3] < reach:
                v = answer(xyz(q), wall, xyz(s), friction)
                if wp.static(flat):
                    grid_out[n] = wp.vector(v[0], v[1], v[2], q[3])
                else:
                    add_wish(changes_out, n, v - xyz(q))
            return
        if not leads:
            return

        # The column follows the wall. Masses are fractions of the column's mass, because squares of
        # momenta in SI units would underflow in float32.
        q0 = velocity(grid, n, kick, a)
        q1 = velocity(grid, n + step, kick, a)
        q2 = velocity(grid, n + 2 * step, kick, a)
        begin(grid_out, n, q0)
        begin(grid_out, n + step, q1)
        begin(grid_out, n + 2 * step, q2)
        mass = q0[3] + q1[3] + q2[3]
        m = wp.vector(q0[3], q1[3], q2[3]) / mass
        normal = xyz(s0)
        across = dx * wp.abs(normal[axis])
        g = ratios(wp.vector(s0[3], s1[3], s2[3]), across)
        change = tie(relative(q0, q1, q2, wall), m, g)
        stop = change * normal
        pressed = wp.dot(m, stop)
        u = wp.vector(s0[3], s1[3], s2[3]) / across
        above = real(0.0)
        if laden(grid, size, span, lead - back):
            above = grid[n - step][3] / mass
        # Drops and grains sometimes get behind a wall.
        beyond = real(0.0)
        if wp.isinf(loose) and laden(grid, size, span, end + back):
            beyond = grid[n + 3 * step][3] / mass
        come = acts(m, above, beyond, u, lightest / mass, full)
        if come and pushes(pressed):
            drag = along_wall(change, normal)
            taken = hold(wp.transpose(drag) * m, pressed, friction)
            change = wp.outer(stop, normal) + drag * taken
            if wp.static(flat):
                add_rows(grid_out, n, step, m, change, real(0.0))
            else:
                weight = wp.sqrt(wp.ddot(change, change))
                add_rows(changes_out, n, step, m, weight * change, weight)
            return

        # Next to a tip or a hair, the body squeezes material through the wall. The material behind
        # the wall is stopped until the column's material has arrived at the wall.
        if wp.isinf(loose):
            if not come and wp.min(m[1], m[2]) > real(0.0):
                last = n + 2 * step
                wanted = hold_back(xyz(q2) - wall, xyz(q1) - wall, normal)
                if wp.static(flat):
                    add_velocity(grid_out, last, wanted)
                else:
                    add_wish(changes_out, last, wanted)
            return

        # If no material in front of the wall presses, the material behind the wall would move on.
        # (If material presses, the column's linear velocity applies instead: nodes that were
        # stopped before would press on the lowest layer.)
        for row in range(1, 3):
            behind = n + row * step
            s = s1
            v = xyz(q1)
            if row == 2:
                s = s2
                v = xyz(q2)
            if s[3] < loose and m[row] > real(0.0):
                wanted = answer(v, wall, xyz(s), friction) - v
                if wp.static(flat):
                    add_velocity(grid_out, behind, wanted)
                else:
                    add_wish(changes_out, behind, wanted)

    if updating:

        @kernel(name, real, seconds=0.4)
        def update_and_contact(
            geometry,
            friction,
            reach,
            slot,
            start: wp.vec3i,
            extent: wp.vec3i,
            span: wp.vec2i,
            lightest: real,
            full: real,
            loose: real,
            lattice,
            window,
            clock,
            values,
            rates,
            grid,
            grid_out,
        ):
            # The nodes near the wall come first, so that threads of one warp take the same branch.
            size = window[1]
            near = extent[0] * extent[1] * extent[2]
            n = wp.tid() - near
            here = node_at(n, size)
            if n < 0:
                here = start + node_at(wp.tid(), extent)
            elif in_box(here - start, extent):
                return
            if n < 0 and values[slot][3] > real(0.0):
                respond(
                    here,
                    geometry,
                    friction,
                    reach,
                    span,
                    lightest,
                    full,
                    loose,
                    xyz(values[slot]),
                    xyz(rates[slot]),
                    lattice,
                    window[0],
                    size,
                    clock[0],
                    values[0],
                    grid,
                    grid_out,
                    grid_out,
                )
            else:
                n = wp.dot(here, strides(size))
                grid_out[n] = velocity_of(load(grid, n), clock[0], values[0])

        return update_and_contact

    @kernel(name, real, seconds=0.4)
    def contact(
        geometry,
        friction,
        reach,
        slot,
        start: wp.vec3i,
        each,
        span: wp.vec2i,
        lightest: real,
        full: real,
        loose: real,
        lattice,
        window,
        values,
        rates,
        grid_out,
        changes_out,
    ):
        i, j, part = wp.tid()
        if values[slot][3] > real(0.0):
            moved = xyz(values[slot])
            wall = xyz(rates[slot])
            for k in range(part * each, part * each + each):
                respond(
                    wp.vec3i(i, j, k) + start,
                    geometry,
                    friction,
                    reach,
                    span,
                    lightest,
                    full,
                    loose,
                    moved,
                    wall,
                    lattice,
                    window[0],
                    window[1],
                    real(0.0),
                    t.vec4(),
                    grid_out,
                    grid_out,
                    changes_out,
                )

    return contact


@build_once
def make_collider(shape: str, response: str, real: Any):
    """Kernel over the nodes of a sub-box: applies a wall's response to the nodes inside the wall.

    A node counts as inside if its signed distance is below `reach` [m]. The shape is displaced by
    the current value of the track with index `slot`.
    """
    distance, answer = SHAPES[shape], RESPONSES[response].answer
    name = f"phy124_collide_{shape}_{response}_{real.__name__}"

    @kernel(name, real, seconds=0.4)
    def collide(
        geometry, friction, reach, slot, start: wp.vec3i, lattice, window, values, rates, grid_out
    ):
        i, j, k = wp.tid()
        size = window[1]
        node = wp.vec3i(i, j, k) + start
        if node[0] < size[0] and node[1] < size[1] and node[2] < size[2]:
            n = wp.dot(node, strides(size))
            q = grid_out[n]
            s = distance(place(lattice, window[0] + node) - xyz(values[slot]), geometry)
            if values[slot][3] > real(0.0) and q[3] > real(0.0) and s[3] < reach:
                v = answer(xyz(q), xyz(rates[slot]), xyz(s), friction)
                grid_out[n] = wp.vector(v[0], v[1], v[2], q[3])

    return collide
