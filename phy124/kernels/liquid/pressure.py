"""Assembles the pressure equation, and makes the velocities divergence-free by the pressure.

The unknown is q = p dt / (rho dx) [m/s] with a reference density rho. A face's velocity changes by
the difference of q across the face, divided by its relative density. Walls are represented by the
open fractions of faces (Ng, Min and Gibou 2009). At the surface, p is zero where phi crosses zero
between two cells (ghost fluid: Enright et al. 2003; Gibou 2002). Each cell is slightly
compressible, since the equation would be singular in a closed volume without a surface.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_of, entry, inner, stride
from phy124.kernels.liquid.walls import centre_of, part_of_solid, speed_of, wall_across

NEAREST = wp.constant(0.02)
"""Lower bound of a cell centre's distance from the surface [cells]; limits the pressure."""
COMPRESSIBLE = wp.constant(1.0e-6)
"""Fraction by which the diagonal matrix entry is increased."""


@wp.func
def beyond(here: Any, there: Any):
    """Return the distance from a cell's centre to the surface, as a fraction of the cell
    spacing.
    """
    if here >= type(here)(0.0):
        return type(here)(NEAREST)
    apart = here - there
    if apart < type(here)(0.0):
        return wp.clamp(here / apart, type(here)(NEAREST), type(here)(1.0e3))
    return type(here)(1.0e3)


@build_once
def make_assemble(real: Any):
    """Kernel over cells: computes the symmetric positive matrix of the pressure equation.

    `diagonal_out` is zero in cells without liquid. `links_out` couples each cell to the next cell
    along each axis.
    """

    @kernel(f"phy124_liquid_assemble_{real.__name__}", real, seconds=0.4)
    def assemble(
        worker,
        active,
        ends,
        window,
        open,
        densities,
        phi,
        liquid,
        diagonal_out: Doubles,
        links_out: wp.array(dtype=wp.vec3d),
        inverse_out: Doubles,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        total = real(0.0)
        links = wp.vec3d()
        if item(liquid, n) == 1:
            for axis in range(3):
                step = stride(axis, size)
                for side in range(2):
                    m = n + step
                    face = n + step
                    if side == 0:
                        m = n - step
                        face = n
                    share = item(open, face)[axis]
                    if share > real(0.0):
                        share /= item(densities, face)[axis]
                        if item(liquid, m) == 1:
                            total += share
                            if side == 1:
                                links[axis] = -wp.float64(share)
                        else:
                            total += share / beyond(item(phi, n), item(phi, m))
            total += real(6.0) * real(COMPRESSIBLE)
        diagonal_out[n] = wp.float64(total)
        links_out[n] = links
        inverse_out[n] = wp.float64(0.0)

    return assemble


@wp.func
def outflow(
    n: int,
    moving: int,
    solid: int,
    lattice: Any,
    window: wp.array(dtype=wp.vec3i),
    motions: wp.array2d(dtype=Any),
    open: wp.array(dtype=Any),
    covers: wp.array(dtype=Any),
    distances: wp.array(dtype=Any),
    owners: wp.array(dtype=int),
    velocity: wp.array(dtype=Any),
):
    """Return the net flux out of a cell, relative to moving walls [m/s].

    `solid` is the index of the first wall that is a solid.
    """
    size = window[1]
    zero = type(lattice[3])(0.0)
    flux = type(zero)(0.0)
    cell = cell_of(n, size)
    for axis in range(3):
        m = n + stride(axis, size)
        low = item(open, n)[axis]
        high = item(open, m)[axis]
        flux += high * item(velocity, m)[axis] - low * item(velocity, n)[axis]
        jump = high - low
        if moving > 0:
            x = centre_of(cell, lattice, window[0])
            part = part_of_solid(jump, covers, n, stride(axis, size), axis)
            if part != zero:
                flux -= part * speed_of(motions, solid, x)[axis]
                jump -= part
            if jump != zero:
                owner = wall_across(cell, axis, jump, size, distances, owners, lattice[3])
                if owner >= 0:
                    flux -= jump * speed_of(motions, owner, x)[axis]
    return flux


@build_once
def make_divergence(real: Any):
    """Kernel over cells: computes the net flux into each cell relative to moving walls [m/s].

    `solid` is the index of the first wall that is a solid. The last solution, multiplied by
    `carry`, is the initial guess for the next solution.
    """

    @kernel(f"phy124_liquid_divergence_{real.__name__}", real, seconds=0.3)
    def divergence(
        worker,
        active,
        ends,
        moving: int,
        solid,
        lattice,
        window,
        motions,
        open,
        covers,
        distances,
        owners,
        liquid,
        carry: Doubles,
        velocity,
        right_out,
        x_out: Doubles,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        flux = real(0.0)
        if item(liquid, n) == 1:
            flux = outflow(
                n, moving, solid, lattice, window, motions, open, covers, distances, owners,
                velocity,
            )  # fmt: skip
        right_out[n] = -wp.float64(flux)
        guess = wp.float64(0.0)
        if item(liquid, n) == 1:
            guess = carry[0] * x_out[n]
        x_out[n] = guess

    return divergence


@wp.func
def rise_to(
    n: int,
    m: int,
    phi: wp.array(dtype=Any),
    liquid: wp.array(dtype=int),
    pressure: wp.array(dtype=wp.float64),
):
    """Return the increase of the pressure solution q from cell m to cell n; one may be empty."""
    rise = type(item(phi, n))(item(pressure, n) - item(pressure, m))
    if item(liquid, n) == 0:
        rise = -type(item(phi, n))(item(pressure, m)) / beyond(item(phi, m), item(phi, n))
    if item(liquid, m) == 0:
        rise = type(item(phi, n))(item(pressure, n)) / beyond(item(phi, n), item(phi, m))
    return rise


@build_once
def make_anticipate(real: Any):
    """Kernel over cells: adds `factor` times the last pressure differences to the face velocities.

    Viscosity then acts on velocities that include the pressure, as in a steady flow (incremental
    projection, Goda 1979). The differences are subtracted again before the next solution.
    """

    @kernel(f"phy124_liquid_anticipate_{real.__name__}", real, seconds=0.4)
    def anticipate(
        worker,
        active,
        ends,
        factor: real,
        window,
        open,
        densities,
        phi,
        liquid,
        carry: Doubles,
        pressure,
        velocity_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        if inner(cell_of(n, size), size, 1):
            v = velocity_out[n]
            for axis in range(3):
                m = n - stride(axis, size)
                if item(liquid, n) + item(liquid, m) > 0 and item(open, n)[axis] > real(0.0):
                    rise = rise_to(n, m, phi, liquid, pressure)
                    v[axis] = v[axis] + factor * real(carry[0]) * rise / item(densities, n)[axis]
            velocity_out[n] = v

    return anticipate


@build_once
def make_gradient(real: Any):
    """Kernel over cells: subtracts the pressure differences from the velocities at the low faces.

    If `shifts` is above 0, the kernel writes only the negated differences, as displacements [m] of
    at most `shifts` cells. `known_out` receives a bit for each open face that touches liquid. The
    velocities at all other faces are set to zero.
    """
    t = types(real)

    @kernel(f"phy124_liquid_gradient_{real.__name__}", real, seconds=0.4)
    def gradient(
        worker,
        active,
        ends,
        shifts: real,
        lattice,
        window,
        open,
        densities,
        phi,
        liquid,
        pressure,
        velocity_out,
        known_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        known = 0
        v = velocity_out[n]
        if shifts > real(0.0):
            v = t.vec4()
        for axis in range(3):
            m = n - stride(axis, size)
            wet = item(liquid, n) + item(liquid, m)
            if wet > 0 and item(open, n)[axis] > real(0.0):
                rise = rise_to(n, m, phi, liquid, pressure) / item(densities, n)[axis]
                if shifts > real(0.0):
                    rise = lattice[3] * wp.clamp(rise, -shifts, shifts)
                v[axis] = v[axis] - rise
                known += 1 << axis
            else:
                v[axis] = real(0.0)
        velocity_out[n] = v
        known_out[n] = known

    return gradient
