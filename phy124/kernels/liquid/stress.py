"""Solves the viscous equation by conjugate gradients with the diagonal as preconditioner.

The matrix is not stored. The product of the matrix with velocities u is m u minus the divergence of
the stress. It is computed in two passes: from velocities to stresses, and from stresses to faces
(viscous.py).
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.conjugate import RESIDUAL, RIGHT, STEEP
from phy124.kernels.liquid.faces import stride
from phy124.kernels.liquid.listed import Table, Vectors, count_of, quotient, share, total


@wp.func
def reaction(
    n: int,
    size: wp.vec3i,
    first: wp.array(dtype=Any),
    second: wp.array(dtype=Any),
    normal: Vectors,
    shear: Vectors,
):
    """Return minus the viscous impulse on the low faces of a cell, from the stresses."""
    here = item(normal, n)
    edges = item(shear, n)
    a = item(first, n)
    b = item(second, n)
    force = wp.vec3d()
    for axis in range(3):
        step = stride(axis, size)
        f = item(normal, n - step)[axis] - here[axis]
        # The edges that are parallel to the axes c and d.
        c = (axis + 2) % 3
        d = (axis + 1) % 3
        m = n + stride(d, size)
        f += wp.float64(a[c]) * edges[c] - wp.float64(item(first, m)[c]) * item(shear, m)[c]
        m = n + stride(c, size)
        f += wp.float64(b[d]) * edges[d] - wp.float64(item(second, m)[d]) * item(shear, m)[d]
        force[axis] = f
    return force


@build_once
def make_strain(real: Any):
    """Kernel over parts of the list of cells: computes the direction s = z + beta s, and its
    stresses.

    If `begun` is 0, the direction is z.
    """
    t = types(real)

    @kernel(f"phy124_liquid_strain_{real.__name__}", real, seconds=0.4)
    def strain(
        part,
        turn: int,
        begun: int,
        window,
        counts,
        listed,
        stretch: t.vec3s,
        first: t.vec3s,
        second: t.vec3s,
        sums: Table,
        z: Vectors,
        before: Vectors,
        direction_out: Vectors,
        normal_out: Vectors,
        shear_out: Vectors,
    ):
        p = part + wp.tid()
        span = share(count_of(counts), p, counts.shape[0])
        size = window[1]
        beta = wp.float64(0.0)
        if begun > 0:
            beta = quotient(sums, turn, total(sums, 1 - turn))
        for k in range(span[0], span[1]):
            n = item(listed, k)
            here = item(z, n) + beta * item(before, n)
            direction_out[n] = here
            weight = item(stretch, n)
            a = item(first, n)
            b = item(second, n)
            normal = wp.vec3d()
            shear = wp.vec3d()
            for axis in range(3):
                m = n + stride(axis, size)
                above = item(z, m)[axis] + beta * item(before, m)[axis]
                normal[axis] = wp.float64(weight[axis]) * (above - here[axis])
                c = (axis + 2) % 3
                d = (axis + 1) % 3
                m = n - stride(axis, size)
                # Differences along `axis` of the components c and d.
                low = item(z, m) + beta * item(before, m)
                shear[d] = shear[d] + wp.float64(a[d]) * (here[c] - low[c])
                shear[c] = shear[c] + wp.float64(b[c]) * (here[d] - low[d])
            normal_out[n] = normal
            shear_out[n] = shear

    return strain


@build_once
def make_start(real: Any):
    """Kernel over parts of the list of cells: computes the residual and the preconditioner.

    The old velocities u are the initial guess; `normal` and `shear` are their stresses.
    """
    t = types(real)

    @kernel(f"phy124_liquid_start_{real.__name__}", real, seconds=0.4)
    def start(
        part,
        window,
        counts,
        listed,
        states,
        masses: t.vec3s,
        stretch: t.vec3s,
        first: t.vec3s,
        second: t.vec3s,
        normal: Vectors,
        shear: Vectors,
        u: Vectors,
        inverse_out: Vectors,
        residual_out: Vectors,
        z_out: Vectors,
        sums_out: Table,
    ):
        p = part + wp.tid()
        span = share(count_of(counts), p, counts.shape[0])
        size = window[1]
        largest = wp.float64(0.0)
        right = wp.float64(0.0)
        product = wp.float64(0.0)
        for k in range(span[0], span[1]):
            n = item(listed, k)
            force = reaction(n, size, first, second, normal, shear)
            inverse = wp.vec3d()
            residual = wp.vec3d()
            for axis in range(3):
                # A moving wall can drive liquid at rest; its faces count as those of full cells.
                momentum = wp.abs(item(u, n)[axis])
                if item(states, n) & (1 << axis) > 0:
                    c = (axis + 2) % 3
                    d = (axis + 1) % 3
                    total = item(masses, n)[axis] + item(stretch, n)[axis]
                    total += item(stretch, n - stride(axis, size))[axis]
                    for side in range(2):
                        g = item(first, n + side * stride(d, size))[c]
                        total += g * g
                        g = item(second, n + side * stride(c, size))[d]
                        total += g * g
                    if total > real(0.0):
                        inverse[axis] = wp.float64(1.0) / wp.float64(total)
                        residual[axis] = -force[axis]
                    momentum *= wp.float64(item(masses, n)[axis])
                    largest = wp.max(largest, wp.abs(residual[axis]))
                right = wp.max(right, momentum)
            z = wp.cw_mul(inverse, residual)
            product += wp.dot(z, residual)
            inverse_out[n] = inverse
            residual_out[n] = residual
            z_out[n] = z
        sums_out[0, p] = product
        sums_out[1, p] = wp.float64(0.0)
        sums_out[RESIDUAL, p] = largest
        sums_out[RIGHT, p] = right

    return start


@build_once
def make_multiply(real: Any):
    """Kernel over parts of the list of cells: computes A s, and sums s A s."""
    t = types(real)

    @kernel(f"phy124_liquid_multiply_{real.__name__}", real, seconds=0.3)
    def multiply(
        part,
        window,
        counts,
        listed,
        masses: t.vec3s,
        first: t.vec3s,
        second: t.vec3s,
        normal: Vectors,
        shear: Vectors,
        direction: Vectors,
        product_out: Vectors,
        sums_out: Table,
    ):
        p = part + wp.tid()
        span = share(count_of(counts), p, counts.shape[0])
        size = window[1]
        steep = wp.float64(0.0)
        for k in range(span[0], span[1]):
            n = item(listed, k)
            mass = item(masses, n)
            s = item(direction, n)
            weight = wp.vec3d(wp.float64(mass[0]), wp.float64(mass[1]), wp.float64(mass[2]))
            product = reaction(n, size, first, second, normal, shear) + wp.cw_mul(weight, s)
            product_out[n] = product
            steep += wp.dot(product, s)
        sums_out[STEEP, p] = steep

    return multiply


@kernel("phy124_liquid_relax", seconds=0.2)
def relax(
    part: int,
    turn: int,
    counts: Ints,
    listed: Ints,
    inverse: Vectors,
    direction: Vectors,
    u_out: Vectors,
    residual_out: Vectors,
    product_out: Vectors,
    sums_out: Table,
):
    """Take a step along s in parts of the list of cells, and precondition the residual.

    `product_out` contains A s, and receives the preconditioned residual. The residuals of faces
    with prescribed velocities stay zero, because their `inverse` is zero.
    """
    p = part + wp.tid()
    span = share(count_of(counts), p, counts.shape[0])
    alpha = quotient(sums_out, turn, total(sums_out, STEEP))
    largest = wp.float64(0.0)
    product = wp.float64(0.0)
    for k in range(span[0], span[1]):
        n = item(listed, k)
        scale = item(inverse, n)
        u_out[n] = u_out[n] + alpha * item(direction, n)
        r = residual_out[n] - alpha * product_out[n]
        z = wp.cw_mul(scale, r)
        residual_out[n] = r
        product_out[n] = z
        product += wp.dot(z, r)
        for axis in range(3):
            if scale[axis] > wp.float64(0.0):
                largest = wp.max(largest, wp.abs(r[axis]))
    sums_out[1 - turn, p] = product
    sums_out[RESIDUAL, p] = largest
