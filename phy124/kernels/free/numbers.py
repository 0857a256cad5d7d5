"""Reads and writes the state and the solution of a free body."""

from typing import Any

import warp as wp

PLACE, TURN, VELOCITY, ANGULAR, KICKED, SIZE = 0, 3, 7, 10, 13, 14
"""Offsets in the state of a free body: centre X [m], orientation q (wxyz), velocity V [m/s],
angular momentum L [kg m^2/s], and 1 if V includes the kick of this substep. `SIZE` is the state's
length.
"""
GUESS, PRIOR, WALLS, TRIAL = 0, 6, 12, 18
"""Offsets in a solution for a free body's motion: velocity V and angular velocity w, the previous V
and w, and the impulse and moment of the walls. `TRIAL` is the solution's length.
"""
A, B, C, LINEAR, TURNING, SYSTEM = 0, 9, 18, 27, 30, 33
"""Offsets in the six equations of motion: three [3,3] blocks, then the right-hand side."""
IMPULSE, MOMENT, WORK, MOVED, TURNED, EXCHANGE = 0, 3, 6, 7, 8, 9
"""Offsets of the sums of a free body's impulses on nodes, as in phy124/kernels/work.py."""


@wp.func
def at3(values: wp.array(dtype=wp.float64), i: int):
    """Return three consecutive numbers of an array as a vector."""
    return wp.vec3d(values[i], values[i + 1], values[i + 2])


@wp.func
def put3(values: wp.array(dtype=wp.float64), i: int, a: wp.vec3d):
    """Write a vector to three consecutive numbers of an array."""
    values[i] = a[0]
    values[i + 1] = a[1]
    values[i + 2] = a[2]


@wp.func
def at33(values: wp.array(dtype=wp.float64), i: int):
    """Return nine consecutive numbers of an array as a matrix, row by row."""
    return wp.matrix_from_rows(at3(values, i), at3(values, i + 3), at3(values, i + 6))


@wp.func
def axes(body: wp.array(dtype=wp.float64)):
    """Return the principal axes of a free body as columns."""
    w, x, y, z = body[TURN], body[TURN + 1], body[TURN + 2], body[TURN + 3]
    return wp.quat_to_matrix(wp.quatd(x, y, z, w))


@wp.func
def inertia_of(R: wp.mat33d, moments: wp.vec3d):
    """Return the inertia tensor of a free body in world axes [kg m^2]."""
    return R @ wp.diag(moments) @ wp.transpose(R)


@wp.func
def spin_of(R: wp.mat33d, moments: wp.vec3d, L: wp.vec3d):
    """Return the angular velocity [rad/s] of a body with a given angular momentum."""
    return R @ wp.cw_div(wp.transpose(R) @ L, moments)


@wp.func
def turn_after(body: wp.array(dtype=wp.float64), w: wp.vec3d, dt: wp.float64):
    """Return the orientation after a rotation for `dt` [s] at angular velocity w."""
    angle = wp.length(w) * dt
    q = wp.quatd(body[TURN + 1], body[TURN + 2], body[TURN + 3], body[TURN])
    return wp.normalize(wp.quat_from_axis_angle(wp.normalize(w), angle) * q)


@wp.func
def put_turn(body: wp.array(dtype=wp.float64), q: wp.quatd):
    """Write the orientation of a free body to its state."""
    body[TURN] = q[3]
    put3(body, TURN + 1, wp.vec3d(q[0], q[1], q[2]))


@wp.func
def moving(trial: wp.array(dtype=wp.float64), which: int, r: wp.vec3d):
    """Return the velocity [m/s] of a trial solution at a point r relative to the body's centre."""
    return at3(trial, which) + wp.cross(at3(trial, which + 3), r)


@wp.func
def first_node(body: wp.array(dtype=wp.float64), lattice: Any, reach: int):
    """Return the lowest node that a free body may touch, `reach` nodes below its centre."""
    dx = wp.float64(lattice[3])
    return wp.vec3i(
        int(wp.floor((body[PLACE] - wp.float64(lattice[0])) / dx)) - reach,
        int(wp.floor((body[PLACE + 1] - wp.float64(lattice[1])) / dx)) - reach,
        int(wp.floor((body[PLACE + 2] - wp.float64(lattice[2])) / dx)) - reach,
    )


@wp.func
def arm_of(body: wp.array(dtype=wp.float64), lattice: Any, node: wp.vec3i):
    """Return the vector from the centre of a free body to a node of the lattice [m]."""
    dx = wp.float64(lattice[3])
    origin = wp.vec3d(wp.float64(lattice[0]), wp.float64(lattice[1]), wp.float64(lattice[2]))
    at = wp.vec3d(wp.float64(node[0]), wp.float64(node[1]), wp.float64(node[2]))
    return origin + dx * at - at3(body, PLACE)
