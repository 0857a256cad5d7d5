"""Viscosity of a liquid: implicit diffusion of the face velocities, solved by Jacobi's method.

Let u be the new velocity of a face, u0 its old velocity, and u' the velocities of the neighbouring
faces. Then (1 + k sum g) u = u0 + k sum g u', with k = eta dt / (rho dx^2) and g = 1. Between two
liquids, eta is the harmonic mean. A sticky wall at the distance d counts as a neighbour with the
wall's velocity and g = dx / d. The coupling of the components at a surface is neglected (Batty and
Bridson 2008), so jets do not fold or coil correctly.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_of, entry, inner, stride, sums
from phy124.kernels.liquid.mixture import between
from phy124.kernels.liquid.spread import normal_at
from phy124.kernels.liquid.walls import centre_of, point, speed_of

CLOSEST = wp.constant(0.1)
"""Lower bound of a face's distance from a wall [cells]; a closer wall would take all momentum."""


@wp.func
def wall_link(
    n: int,
    axis: int,
    lattice: Any,
    window: wp.array(dtype=wp.vec3i),
    open: wp.array(dtype=Any),
    distances: wp.array(dtype=Any),
    owners: wp.array(dtype=int),
    frictions: wp.array(dtype=Any),
    motions: wp.array2d(dtype=Any),
):
    """Return the sum of g, the sum of g times the wall's velocity, and the index of a wall.

    The sums are over the walls next to a face. Only a sticky wall stops the tangential velocity
    components.
    """
    zero = type(item(open, n)[0])(0.0)
    size = window[1]
    g = type(zero)(0.0)
    gu = type(zero)(0.0)
    owner = int(-1)
    for along in range(3):
        for side in range(2):
            m = n + (2 * side - 1) * stride(along, size)
            if item(open, m)[axis] == zero:
                cell = cell_of(m, size)
                at = wp.vec3i(1, 1, 1)
                at[axis] = 0
                face = point(cell, at[0], at[1], at[2], size)
                wall = item(owners, face)
                if wall >= 0:
                    part = frictions[wall][1]
                    if along == axis:
                        normal = normal_at(distances, cell, at, size)[axis]
                        part = normal * normal
                    x = centre_of(cell, lattice, window[0])
                    x[axis] = x[axis] - type(zero)(0.5) * lattice[3]
                    unit = type(zero)(1.0)
                    near = unit + item(distances, face) / lattice[3]
                    part /= wp.clamp(near, type(zero)(CLOSEST), unit)
                    g += part
                    gu += part * speed_of(motions, wall, x)[axis]
                    if part > zero:
                        owner = wall
    return g, gu, owner


@build_once
def make_diffuse(real: Any):
    """Kernel over cells: one iteration of Jacobi's method, from one array of velocities to another.

    `known` contains a bit for each face with mass. `viscosity` is eta / (rho dx^2) [1/s] for a
    relative density and viscosity of 1.
    """
    t = types(real)

    @kernel(f"phy124_liquid_diffuse_{real.__name__}", real, seconds=0.4)
    def diffuse(
        worker: int,
        active: Ints,
        ends: Ints,
        viscosity: real,
        lattice,
        window,
        clock,
        known: Ints,
        densities: t.vec4s,
        viscosities: t.vec4s,
        open: t.vec4s,
        distances: t.reals,
        owners: Ints,
        frictions: t.vec2s,
        motions: wp.array2d(dtype=t.vec3),
        before: t.vec4s,
        velocity: t.vec4s,
        velocity_out: t.vec4s,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        v = before[n]
        mask = item(known, n)
        if mask > 0 and inner(cell_of(n, size), size, 1):
            for axis in range(3):
                bit = 1 << axis
                if mask & bit > 0:
                    k = viscosity * clock[0] / item(densities, n)[axis]
                    eta = item(viscosities, n)[axis]
                    total = v[axis]
                    weight = real(1.0)
                    for along in range(3):
                        step = stride(along, size)
                        for side in range(2):
                            m = n + (2 * side - 1) * step
                            if item(known, m) & bit > 0:
                                link = k * between(eta, item(viscosities, m)[axis])
                                total += link * item(velocity, m)[axis]
                                weight += link
                    g, gu, _ = wall_link(
                        n, axis, lattice, window, open, distances, owners, frictions, motions
                    )
                    v[axis] = (total + k * eta * gu) / (weight + k * eta * g)
        velocity_out[n] = v

    return diffuse


@build_once
def make_drag(real: Any):
    """Kernel over cells: copies the diffused velocities, and sums the drag of walls.

    On a face with mass m, a wall exerts the impulse m k (sum g u_wall - sum g u).
    """
    t = types(real)
    vec8 = sums(real)

    @kernel(f"phy124_liquid_drag_{real.__name__}", real, seconds=0.4)
    def drag(
        worker: int,
        active: Ints,
        ends: Ints,
        viscosity: real,
        lattice,
        window,
        clock,
        known: Ints,
        densities: t.vec4s,
        viscosities: t.vec4s,
        open: t.vec4s,
        distances: t.reals,
        owners: Ints,
        frictions: t.vec2s,
        motions: wp.array2d(dtype=t.vec3),
        cells: wp.array(dtype=vec8),
        velocity: t.vec4s,
        velocity_out: t.vec4s,
        sums_out: wp.array2d(dtype=wp.float64),
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        v = item(velocity, n)
        if item(known, n) > 0 and inner(cell_of(n, size), size, 1):
            for axis in range(3):
                if item(known, n) & (1 << axis) > 0:
                    g, gu, owner = wall_link(
                        n, axis, lattice, window, open, distances, owners, frictions, motions
                    )
                    if owner >= 0:
                        k = (
                            viscosity
                            * clock[0]
                            * item(viscosities, n)[axis]
                            / item(densities, n)[axis]
                        )
                        impulse = wp.float64(item(cells, n)[4 + axis] * k * (gu - g * v[axis]))
                        wp.atomic_add(sums_out, owner, axis, impulse)
                        wp.atomic_add(sums_out, owner, 6, impulse * wp.float64(v[axis]))
        velocity_out[n] = v

    return drag
