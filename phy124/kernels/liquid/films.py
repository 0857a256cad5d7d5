"""Computes contact areas of particle bodies with fixed walls, and the pressures of films between
them.

The grid does not resolve the film between a body and a wall. The pressure in the film is therefore
taken from the liquid around the contact.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.liquid.active import EMPTY
from phy124.kernels.liquid.bodies import Motions
from phy124.kernels.liquid.faces import cell_of, inner, number, stride
from phy124.kernels.liquid.impulses import way_to_wall
from phy124.kernels.liquid.listed import Vectors
from phy124.kernels.liquid.mixture import CENTRE
from phy124.kernels.liquid.walls import centre_of, solid_face


@build_once
def make_contact(real: Any):
    """Kernel over a region's cells: computes the area of a body's contact with fixed walls.

    `still` contains the open fraction that each face would have without bodies. The signs of the
    areas are as in `make_jumps`.
    """
    t = types(real)

    @kernel(f"phy124_liquid_contact_{real.__name__}", real, seconds=0.2)
    def contact(window, region, level, still: t.vec4s, open, contact_out: t.vec3s):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if level[n] >= real(EMPTY):
            return
        row = contact_out[n]
        for axis in range(3):
            m = n + stride(axis, size)
            wall = still[m][axis] - still[n][axis]
            if wall != real(0.0):
                row[axis] = wall - open[m][axis] + open[n][axis]
        contact_out[n] = row

    return contact


@build_once
def make_layers(real: Any):
    """Kernel over a region's cells: sums densities and counts cells in each horizontal layer.

    `low` is the height of the first layer [cells].
    """
    t = types(real)

    @kernel(f"phy124_liquid_layers_{real.__name__}", real, seconds=0.2)
    def layers(
        up: t.vec3,
        low: real,
        region,
        lattice,
        window,
        densities,
        liquid,
        layers_out: wp.array(dtype=wp.vec2d),
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if liquid[n] == 1:
            height = wp.dot(up, centre_of(cell, lattice, window[0])) / lattice[3] - low
            k = wp.clamp(int(wp.floor(height)), 0, layers_out.shape[0] - 1)
            dense = wp.float64(densities[n][CENTRE])
            wp.atomic_add(layers_out, k, wp.vec2d(dense, wp.float64(1.0)))

    return layers


@wp.func
def weight_at(x: Any, a: Any, dt: Any, dx: Any, low: Any, heads: wp.array(dtype=Any)):
    """Return the hydrostatic part of the pressure solution q at a point, up to a constant.

    `heads` contains the weight of the liquid below each layer, relative to the mean density.
    `heads` is empty if all liquids have the same density.
    """
    if heads.shape[0] == 0:
        return dt / dx * wp.dot(a, x)
    pull = wp.length(a)
    if pull == type(dx)(0.0):
        return type(dx)(0.0)
    height = -wp.dot(a, x) / (pull * dx) - low
    k = wp.clamp(int(wp.floor(height)), 0, heads.shape[0] - 2)
    below = heads[k] + (height - type(dx)(k)) * (heads[k + 1] - heads[k])
    return -dt * pull * below


@build_once
def make_head(real: Any):
    """Kernel over cells: sums the pressure around a body's contact with walls.

    The hydrostatic part of the pressure solution q is subtracted. `rows_out` [6] has a row for each
    direction (-x, +x, -y, +y, -z, +z) in which a film pushes the body. A row contains the sum of
    the pressure over the cells next to the contact, weighted by the body's surface area in each
    cell; the total of these areas; and the area of the contact.
    """
    t = types(real)

    @kernel(f"phy124_liquid_head_{real.__name__}", real, seconds=0.2)
    def head(
        solid,
        low: real,
        heads: t.reals,
        region,
        lattice,
        window,
        clock,
        values,
        which,
        liquid,
        jumps,
        x_guess: Doubles,
        contact: t.vec3s,
        rows_out: Vectors,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        zero = wp.float64(0.0)
        for axis in range(3):
            touch = wp.float64(contact[n][axis])
            if touch != zero:
                side = 2 * axis + int(touch > zero)
                wp.atomic_add(rows_out, side, wp.vec3d(zero, zero, wp.abs(touch)))
        if liquid[n] == 1 and which[n] == solid:
            a = wp.vector(values[0][0], values[0][1], values[0][2])
            x = centre_of(cell, lattice, window[0])
            weight = wp.float64(weight_at(x, a, clock[0], lattice[3], low, heads))
            area = wp.length(jumps[n])
            row = wp.vec3d(area * (x_guess[n] - weight), area, zero)
            low_touch = t.vec3()
            high_touch = t.vec3()
            for i in range(27):
                m = n + (i // 9 - 1) * size[1] * size[2] + (i // 3 % 3 - 1) * size[2] + i % 3 - 1
                low_touch = wp.min(low_touch, contact[m])
                high_touch = wp.max(high_touch, contact[m])
            for axis in range(3):
                if low_touch[axis] < real(0.0):
                    wp.atomic_add(rows_out, 2 * axis, row)
                if high_touch[axis] > real(0.0):
                    wp.atomic_add(rows_out, 2 * axis + 1, row)

    return head


@wp.func
def share_of(rim: wp.vec3d, opposite: wp.vec3d):
    """Return the fraction of a body's contact with a wall on which a film acts.

    `make_head` computes the arguments. A film exists only if there is liquid along at least half of
    the contact's perimeter; the contact is assumed to be square. Films on both sides would squeeze
    a body that fills the space between two walls, so a film acts only on the difference between
    opposite contact areas.
    """
    unit = wp.float64(1.0)
    wet = wp.min(rim[1] / (wp.float64(2.0) * wp.sqrt(rim[2])), unit)
    return wet * wp.max(unit - opposite[2] / rim[2], wp.float64(0.0))


@build_once
def make_film(real: Any):
    """Kernel over a region's cells: computes the pressure of a film between a body and walls.

    The film has the hydrostatic pressure of the liquid around the contact (`rims`, from
    `make_head`). If a cell between body and wall contains liquid, the film has the pressure of the
    cell. The difference in hydrostatic pressure between the cell's centre and the wall is added;
    `fixed` contains the distances from the fixed walls.
    """
    t = types(real)

    @kernel(f"phy124_liquid_film_{real.__name__}", real, seconds=0.3)
    def film(
        solid,
        rims: Vectors,
        scale: real,
        low: real,
        heads: t.reals,
        region,
        lattice,
        window,
        clock,
        values,
        which,
        liquid,
        jumps,
        x_guess: Doubles,
        fixed: t.reals,
        owners,
        contact: t.vec3s,
        pressed_out: t.vec3s,
        sums_out: wp.array2d(dtype=wp.float64),
        exchanged_out: Motions,
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        zero = real(0.0)
        a = wp.vector(values[0][0], values[0][1], values[0][2])
        for axis in range(3):
            row = contact[n][axis]
            side = 2 * axis + int(row > real(0.0))
            rim = rims[side]
            if row != real(0.0) and liquid[n] == 1 and which[n] == solid:
                row -= real(jumps[n][axis])
            if row != real(0.0):
                x = centre_of(cell, lattice, window[0])
                inside = weight_at(x, a, clock[0], lattice[3], low, heads)
                x[axis] = x[axis] + way_to_wall(cell, axis, row, size, fixed, lattice[3])
                q = weight_at(x, a, clock[0], lattice[3], low, heads)
                if liquid[n] == 1:
                    q += real(x_guess[n]) - inside
                else:
                    q += real(rim[0] / wp.max(rim[1], wp.float64(1e-9)))
                q = wp.max(q, zero)
                q *= real(share_of(rim, rims[4 * axis + 1 - side]))
                impulse = t.vec3()
                impulse[axis] = q * scale * row
                pressed_out[n] = pressed_out[n] + impulse
                moment = wide(wp.cross(x, impulse))
                wp.atomic_add(exchanged_out, solid, 0, wide(impulse))
                wp.atomic_add(exchanged_out, solid, 1, moment)
                wall = owners[solid_face(cell, axis, row, size)]
                if wall >= 0:
                    wp.atomic_add(sums_out, wall, axis, wp.float64(impulse[axis]))
                    for b in range(3):
                        wp.atomic_add(sums_out, wall, 3 + b, moment[b])

    return film
