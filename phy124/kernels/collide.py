"""Colliders: nodes inside a shape answer to its wall between the grid update and the gather.

Node n of the window sits at origin + (window[0] + (i, j, k)) dx. A collider is built from a
distance function and a response, so an absent shape or mode costs nothing.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.transfer import types


@wp.func
def sticky(v: Any, wall: Any, n: Any, friction: Any):
    """The node moves with the wall."""
    return wall


@wp.func
def slip(v: Any, wall: Any, n: Any, friction: Any):
    """No motion through or away from the wall, free motion along it."""
    return v - wp.dot(v - wall, n) * n


@wp.func
def separate(v: Any, wall: Any, n: Any, friction: Any):
    """May leave the wall; Coulomb friction while pressed on it (Stomakhin et al. 2013, sec. 8)."""
    relative = v - wall
    speed = wp.dot(relative, n)
    if speed >= type(speed)(0.0):
        return v
    along = relative - speed * n
    length = wp.length(along)
    if length <= -friction * speed:
        return wall
    return wall + along * (type(speed)(1.0) + friction * speed / length)


RESPONSES = {"sticky": sticky, "slip": slip, "separate": separate}


@wp.func
def half_space(x: Any, shape: Any):
    """Normal and signed distance of the plane through shape[0] with unit normal shape[1]."""
    n = shape[1]
    return wp.vector(n[0], n[1], n[2], wp.dot(x - shape[0], n))


@wp.func
def sphere(x: Any, shape: Any):
    """Normal and signed distance of the sphere about shape[0] with radius shape[1, 0]."""
    d = x - shape[0]
    r = wp.length(d)
    n = wp.vector(type(r)(0.0), type(r)(0.0), type(r)(1.0))
    if r > type(r)(0.0):
        n = d / r
    return wp.vector(n[0], n[1], n[2], r - shape[1, 0])


@wp.func
def box(x: Any, shape: Any):
    """Normal and signed distance (exact inside, per face) of the box shape[0] +- shape[1]."""
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
    """Normal and signed distance of the segment shape[0]-shape[1] with radius shape[2, 0]."""
    axis = shape[1] - shape[0]
    zero = type(x[0])(0.0)
    s = wp.clamp(wp.dot(x - shape[0], axis) / wp.dot(axis, axis), zero, type(x[0])(1.0))
    d = x - shape[0] - s * axis
    r = wp.length(d)
    n = wp.vector(zero, zero, type(r)(1.0))
    if r > zero:
        n = d / r
    return wp.vector(n[0], n[1], n[2], r - shape[2, 0])


SHAPES = {"half_space": half_space, "sphere": sphere, "box": box, "capsule": capsule}


@cache
def make_collider(shape: str, response: str, moving: bool, real: Any):
    """Kernel over the nodes of a sub-box: velocities inside a shape answer to its wall.

    A node counts as inside below `reach` m of signed distance. A moving shape is displaced by the
    value of its track and its wall moves at the track's rate, while the track is active.
    """
    t = types(real)
    distance, answer = SHAPES[shape], RESPONSES[response]
    name = f"phy124_collide_{shape}_{response}_{'moving' if moving else 'still'}_{real.__name__}"

    @wp.kernel(module=name, enable_backward=False)
    def collide(
        # model
        geometry: t.mat33, friction: real, reach: real, slot: int, start: wp.vec3i,
        lattice: t.vec4, window: wp.array(dtype=wp.vec3i),
        values: wp.array(dtype=t.vec4), rates: wp.array(dtype=t.vec4),
        # out
        grid_out: wp.array(dtype=t.vec4),
    ):  # fmt: skip
        i, j, k = wp.tid()
        size = window[1]
        i += start[0]
        j += start[1]
        k += start[2]
        if i < size[0] and j < size[1] and k < size[2]:
            n = (i * size[1] + j) * size[2] + k
            q = grid_out[n]
            low = window[0]
            x = wp.vector(
                lattice[0] + lattice[3] * real(low[0] + i),
                lattice[1] + lattice[3] * real(low[1] + j),
                lattice[2] + lattice[3] * real(low[2] + k),
            )
            wall = t.vec3()
            active = real(1.0)
            if wp.static(moving):
                here = values[slot]
                rate = rates[slot]
                x -= wp.vector(here[0], here[1], here[2])
                wall = wp.vector(rate[0], rate[1], rate[2])
                active = here[3]
            s = distance(x, geometry)
            if active > real(0.0) and q[3] > real(0.0) and s[3] < reach:
                v = answer(wp.vector(q[0], q[1], q[2]), wall, wp.vector(s[0], s[1], s[2]), friction)
                grid_out[n] = wp.vector(v[0], v[1], v[2], q[3])

    return collide
