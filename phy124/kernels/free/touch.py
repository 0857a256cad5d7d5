"""Where a free body touches material, and the normal there."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.collide import holds, strides, xyz
from phy124.kernels.columns import covered
from phy124.kernels.diagnostics import wide
from phy124.kernels.distance import SHAPES
from phy124.kernels.free.numbers import arm_of, axes, first_node
from phy124.kernels.pairs import filled, met, outward
from phy124.kernels.transfer import types

STEEP = wp.constant(1e-4)
"""Slope of a box's volume [1/cell] below which the nearest face has the normal."""


@wp.func
def volume_of_round(d: Any, s: Any, geometry: Any, dx: Any):
    """Normal, and fraction of the volume around a node that a round body fills, as if flat."""
    return wp.vector(s[0], s[1], s[2], covered(-s[3] / dx))


@wp.func
def weight(u: Any):
    """A quadratic B-spline u cells from its centre."""
    far = wp.max(type(u)(1.5) - wp.abs(u), type(u)(0.0))
    if wp.abs(u) < type(u)(0.5):
        return type(u)(0.75) - u * u
    return type(u)(0.5) * far * far


@wp.func
def volume_of_box(d: Any, s: Any, geometry: Any, dx: Any):
    """Normal, and fraction of the volume around a node that a box fills; the normal is where the
    fraction falls, so that it turns at an edge and does not jump.
    """
    fill = type(dx)(1.0)
    n = d - d
    for c in range(3):
        u = (wp.abs(d[c]) - geometry[1, c]) / dx
        part = covered(-u)
        fill *= part
        n[c] = wp.sign(d[c]) * weight(u) / wp.max(part, type(dx)(1e-6))
    if wp.length(n) < type(dx)(STEEP):
        n = xyz(s)
    n = wp.normalize(n)
    return wp.vector(n[0], n[1], n[2], fill)


@cache
def make_touch(shape: str, real: Any):
    """Kernel over the nodes around a body: where it touches material, and the normal there.

    Surfaces meet as those of two bodies of particles do, where they fill the nodes between them
    (phy124/kernels/pairs.py); what the solid fills is known. `fill` is the volume fraction per mass
    at a node of the material.
    """
    t = types(real)
    distance = SHAPES[shape]
    volume = volume_of_box if shape == "box" else volume_of_round

    @kernel(f"phy124_free_touch_{shape}_{real.__name__}", seconds=0.5)
    def touch(
        # model
        geometry: t.mat33, reach: int, fill: real, lattice: t.vec4,
        window: wp.array(dtype=wp.vec3i),
        # state in
        body: wp.array(dtype=wp.float64), grid: wp.array(dtype=t.vec4),
        # out
        contact_out: wp.array3d(dtype=t.vec4),
    ):  # fmt: skip
        i, j, k = wp.tid()
        node = first_node(body, lattice, reach) + wp.vec3i(i, j, k)
        here = t.vec4()
        at = node - window[0]
        size = window[1]
        if holds(size, wp.vec2i(0, size[0]), at):
            if grid[wp.dot(at, strides(size))][3] > real(0.0):
                R = axes(body)
                own = wp.transpose(R) @ arm_of(body, lattice, node)
                d = t.vec3(real(own[0]), real(own[1]), real(own[2]))
                s = distance(d, geometry)
                if s[3] < real(1.5) * lattice[3]:
                    q = volume(d, s, geometry, lattice[3])
                    m = R @ wide(q)
                    n = t.vec3(real(m[0]), real(m[1]), real(m[2]))
                    inside = filled(grid, window, node, outward(n), fill)
                    if met(q[3], inside):
                        here = t.vec4(n[0], n[1], n[2], real(1.0))
        contact_out[i, j, k] = here

    return touch
