"""Sums the forces and moments of pressures on solids, and computes how the solids respond."""

import warp as wp

from phy124.kernels.arguments import Doubles, Ints
from phy124.kernels.build import kernel
from phy124.kernels.liquid.listed import Table, Vectors, count_of, share, total

RIGID = wp.constant(5)
"""Row of the table of sums (`conjugate`) at which the first solid begins. Each solid has six rows:
the force and the moment J^T s (`solids`).
"""


@wp.func
def rigid_sums(sums: Table, solid: int):
    """Return the force and the moment on a solid that a vector of pressures exerts."""
    row = RIGID + 6 * solid
    return (
        wp.vec3d(total(sums, row), total(sums, row + 1), total(sums, row + 2)),
        wp.vec3d(total(sums, row + 3), total(sums, row + 4), total(sums, row + 5)),
    )


@wp.func
def clear_rigid(sums: Table, solids: int, p: int):
    """Set the forces and moments of part `p` of the list of cells to zero."""
    for k in range(6 * solids):
        sums[RIGID + k, p] = wp.float64(0.0)


@wp.func
def add_rigid(sums: Table, solid: int, p: int, force: wp.vec3d, turn: wp.vec3d):
    """Add a force and a moment on a solid to the sums of part `p` of the list of cells."""
    row = RIGID + 6 * solid
    for axis in range(3):
        sums[row + axis, p] += force[axis]
        sums[row + 3 + axis, p] += turn[axis]


@wp.func
def rotation_of(mobility: Table, solid: int, turn: wp.vec3d):
    """Return the change of a solid's angular velocity due to a moment."""
    w = wp.vec3d()
    for a in range(3):
        for b in range(3):
            w[a] += mobility[solid, 1 + 3 * a + b] * turn[b]
    return w


@wp.func
def respond(sums: Table, mobility: Table, p: int, responses: wp.array2d(dtype=wp.vec3d)):
    """Write the velocity and the angular velocity that a vector of pressures gives to each solid.

    Returns the sum, over all solids, of velocity times force and angular velocity times moment.
    """
    product = wp.float64(0.0)
    for solid in range(mobility.shape[0]):
        force, turn = rigid_sums(sums, solid)
        V = mobility[solid, 0] * force
        w = rotation_of(mobility, solid, turn)
        responses[p, 2 * solid] = V
        responses[p, 2 * solid + 1] = w
        product += wp.dot(force, V) + wp.dot(turn, w)
    return product


@wp.func
def rigid_flux(
    n: int,
    p: int,
    solid: int,
    jumps: Vectors,
    turns: Vectors,
    responses: wp.array2d(dtype=wp.vec3d),
):
    """Return the flux out of a cell due to the motion of a solid in response to pressures."""
    V = wp.dot(jumps[n], responses[p, 2 * solid])
    return V + wp.dot(turns[n], responses[p, 2 * solid + 1])


@kernel("phy124_liquid_project", seconds=0.2)
def project(
    part: int,
    solids: int,
    counts: Ints,
    listed: Ints,
    which: Ints,
    jumps: Vectors,
    turns: Vectors,
    x: Doubles,
    sums_out: Table,
):
    """Sum the forces and moments J^T x on solids over a part of the list of cells.

    `jumps` and `turns` contain the rows of J.
    """
    p = part + wp.tid()
    span = share(count_of(counts), p, counts.shape[0])
    clear_rigid(sums_out, solids, p)
    for k in range(span[0], span[1]):
        n = listed[k]
        if which[n] >= 0:
            add_rigid(sums_out, which[n], p, x[n] * jumps[n], x[n] * turns[n])
