"""The numbers of a free body and of a solution, and what follows from them."""

from typing import Any

import warp as wp

PLACE, TURN, VELOCITY, ANGULAR, KICKED, SIZE = 0, 3, 7, 10, 13, 14
"""Where the numbers of a body stand: X [m], q (wxyz), V [m/s], L [kg m^2/s], and whether V is that
of this substep yet; and how many they are."""
GUESS, PRIOR, WALLS, TRIAL = 0, 6, 12, 18
"""Where those of a solution stand: V and w, those before, and what walls give: impulse, moment."""
A, B, C, LINEAR, TURNING, SYSTEM = 0, 9, 18, 27, 30, 33
"""Where those of the six equations stand: blocks [3,3] of the matrix, and the right-hand side."""
IMPULSE, MOMENT, WORK, MOVED, TURNED, GIVEN = 0, 3, 6, 7, 8, 9
"""Where the sums of what nodes are given stand, as in phy124/kernels/work.py."""


@wp.func
def at3(values: wp.array(dtype=wp.float64), i: int):
    """Three numbers from an index on."""
    return wp.vec3d(values[i], values[i + 1], values[i + 2])


@wp.func
def put3(values: wp.array(dtype=wp.float64), i: int, a: wp.vec3d):
    """Set three numbers from an index on."""
    values[i] = a[0]
    values[i + 1] = a[1]
    values[i + 2] = a[2]


@wp.func
def at33(values: wp.array(dtype=wp.float64), i: int):
    """Nine numbers from an index on, row by row."""
    return wp.matrix_from_rows(at3(values, i), at3(values, i + 3), at3(values, i + 6))


@wp.func
def axes(body: wp.array(dtype=wp.float64)):
    """The body's own axes as columns."""
    w, x, y, z = body[TURN], body[TURN + 1], body[TURN + 2], body[TURN + 3]
    return wp.quat_to_matrix(wp.quatd(x, y, z, w))


@wp.func
def inertia_of(R: wp.mat33d, moments: wp.vec3d):
    """Tensor of inertia in the world's axes [kg m^2]."""
    return R @ wp.diag(moments) @ wp.transpose(R)


@wp.func
def spin_of(R: wp.mat33d, moments: wp.vec3d, L: wp.vec3d):
    """Angular velocity of an angular momentum [rad/s]."""
    return R @ wp.cw_div(wp.transpose(R) @ L, moments)


@wp.func
def turn_after(body: wp.array(dtype=wp.float64), w: wp.vec3d, dt: wp.float64):
    """The body's turn after `dt` s at an angular velocity."""
    angle = wp.length(w) * dt
    q = wp.quatd(body[TURN + 1], body[TURN + 2], body[TURN + 3], body[TURN])
    return wp.normalize(wp.quat_from_axis_angle(wp.normalize(w), angle) * q)


@wp.func
def put_turn(body: wp.array(dtype=wp.float64), q: wp.quatd):
    """Set the turn."""
    body[TURN] = q[3]
    put3(body, TURN + 1, wp.vec3d(q[0], q[1], q[2]))


@wp.func
def moving(trial: wp.array(dtype=wp.float64), which: int, r: wp.vec3d):
    """Velocity of a solution's body at r from its centre [m/s]."""
    return at3(trial, which) + wp.cross(at3(trial, which + 3), r)


@wp.func
def first_node(body: wp.array(dtype=wp.float64), lattice: Any, reach: int):
    """The lowest node of the lattice that a body may touch, `reach` nodes below its centre."""
    dx = wp.float64(lattice[3])
    return wp.vec3i(
        int(wp.floor((body[PLACE] - wp.float64(lattice[0])) / dx)) - reach,
        int(wp.floor((body[PLACE + 1] - wp.float64(lattice[1])) / dx)) - reach,
        int(wp.floor((body[PLACE + 2] - wp.float64(lattice[2])) / dx)) - reach,
    )


@wp.func
def arm_of(body: wp.array(dtype=wp.float64), lattice: Any, node: wp.vec3i):
    """From the body's centre to a node of the lattice [m]."""
    dx = wp.float64(lattice[3])
    origin = wp.vec3d(wp.float64(lattice[0]), wp.float64(lattice[1]), wp.float64(lattice[2]))
    at = wp.vec3d(wp.float64(node[0]), wp.float64(node[1]), wp.float64(node[2]))
    return origin + dx * at - at3(body, PLACE)
