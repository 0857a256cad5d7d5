"""Response of columns of nodes to a wall; a column is a row of three nodes at the wall.

Contact is enforced exactly at the wall, which may lie between nodes. Along the axis closest to the
wall's normal, the velocity relative to the wall is made linear in the distance and zero on the
wall. A column's first node is the node nearest to the wall among the nodes that are at least half a
cell in front of the wall. The other two nodes of a column are the next ones behind the first node.
A node's velocity is the first node's velocity times g, the ratio of the node's distance from the
wall to the first node's distance. Quadratic B-splines reproduce linear functions, and the splines
of nodes further behind do not reach the wall. Momentum is projected onto velocities that are linear
in this distance, v_1 = sum(g m v) / sum(g^2 m). The projection acts on all three nodes and never
adds energy. Without the projection, a wall is as compliant as a layer of material one cell thick.
B-splines with linear values behind the wall are called extended B-splines (Hoellig, Reif, Wipper
2001). The wall acts as soon as the material has reached it. The masses of the nodes on both sides
of the wall show when the material has reached it (see `coverage`).

The surface of a clamp's region is treated like a wall. The nodes inside the region are fixed. The
velocity of the node next to the surface is chosen so that the interpolated velocity is zero at the
surface. The ratios are g = (1, -w0 / w1, 0), where w are the weights of the nodes at the surface.

A single node responds by `sticky`, `slip` or `separate`. For a column, `all_of_it`, `none_of_it`
and `coulomb` return the fraction of the tangential motion that the wall stops.
"""

from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.transfer import spline


@wp.func
def sticky(v: Any, wall: Any, n: Any, friction: Any):
    """Return the wall's velocity, because the node sticks to the wall."""
    return wall


@wp.func
def slip(v: Any, wall: Any, n: Any, friction: Any):
    """Remove the normal velocity relative to the wall; do not change the tangential velocity."""
    return v - wp.dot(v - wall, n) * n


@wp.func
def separate(v: Any, wall: Any, n: Any, friction: Any):
    """Let a departing node leave the wall; stop any other node, with friction (Stomakhin et al.
    2013, sec. 8).
    """
    relative = v - wall
    speed = wp.dot(relative, n)
    if speed >= type(speed)(0.0):
        return v
    along = relative - speed * n
    length = wp.length(along)
    if length <= -friction * speed:
        return wall
    return wall + along * (type(speed)(1.0) + friction * speed / length)


@wp.func
def all_of_it(along: Any, pressed: Any, friction: Any):
    """Return 1: a sticky wall stops all tangential motion."""
    return type(pressed)(1.0)


@wp.func
def none_of_it(along: Any, pressed: Any, friction: Any):
    """Return 0: a wall without friction stops no tangential motion."""
    return type(pressed)(0.0)


@wp.func
def coulomb(along: Any, pressed: Any, friction: Any):
    """Return the fraction of the tangential motion that Coulomb friction can stop."""
    wanted = wp.length(along)
    if wanted <= friction * pressed:
        return type(pressed)(1.0)
    return friction * pressed / wanted


NARROWING = wp.constant(1.55)
"""Exponent in `narrow`, which estimates how much the mass of nodes falls towards a wall where a
body narrows. The best exponent is 1.1 to 1.3 for a body that narrows to an edge, and 1.2 to 1.6 for
a cone.
"""
OUT_OF_REACH = wp.constant(-1.25)
"""A node that lies farther behind a wall than this signed distance [cells] gets no mass from a body
in front of the wall. In a body that touches a wall, the particles nearest to the wall are a quarter
of a cell in front of it.
"""


@wp.func
def coverage(u: Any):
    """Return the part of a quadratic B-spline's integral that lies beyond a plane.

    The plane lies u cells before the spline's centre.
    """
    unit = type(u)(1.0)
    sixth = type(u)(1.0 / 6.0)
    reach = wp.max(type(u)(1.5) - wp.abs(u), type(u)(0.0))
    tail = sixth * reach * reach * reach
    if u < type(u)(-0.5):
        return tail
    if u > type(u)(0.5):
        return unit - tail
    return type(u)(0.5) + u * (type(u)(0.75) - u * u * type(u)(1.0 / 3.0))


@wp.func
def xyz(q: Any):
    """Return the first three components of a vector, for example a velocity, a normal or a track's
    value.
    """
    return wp.vector(q[0], q[1], q[2])


@wp.func
def relative(q0: Any, q1: Any, q2: Any, wall: Any):
    """Return the velocities of the three nodes of a column relative to a wall [node, axis]."""
    return wp.matrix_from_rows(xyz(q0) - wall, xyz(q1) - wall, xyz(q2) - wall)


@wp.func
def narrow(m: Any, farther: Any, u: Any):
    """Return the factor by which a body's mass on the next node towards a wall falls as the body
    narrows.

    `m` is the mass of the body on a node u cells in front of the wall, and `farther` is its mass on
    the next node away from the wall. For a body of constant cross-section, these masses have the
    same ratio as the values of `coverage`. If the cross-section grows with a power of the distance
    from the wall, the ratio is smaller by a factor f. The next ratio towards the wall is then
    smaller by about f to the power of `NARROWING`.
    """
    unit = type(u)(1.0)
    return wp.pow(
        wp.min(m * coverage(u + unit) / (farther * coverage(u)), unit), type(u)(NARROWING)
    )


@wp.func
def has_arrived(m: Any, above: Any, beyond: Any, u: Any, lightest: Any, full: Any):
    """Return whether material touches a wall, from the masses m of nodes at the distances u
    [cells].

    If a body touches the wall, the masses of the two nodes next to the wall have a known ratio,
    which does not depend on the body's density and width. If there is a gap, the nearer node has
    less mass. With irregular particles the ratio varies from column to column, so contact requires
    only the fraction `full` of the expected mass. If the whole mass were required, the body would
    rest on the few columns with most mass. Since heavier material may lie on the body, the mass of
    the farther node is limited to the mass of a full node of the `lightest` material.

    Tips, edges and hairs have less mass on the nearer node although they touch the wall. The
    narrowing of a tip is estimated one node farther from the wall. The narrowing at the third node
    is estimated from the first two nodes. If a body at the wall does not reach the third node, the
    first node and the node in front of it (mass `above`) are used instead. If there is mass behind
    the three nodes (`beyond`), material has passed through the wall.
    """
    zero = type(above)(0.0)
    if m[1] <= zero:
        return False
    behind = wp.min(m[0], lightest * coverage(u[0]))
    enough = full * behind * coverage(u[1])
    if m[1] * coverage(u[0]) >= enough:
        return True
    if beyond > zero:
        return True
    if u[2] > type(above)(OUT_OF_REACH):
        return m[2] * coverage(u[1]) >= full * m[1] * coverage(u[2]) * narrow(m[1], m[0], u[1])
    return above > zero and m[1] * coverage(u[0]) >= enough * narrow(m[0], above, u[0])


@wp.func
def has_mass(m: Any, above: Any, beyond: Any, u: Any, lightest: Any, full: Any):
    """Return whether the node next to the surface of a clamp's region has mass."""
    return not m[1] <= type(above)(0.0)


@wp.func
def linear(distances: Any, across: Any):
    """Return velocities in a column that are linear in the distance from the wall and zero on the
    wall.

    They are the ratios g to the velocity of the column's first node.
    """
    return distances / distances[0]


@wp.func
def ending(distances: Any, across: Any):
    """Return velocities in a column for which the velocity is zero at the surface of a clamp's
    region.

    They are the ratios g to the velocity of the column's first node.

    `across` is the cell size [m].
    """
    unit = type(across)(1.0)
    w = spline(distances[0] / across)
    return wp.vector(unit, -w[0] / w[1], type(across)(0.0))


@wp.func
def tie(v: Any, m: Any, g: Any):
    """Return the velocity changes [node, axis] of a column of nodes that preserve its momentum.

    The new velocities have the ratios g to the velocity of the first node; m are the masses of the
    nodes.
    """
    weight = wp.cw_mul(g, m)
    return wp.outer(g, (wp.transpose(v) @ weight) / wp.dot(weight, g)) - v


@wp.func
def hold_back(behind: Any, front: Any, normal: Any):
    """Return the velocity change that slows a node behind a wall to the speed of a node in front of
    it.

    The change never accelerates a node, so it never adds energy.
    """
    zero = type(normal[0])(0.0)
    fastest = wp.min(wp.dot(front, normal), zero)
    return wp.max(fastest - wp.dot(behind, normal), zero) * normal


@wp.func
def along_wall(change: Any, normal: Any):
    """Return the tangential component, along a wall, of the velocity changes of nodes
    [node, axis].
    """
    return change - wp.outer(change * normal, normal)


@wp.func
def pressing(pressed: Any):
    """Return whether material presses on a wall that material may leave."""
    return pressed > type(pressed)(0.0)


@wp.func
def either_way(pressed: Any):
    """Return True: the wall acts on both approaching and departing material."""
    return True


@wp.func
def add_rows(nodes: wp.array(dtype=Any), first: int, step: int, m: Any, change: Any, fourth: Any):
    """Add velocity changes [node, axis], and a fourth component, to the nodes of a column with
    mass.
    """
    for row in range(3):
        if m[row] > type(m[row])(0.0):
            nodes[first + row * step] += wp.vector(
                change[row, 0], change[row, 1], change[row, 2], fourth
            )


class Response(NamedTuple):
    """Functions that define how single nodes and columns of three nodes respond to a wall."""

    answer: Any
    """`(v, wall, n, friction)`: returns the new velocity of a single node near a wall."""
    acts: Any
    """`(m, above, beyond, u, lightest, full)`: returns whether material has reached a wall, from
    the masses `m` of the nodes at the distances `u` from the wall.
    """
    ratios: Any
    """`(distances, across) -> g`: returns the velocities of the three nodes of a column at a wall,
    as multiples of the velocity of the column's first node.
    """
    pushes: Any
    """`(pressed)`: returns whether a wall acts on a column of nodes; `pressed` is the impulse per
    mass along the wall's normal.
    """
    hold: Any
    """`(along, pressed, friction)`: returns the fraction of a column's tangential motion that a
    wall stops.
    """


RESPONSES = {
    "sticky": Response(sticky, has_arrived, linear, either_way, all_of_it),
    "slip": Response(slip, has_arrived, linear, either_way, none_of_it),
    "separate": Response(separate, has_arrived, linear, pressing, coulomb),
    "held": Response(sticky, has_mass, ending, either_way, all_of_it),
}
