"""Contact of surface points with material on a grid, by impulses on the nodes of the body and of
the grid.

The surface of the material is assumed to be where the volume fraction is one half. The velocity of
the material at a point is the mass-weighted mean velocity of the nodes around the point. An impulse
J changes the velocity of each of these nodes by w_i J / sum w_i m_i, so momentum is conserved
exactly.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import xyz
from phy124.kernels.contacts import MOMENT as PAIR_MOMENT
from phy124.kernels.contacts import SUMS as PAIR_SUMS
from phy124.kernels.diagnostics import add3, wide
from phy124.kernels.lattice.responses import LIMITS, RELAXED, correct, there_and_back
from phy124.kernels.lattice.rows import Rows
from phy124.kernels.lattice.start import INSIDE, touches_at_start
from phy124.kernels.pairs import mass_at
from phy124.kernels.transfer import first_node, slope, spline
from phy124.kernels.window import strides

SURFACE = wp.constant(0.5)
"""Volume fraction at the assumed surface of the material on a grid."""
DEEPEST = wp.constant(1.0)
"""Largest depth inside the material at which a point may start [cells]. The depth is known only
near the material's surface.
"""
THINNEST, STEEPEST = wp.constant(0.02), wp.constant(0.05)
"""Smallest volume fraction and slope [1/cell] of material that a surface point touches."""


@build_once
def make_grid_near(real: Any, rows: Rows):
    """Kernel over surface points: flags each point that is close to a grid node with mass."""
    moved_by = rows.moved_by

    @kernel(f"phy124_lattice_grid_near_{rows.name}{real.__name__}", real, seconds=0.4)
    def grid_near(nodes, weights, rest, u, lattice, window, grid, near_out: Ints):
        s = wp.tid()
        f = (rest[s] + moved_by(u, nodes, weights, s) - xyz(lattice)) / lattice[3]
        first = first_node(f)
        near_out[s] = 0
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    if mass_at(grid, window, first + wp.vec3i(i, j, k)) > real(0.0):
                        near_out[s] = 1

    return grid_near


@build_once
def make_grid_touch(real: Any, rows: Rows):
    """Single-thread kernel: finds points that touch material, and applies the last impulses.

    `fill` is the volume fraction per mass at a node. For each listed point, `gap_out` receives the
    normal of the material and the distance from the material (infinite if out of reach). `on_out`
    receives the point's position in units of nodes, and sum w_i m_i. `yields_out` receives the
    change of the relative velocity per unit impulse. Impulses do not change the velocity of fixed
    material (`moves` is 0).

    Contact with a point begins at the distance `space_out` from the material. This value is -inf
    until the point is near the material for the first time. A point that is inside the material at
    that time, to a depth of at most `DEEPEST`, keeps its depth until it leaves the material,
    because moving the point out would create energy. If `starts` is 1, points that touch the
    material keep their present distance.
    """
    t = types(real)
    moved_by, yielding, strike = rows.moved_by, rows.yielding, rows.strike

    @kernel(f"phy124_lattice_grid_touch_{rows.name}{real.__name__}", real, seconds=0.8)
    def grid_touch(
        near,
        count,
        fill: real,
        moves: int,
        starts: int,
        nodes,
        weights,
        rest,
        normal,
        inverse,
        u,
        clock,
        lattice,
        window,
        grid,
        space_out: t.reals,
        v_out,
        gap_out,
        on_out: t.vec4s,
        place_out,
        yields_out,
        force_out,
    ):
        zero = real(0.0)
        for a in range(count):
            s = near[a]
            y = rest[s] + moved_by(u, nodes, weights, s)
            place_out[s] = y
            f = (y - xyz(lattice)) / lattice[3]
            first = first_node(f)
            wx = spline(f[0] - real(first[0]))
            wy = spline(f[1] - real(first[1]))
            wz = spline(f[2] - real(first[2]))
            sx = slope(f[0] - real(first[0]))
            sy = slope(f[1] - real(first[1]))
            sz = slope(f[2] - real(first[2]))
            mass = zero
            squares = zero
            grad = t.vec3()
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        m = mass_at(grid, window, first + wp.vec3i(i, j, k))
                        if m > zero:
                            w = wx[i] * wy[j] * wz[k]
                            mass += w * m
                            squares += w * w * m
                            grad += m * wp.vector(
                                sx[i] * wy[j] * wz[k], wx[i] * sy[j] * wz[k], wx[i] * wy[j] * sz[k]
                            )
            part = fill * mass
            steep = fill * wp.length(grad)
            gap_out[s] = wp.vector(zero, zero, zero, real(wp.inf))
            yields_out[s] = yielding(inverse, nodes, weights, s)
            if moves == 1 and mass > zero:
                yields_out[s] = yields_out[s] + squares / (mass * mass)
            if part > real(THINNEST) and steep > real(STEEPEST) and yields_out[s] > zero:
                n = -wp.normalize(grad)
                far = (real(SURFACE) - part) / steep * lattice[3]
                if wp.isinf(space_out[s]) or (space_out[s] < zero and far > zero):
                    space_out[s] = wp.clamp(far, -real(DEEPEST) * lattice[3], zero)
                cosine = reversed_cosine(normal[s], n)
                if starts == 1 and touches_at_start(far / lattice[3], cosine):
                    space_out[s] = far + real(INSIDE) * lattice[3]
                gap_out[s] = wp.vector(n[0], n[1], n[2], far - space_out[s])
                on_out[s] = wp.vector(f[0], f[1], f[2], mass)
                impulse = clock[0] * force_out[s]
                if wp.dot(impulse, impulse) > zero:
                    strike(v_out, inverse, nodes, weights, s, impulse)
                    if moves == 1:
                        push_back(grid, window, on_out[s], impulse)
            else:
                force_out[s] = t.vec3()

    return grid_touch


@wp.func
def reversed_cosine(normal: Any, n: Any):
    """Return the cosine of the angle between -`normal` and n; 1 if `normal` is zero."""
    if wp.length(normal) == type(n[0])(0.0):
        return type(n[0])(1.0)
    return -wp.dot(normal, n)


@wp.func
def push_back(grid: wp.array(dtype=Any), window: wp.array(dtype=wp.vec3i), on: Any, impulse: Any):
    """Apply the opposite of an impulse [N s] to the nodes of the grid around a surface point."""
    first = first_node(on)
    wx = spline(on[0] - type(on[0])(first[0]))
    wy = spline(on[1] - type(on[0])(first[1]))
    wz = spline(on[2] - type(on[0])(first[2]))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                node = first + wp.vec3i(i, j, k)
                if mass_at(grid, window, node) > type(on[0])(0.0):
                    index = wp.dot(node - window[0], strides(window[1]))
                    part = wx[i] * wy[j] * wz[k] / on[3]
                    q = grid[index]
                    grid[index] = wp.vector(
                        q[0] - part * impulse[0], q[1] - part * impulse[1],
                        q[2] - part * impulse[2], q[3],
                    )  # fmt: skip


@wp.func
def mean_velocity(grid: wp.array(dtype=Any), window: wp.array(dtype=wp.vec3i), on: Any):
    """Return the mass-weighted mean velocity of the grid's nodes around a surface point."""
    first = first_node(on)
    wx = spline(on[0] - type(on[0])(first[0]))
    wy = spline(on[1] - type(on[0])(first[1]))
    wz = spline(on[2] - type(on[0])(first[2]))
    total = xyz(on) - xyz(on)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                node = first + wp.vec3i(i, j, k)
                m = mass_at(grid, window, node)
                if m > type(on[0])(0.0):
                    q = grid[wp.dot(node - window[0], strides(window[1]))]
                    total += (wx[i] * wy[j] * wz[k] * m) * xyz(q)
    return total / on[3]


@build_once
def make_grid_resist(sticky: bool, real: Any, rows: Rows):
    """Single-thread kernel: a forward and a backward Gauss-Seidel sweep over points and grid."""
    t = types(real)
    moved_by, strike = rows.moved_by, rows.strike
    kind = "sticky" if sticky else "separate"
    limit = LIMITS[kind]

    @kernel(f"phy124_lattice_grid_resist_{kind}_{rows.name}{real.__name__}", real, seconds=0.8)
    def grid_resist(
        near,
        count,
        restore,
        friction,
        moves: int,
        nodes,
        weights,
        inverse,
        gap,
        on: t.vec4s,
        yields,
        clock,
        window,
        grid,
        v_out,
        force_out,
    ):
        zero = real(0.0)
        for b in range(2 * count):
            s = near[there_and_back(b, count)]
            g = gap[s]
            if not wp.isinf(g[3]) and clock[0] > zero:
                relative = moved_by(v_out, nodes, weights, s)
                if moves == 1:
                    relative -= mean_velocity(grid, window, on[s])
                last = clock[0] * force_out[s]
                part = real(RELAXED) / yields[s]
                press, pressed, drag = correct(relative, last, g, part, restore, clock)
                impulse = limit(press, pressed, drag, xyz(g), g[3], friction)
                change = impulse - last
                force_out[s] = impulse / clock[0]
                if wp.dot(change, change) > zero:
                    strike(v_out, inverse, nodes, weights, s, change)
                    if moves == 1:
                        push_back(grid, window, on[s], change)

    return grid_resist


@build_once
def make_grid_sum(real: Any):
    """Single-thread kernel: adds the points' impulses and moments to the sums of each body."""

    @kernel(f"phy124_lattice_grid_sum_{real.__name__}", real, seconds=0.3)
    def grid_sum(near, count, body: Ints, place, force, clock, sums_out):
        for a in range(count):
            s = near[a]
            impulse = wide(clock[0] * force[s])
            if wp.dot(impulse, impulse) > wp.float64(0.0):
                at = wp.static(PAIR_SUMS) * body[s]
                add3(sums_out, at, impulse)
                add3(sums_out, at + wp.static(PAIR_MOMENT), wp.cross(wide(place[s]), impulse))

    return grid_sum
