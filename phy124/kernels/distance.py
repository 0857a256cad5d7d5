"""Signed distance from a point to a wall, and normal of the wall, for each shape.

Each function takes a point x [m] and three vectors that define the shape. The result is the unit
normal out of the solid, and the signed distance [m], negative inside the solid.
"""

from typing import Any

import warp as wp


@wp.func
def half_space(x: Any, shape: Any):
    """Plane through shape[0] with unit normal shape[1]."""
    n = shape[1]
    return wp.vector(n[0], n[1], n[2], wp.dot(x - shape[0], n))


@wp.func
def sphere(x: Any, shape: Any):
    """Sphere about shape[0] with radius shape[1, 0]."""
    d = x - shape[0]
    r = wp.length(d)
    n = wp.vector(type(r)(0.0), type(r)(0.0), type(r)(1.0))
    if r > type(r)(0.0):
        n = d / r
    return wp.vector(n[0], n[1], n[2], r - shape[1, 0])


@wp.func
def box(x: Any, shape: Any):
    """Box shape[0] +- shape[1].

    Outside the box, the distance is measured from the plane of the nearest face.
    """
    d = x - shape[0]
    out = wp.vector(
        wp.abs(d[0]) - shape[1, 0], wp.abs(d[1]) - shape[1, 1], wp.abs(d[2]) - shape[1, 2]
    )
    zero = type(d[0])(0.0)
    axis = int(0)
    if out[1] > out[axis]:
        axis = 1
    if out[2] > out[axis]:
        axis = 2
    side = wp.sign(d[axis])
    if axis == 0:
        return wp.vector(side, zero, zero, out[0])
    if axis == 1:
        return wp.vector(zero, side, zero, out[1])
    return wp.vector(zero, zero, side, out[2])


@wp.func
def capsule(x: Any, shape: Any):
    """Capsule from shape[0] to shape[1] with radius shape[2, 0]."""
    axis = shape[1] - shape[0]
    zero = type(x[0])(0.0)
    s = wp.clamp(wp.dot(x - shape[0], axis) / wp.dot(axis, axis), zero, type(x[0])(1.0))
    d = x - shape[0] - s * axis
    r = wp.length(d)
    n = wp.vector(zero, zero, type(r)(1.0))
    if r > zero:
        n = d / r
    return wp.vector(n[0], n[1], n[2], r - shape[2, 0])


@wp.func
def cylinder(x: Any, shape: Any):
    """Cylinder about shape[0] along shape[1], with shape[2] = (radius, half length, 0).

    The distance is measured from the nearest face.
    """
    d = x - shape[0]
    along = wp.dot(d, shape[1])
    across = d - along * shape[1]
    r = wp.length(across)
    cap = wp.abs(along) - shape[2, 1]
    n = wp.sign(along) * shape[1]
    if r - shape[2, 0] <= cap or r <= type(r)(0.0):
        return wp.vector(n[0], n[1], n[2], wp.max(cap, r - shape[2, 0]))
    n = across / r
    return wp.vector(n[0], n[1], n[2], r - shape[2, 0])


SHAPES = {
    "half_space": half_space,
    "sphere": sphere,
    "box": box,
    "capsule": capsule,
    "cylinder": cylinder,
}
