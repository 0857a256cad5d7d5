"""Response of columns of nodes to a wall; a column consists of three successive nodes at the wall.

The projection of a column's momentum is v_1 = sum(g m v) / sum(g^2 m), where g is the ratio of a
node's distance from the wall to the first node's distance. Without the projection, a wall is as
compliant as a layer of material one cell thick. B-splines with linear values behind the wall are
called extended B-splines (Hoellig, Reif, Wipper 2001). docs/design/contact.md explains the method.
"""

from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.transfer import spline


@wp.func
def sticky(v: Any, wall: Any, n: Any, friction: Any):
    """Return the wall's velocity."""
    return wall


@wp.func
def slip(v: Any, wall: Any, n: Any, friction: Any):
    """Return the velocity without its normal component relative to the wall."""
    return v - wp.dot(v - wall, n) * n


@wp.func
def separate(v: Any, wall: Any, n: Any, friction: Any):
    """Return the velocity after contact with friction that allows separation (Stomakhin et al.
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
"""Exponent in `narrow`. The best exponent is 1.1 to 1.3 for a body that narrows to an edge, and 1.2
to 1.6 for a cone.
"""
OUT_OF_REACH = wp.constant(-1.25)
"""Signed distance [cells] behind a wall at which a node gets no mass from a body in front. The
particles of a touching body are at least a quarter of a cell in front of the wall.
"""


@wp.func
def coverage(u: Any):
    """Return the fraction of a quadratic B-spline beyond a plane u cells before its centre."""
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
    """Return the first three components of a vector."""
    return wp.vector(q[0], q[1], q[2])


@wp.func
def relative(q0: Any, q1: Any, q2: Any, wall: Any):
    """Return the velocities of the three nodes of a column relative to a wall [node, axis]."""
    return wp.matrix_from_rows(xyz(q0) - wall, xyz(q1) - wall, xyz(q2) - wall)


@wp.func
def narrow(m: Any, farther: Any, u: Any):
    """Return the factor by which a body's taper reduces its mass on the next node towards a wall.

    `m` is the body's mass on a node u cells in front of the wall, and `farther` the mass on the
    next node away from the wall. If the cross-section grows with a power of the distance, the ratio
    of these masses is smaller by a factor f than for a constant cross-section. The next ratio
    towards the wall is then smaller by about f to the power of `NARROWING`.
    """
    unit = type(u)(1.0)
    return wp.pow(
        wp.min(m * coverage(u + unit) / (farther * coverage(u)), unit), type(u)(NARROWING)
    )


@wp.func
def has_arrived(m: Any, above: Any, beyond: Any, u: Any, lightest: Any, full: Any):
    """Return whether material touches a wall, from the masses m of nodes at the distances u
    [cells].

    Material touches the wall if the node nearest to the wall has the fraction `full` of the
    expected mass (docs/design/contact.md). If the whole mass were required, the body would rest on
    the few columns with most mass. `above` is the mass in front of the three nodes, and `beyond`
    the mass behind them. The mass of the farther node is limited to the mass of a full node of the
    `lightest` material, since heavier material may lie on the body.
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
    """Return the ratios g for velocities that are linear in the distance and zero on the wall."""
    return distances / distances[0]


@wp.func
def ending(distances: Any, across: Any):
    """Return the ratios g for which the velocity is zero at the surface of a clamp's region.

    `across` is the cell size [m].
    """
    unit = type(across)(1.0)
    w = spline(distances[0] / across)
    return wp.vector(unit, -w[0] / w[1], type(across)(0.0))


@wp.func
def tie(v: Any, m: Any, g: Any):
    """Return the velocity changes [node, axis] of a column of nodes that preserve its momentum.

    g are the ratios of the new velocities to the first node's velocity; m are masses.
    """
    weight = wp.cw_mul(g, m)
    return wp.outer(g, (wp.transpose(v) @ weight) / wp.dot(weight, g)) - v


@wp.func
def hold_back(behind: Any, front: Any, normal: Any):
    """Return the velocity change that slows a node behind a wall to the speed of a node in front.

    The change never accelerates a node, so it adds no energy.
    """
    zero = type(normal[0])(0.0)
    fastest = wp.min(wp.dot(front, normal), zero)
    return wp.max(fastest - wp.dot(behind, normal), zero) * normal


@wp.func
def along_wall(change: Any, normal: Any):
    """Return the component along a wall of velocity changes [node, axis]."""
    return change - wp.outer(change * normal, normal)


@wp.func
def pressing(pressed: Any):
    """Return whether material presses on a wall that material may leave."""
    return pressed > type(pressed)(0.0)


@wp.func
def either_way(pressed: Any):
    """Return True, for walls that material cannot leave."""
    return True


@wp.func
def add_rows(nodes: wp.array(dtype=Any), first: int, step: int, m: Any, change: Any, fourth: Any):
    """Add velocity changes [node, axis] to the nodes with mass, and `fourth` to their fourth
    component.
    """
    for row in range(3):
        if m[row] > type(m[row])(0.0):
            nodes[first + row * step] += wp.vector(
                change[row, 0], change[row, 1], change[row, 2], fourth
            )


class Response(NamedTuple):
    """Functions that define how single nodes and columns of three nodes respond to a wall."""

    answer: Any
    """`(v, wall, n, friction)`: new velocity of a single node near a wall."""
    acts: Any
    """`(m, above, beyond, u, lightest, full)`: whether material touches a wall (`has_arrived`)."""
    ratios: Any
    """`(distances, across) -> g`: a column's velocities relative to the first node's velocity."""
    pushes: Any
    """`(pressed)`: whether a wall acts on a column with this normal impulse per mass."""
    hold: Any
    """`(along, pressed, friction)`: fraction of a column's tangential motion that a wall stops."""


RESPONSES = {
    "sticky": Response(sticky, has_arrived, linear, either_way, all_of_it),
    "slip": Response(slip, has_arrived, linear, either_way, none_of_it),
    "separate": Response(separate, has_arrived, linear, pressing, coulomb),
    "held": Response(sticky, has_mass, ending, either_way, all_of_it),
}
