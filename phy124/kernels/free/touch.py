"""Finds the nodes at which a free body touches material, with the contact normals."""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import coverage, xyz
from phy124.kernels.diagnostics import wide
from phy124.kernels.distance import SHAPES
from phy124.kernels.free.numbers import arm_of, axes, first_node
from phy124.kernels.pairs import fill_fraction, is_closed, mass_at, neighbour, outward

NARROWEST = wp.constant(0.2)
"""Smallest volume fraction of a cell that counts as the interior of a body. With a smaller value,
the thin rim of a jelly next to the lower edge of a box would count as interior, and a light box
would hover one cell above the jelly.
"""
THINNEST = wp.constant(0.015)
"""A node is in contact only if the solid fills at least this fraction of the volume around the
node. One cell away from a flat side the fraction is 0.021. If nodes farther away took part in the
contact, a light box under load would creep.
"""
ROUND = wp.constant(0.6)
"""Factor on the contact tolerance `ROUNDING` for freely moving solids: their surface is sharp. The
factor is fitted to the contact of a ball with a box (docs/lab/contact-force.md).
"""
STEEP = wp.constant(1e-4)
"""Threshold for the slope of a box's volume fraction [1/cell]. Steeper slopes determine the contact
normal; otherwise, the normal of the nearest face is used.
"""


@wp.func
def volume_of_round(d: Any, s: Any, geometry: Any, dx: Any):
    """Return a flat surface's normal, and the fraction of a node's volume behind the surface."""
    return wp.vector(s[0], s[1], s[2], coverage(-s[3] / dx))


@wp.func
def weight(u: Any):
    """Return the value of a quadratic B-spline at u cells from its centre."""
    far = wp.max(type(u)(1.5) - wp.abs(u), type(u)(0.0))
    if wp.abs(u) < type(u)(0.5):
        return type(u)(0.75) - u * u
    return type(u)(0.5) * far * far


@wp.func
def volume_of_box(d: Any, s: Any, geometry: Any, dx: Any):
    """Return the contact normal of a box, and the fraction of a node's volume that the box fills.

    The normal is the direction of the steepest decrease of the fraction, and therefore turns
    continuously at an edge.
    """
    fill = type(dx)(1.0)
    n = d - d
    for c in range(3):
        u = (wp.abs(d[c]) - geometry[1, c]) / dx
        part = coverage(-u)
        fill *= part
        n[c] = wp.sign(d[c]) * weight(u) / wp.max(part, type(dx)(1e-6))
    if wp.length(n) < type(dx)(STEEP):
        n = xyz(s)
    n = wp.normalize(n)
    return wp.vector(n[0], n[1], n[2], fill)


@build_once
def make_touch(shape: str, real: Any):
    """Kernel over the nodes around a free body: finds the nodes in contact, and the contact
    normals.

    The criterion of contact is the same as between two particle bodies (phy124/kernels/pairs.py).
    `fill` is the volume fraction per mass at a node of the material.
    """
    t = types(real)
    distance = SHAPES[shape]
    volume = volume_of_box if shape == "box" else volume_of_round

    @wp.func
    def solid(node: wp.vec3i, geometry: Any, lattice: Any, body: wp.array(dtype=wp.float64)):
        """Return the contact normal, and the fraction of a node's volume that the body fills."""
        R = axes(body)
        local = wp.transpose(R) @ arm_of(body, lattice, node)
        d = t.vec3(real(local[0]), real(local[1]), real(local[2]))
        s = distance(d, geometry)
        if s[3] >= real(1.5) * lattice[3]:
            return t.vec4()
        q = volume(d, s, geometry, lattice[3])
        n = R @ wide(q)
        return t.vec4(real(n[0]), real(n[1]), real(n[2]), q[3])

    @wp.func
    def shared_most(
        node: wp.vec3i,
        step: wp.vec3i,
        geometry: Any,
        lattice: Any,
        body: wp.array(dtype=wp.float64),
        grid: wp.array(dtype=Any),
        window: wp.array(dtype=wp.vec3i),
    ):
        at = node
        most = real(0.0)
        for n in range(3):
            here = node + (n - 1) * step
            m = mass_at(grid, window, here)
            if m > real(0.0):
                q = solid(here, geometry, lattice, body)
                if q[3] * m > most:
                    most = q[3] * m
                    at = here
        return at

    @wp.func
    def gap(
        at: wp.vec3i,
        step: wp.vec3i,
        geometry: Any,
        lattice: Any,
        fill: Any,
        body: wp.array(dtype=wp.float64),
        grid: wp.array(dtype=Any),
        window: wp.array(dtype=wp.vec3i),
    ):
        """Return the empty fraction of the volume around a node; 1 without material or without the
        body.
        """
        inside = fill_fraction(grid, window, at, step, fill, type(fill)(NARROWEST))
        part = solid(at, geometry, lattice, body)[3]
        deep = part
        for n in range(2):
            deep = wp.max(deep, solid(at - (n + 1) * step, geometry, lattice, body)[3])
        unit = type(inside)(1.0)
        nothing = inside < type(inside)(0.0) or deep < type(inside)(NARROWEST)
        return wp.where(nothing, unit, unit - part - inside)

    @kernel(f"phy124_free_touch_{shape}_{real.__name__}", real, seconds=0.5)
    def touch(geometry, reach: int, fill: real, lattice, window, body, grid, contact_out):
        i, j, k = wp.tid()
        node = first_node(body, lattice, reach) + wp.vec3i(i, j, k)
        contact_out[i, j, k] = t.vec4()
        if mass_at(grid, window, node) <= real(0.0):
            return
        q = solid(node, geometry, lattice, body)
        if q[3] <= real(THINNEST):
            return
        step = outward(xyz(q))
        at = shared_most(node, step, geometry, lattice, body, grid, window)
        here = gap(at, step, geometry, lattice, fill, body, grid, window)
        more = real(0.0)
        for n in range(4):
            at_neighbour = shared_most(
                at + neighbour(step, n), step, geometry, lattice, body, grid, window
            )
            there = gap(at_neighbour, step, geometry, lattice, fill, body, grid, window)
            if there < real(1.0):
                more += there - here
        if is_closed(here, real(ROUND) * more):
            contact_out[i, j, k] = t.vec4(q[0], q[1], q[2], real(1.0))

    return touch
