"""Solves the pressure equation by conjugate gradients with a modified Cholesky factor, MIC(0).

The factor (Bridson 2015, "Fluid simulation for computer graphics", ch. 5) ignores matrix entries
that couple cells of different parts (listed.py), so the parts can be processed in parallel.
native/conjugate.h is used on CPUs.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, Ints
from phy124.kernels.build import build_once, kernel
from phy124.kernels.liquid.listed import Table, Vectors, count_of, quotient, share, total
from phy124.kernels.liquid.rigid import add_rigid, clear_rigid, respond, rigid_flux
from phy124.kernels.native import code, constants, native_func

TUNING, SAFETY = wp.constant(wp.float64(0.97)), wp.constant(wp.float64(0.25))
"""Constants of MIC(0): weight of the modification; smallest pivot relative to the diagonal."""
RESIDUAL, RIGHT, STEEP = wp.constant(2), wp.constant(3), wp.constant(4)
"""Rows of the table of sums: largest residual, largest right-hand side, and s A s. Rows 0 and 1
alternately contain r M r of the present and of the previous iteration.
"""
ROWS = 5
"""Number of rows of the table of sums without solids."""


@wp.func
def multiply(n: int, row: int, layer: int, diagonal: Doubles, links: Vectors, x: Doubles):
    """Return component n of A x; `row` and `layer` are the memory strides along y and x."""
    below = links[n - layer][0] * x[n - layer]
    below += links[n - row][1] * x[n - row] + links[n - 1][2] * x[n - 1]
    link = links[n]
    above = link[0] * x[n + layer] + link[1] * x[n + row] + link[2] * x[n + 1]
    return diagonal[n] * x[n] + below + above


@wp.func
def factorise(
    first: int,
    last: int,
    listed: Ints,
    row: int,
    layer: int,
    diagonal: Doubles,
    links: Vectors,
    inverse: Doubles,
):
    """Compute 1 / sqrt of the preconditioner's diagonal in a part of the list of cells."""
    lowest = listed[first]
    for k in range(first, last):
        n = listed[k]
        e = diagonal[n]
        for axis in range(3):
            m = n - 1
            if axis == 1:
                m = n - row
            if axis == 0:
                m = n - layer
            if m >= lowest:
                link = links[m]
                p = inverse[m]
                pp = p * p
                here = link[axis]
                others = link[0] + link[1] + link[2] - here
                e -= here * here * pp + TUNING * here * others * pp
        if e < SAFETY * diagonal[n]:
            e = diagonal[n]
        inverse[n] = wp.float64(1.0) / wp.sqrt(e)


@wp.func
def precondition(
    first: int,
    last: int,
    listed: Ints,
    row: int,
    layer: int,
    links: Vectors,
    inverse: Doubles,
    residual: Doubles,
    z: Doubles,
):
    """Solve M z = r in a part of the list of cells; return the part's sum of r z."""
    lowest = listed[first]
    highest = listed[last - 1]
    for k in range(first, last):
        n = listed[k]
        value = residual[n]
        if n - 1 >= lowest:
            value -= links[n - 1][2] * inverse[n - 1] * z[n - 1]
        if n - row >= lowest:
            value -= links[n - row][1] * inverse[n - row] * z[n - row]
        if n - layer >= lowest:
            value -= links[n - layer][0] * inverse[n - layer] * z[n - layer]
        z[n] = inverse[n] * value
    for j in range(first, last):
        n = listed[first + last - 1 - j]
        link = links[n]
        p = inverse[n]
        value = z[n]
        if n + 1 <= highest:
            value -= p * link[2] * z[n + 1]
        if n + row <= highest:
            value -= p * link[1] * z[n + row]
        if n + layer <= highest:
            value -= p * link[0] * z[n + layer]
        z[n] = p * value
    product = wp.float64(0.0)
    for k in range(first, last):
        n = listed[k]
        product += residual[n] * z[n]
    return product


@wp.func
def turn(
    first: int,
    last: int,
    listed: Ints,
    row: int,
    layer: int,
    diagonal: Doubles,
    links: Vectors,
    beta: wp.float64,
    z: Doubles,
    before: Doubles,
    direction: Doubles,
    product: Doubles,
):
    """Compute s = z + beta s, and A s, in a part of the list of cells; return sum s A s."""
    steep = wp.float64(0.0)
    for k in range(first, last):
        n = listed[k]
        here = z[n] + beta * before[n]
        m = n - layer
        value = links[m][0] * (z[m] + beta * before[m])
        m = n - row
        value += links[m][1] * (z[m] + beta * before[m])
        value += links[n - 1][2] * (z[n - 1] + beta * before[n - 1])
        link = links[n]
        m = n + layer
        value += link[0] * (z[m] + beta * before[m])
        m = n + row
        value += link[1] * (z[m] + beta * before[m])
        value += link[2] * (z[n + 1] + beta * before[n + 1])
        value += diagonal[n] * here
        direction[n] = here
        product[n] = value
        steep += here * value
    return steep


@wp.func
def descend(
    first: int,
    last: int,
    listed: Ints,
    alpha: wp.float64,
    direction: Doubles,
    product: Doubles,
    x: Doubles,
    residual: Doubles,
):
    """Step along s in a part of the list of cells; return the part's largest residual."""
    largest = wp.float64(0.0)
    for k in range(first, last):
        n = listed[k]
        x[n] = x[n] + alpha * direction[n]
        r = residual[n] - alpha * product[n]
        residual[n] = r
        largest = wp.max(largest, wp.abs(r))
    return largest


def _native(function: Any, returns: Any = None) -> Any:
    name = function.key
    body = code("conjugate", f"conjugate:{name}")
    body = constants("double", TUNING=TUNING, SAFETY=SAFETY) + body
    return native_func(body, function.func, f"{name}_native", returns=returns, indexed=False)


FORMS = {
    "plain": (factorise, precondition, turn, descend),
    "native": (
        _native(factorise),
        *(_native(function, wp.float64) for function in (precondition, turn, descend)),
    ),
}
"""Functions that loop over a part of the list of cells, by implementation."""


@build_once
def make_begin(form: str):
    """Kernel over parts of the list of cells: computes the residual, and factorises the matrix."""
    factorise, precondition, _, _ = FORMS[form]

    @kernel(f"phy124_liquid_begin_{form}", seconds=0.5)
    def begin(
        part: int,
        row: int,
        layer: int,
        solids: int,
        counts: Ints,
        listed: Ints,
        diagonal: Doubles,
        links: Vectors,
        right: Doubles,
        x: Doubles,
        which: Ints,
        jumps: Vectors,
        turns: Vectors,
        mobility: Table,
        responses_out: wp.array2d(dtype=wp.vec3d),
        inverse_out: Doubles,
        residual_out: Doubles,
        z_out: Doubles,
        direction_out: Doubles,
        sums_out: Table,
    ):
        p = part + wp.tid()
        span = share(count_of(counts), p, counts.shape[0])
        largest = wp.float64(0.0)
        right_size = wp.float64(0.0)
        product = wp.float64(0.0)
        if solids > 0:
            respond(sums_out, mobility, p, responses_out)
        if span[1] > span[0]:
            factorise(span[0], span[1], listed, row, layer, diagonal, links, inverse_out)
            for k in range(span[0], span[1]):
                n = listed[k]
                r = right[n] - multiply(n, row, layer, diagonal, links, x)
                if solids > 0:
                    if which[n] >= 0:
                        r -= rigid_flux(n, p, which[n], jumps, turns, responses_out)
                residual_out[n] = r
                direction_out[n] = wp.float64(0.0)
                largest = wp.max(largest, wp.abs(r))
                right_size = wp.max(right_size, wp.abs(right[n]))
            product = precondition(
                span[0], span[1], listed, row, layer, links, inverse_out, residual_out, z_out
            )
        sums_out[0, p] = product
        sums_out[1, p] = wp.float64(1.0)
        sums_out[RESIDUAL, p] = largest
        sums_out[RIGHT, p] = right_size

    return begin


@build_once
def make_advance(form: str):
    """Kernel over parts of the list of cells: computes the direction s = z + beta s, and A s."""
    _, _, turn_in, _ = FORMS[form]

    @kernel(f"phy124_liquid_advance_{form}", seconds=0.3)
    def advance(
        part: int,
        turn: int,
        begun: int,
        row: int,
        layer: int,
        solids: int,
        counts: Ints,
        listed: Ints,
        diagonal: Doubles,
        links: Vectors,
        z: Doubles,
        before: Doubles,
        which: Ints,
        jumps: Vectors,
        turns: Vectors,
        direction_out: Doubles,
        product_out: Doubles,
        sums_out: Table,
    ):
        p = part + wp.tid()
        span = share(count_of(counts), p, counts.shape[0])
        beta = wp.float64(0.0)
        if begun > 0:
            beta = quotient(sums_out, turn, total(sums_out, 1 - turn))
        clear_rigid(sums_out, solids, p)
        sums_out[STEEP, p] = turn_in(
            span[0],
            span[1],
            listed,
            row,
            layer,
            diagonal,
            links,
            beta,
            z,
            before,
            direction_out,
            product_out,
        )
        if solids > 0:
            for k in range(span[0], span[1]):
                n = listed[k]
                here = direction_out[n]
                if which[n] >= 0:
                    add_rigid(sums_out, which[n], p, here * jumps[n], here * turns[n])

    return advance


@build_once
def make_improve(form: str):
    """Kernel over parts of the list of cells: takes a step along s; preconditions the residual."""
    _, precondition, _, descend = FORMS[form]

    @kernel(f"phy124_liquid_improve_{form}", seconds=0.4)
    def improve(
        part: int,
        turn: int,
        row: int,
        layer: int,
        solids: int,
        counts: Ints,
        listed: Ints,
        links: Vectors,
        inverse: Doubles,
        direction: Doubles,
        which: Ints,
        jumps: Vectors,
        turns: Vectors,
        mobility: Table,
        responses_out: wp.array2d(dtype=wp.vec3d),
        product_out: Doubles,
        x_out: Doubles,
        residual_out: Doubles,
        z_out: Doubles,
        sums_out: Table,
    ):
        p = part + wp.tid()
        span = share(count_of(counts), p, counts.shape[0])
        steep = total(sums_out, STEEP)
        if solids > 0:
            steep += respond(sums_out, mobility, p, responses_out)
            for k in range(span[0], span[1]):
                n = listed[k]
                if which[n] >= 0:
                    flux = rigid_flux(n, p, which[n], jumps, turns, responses_out)
                    product_out[n] = product_out[n] + flux
        alpha = quotient(sums_out, turn, steep)
        largest = wp.float64(0.0)
        product = wp.float64(0.0)
        if span[1] > span[0]:
            largest = descend(
                span[0], span[1], listed, alpha, direction, product_out, x_out, residual_out
            )
            product = precondition(
                span[0], span[1], listed, row, layer, links, inverse, residual_out, z_out
            )
        sums_out[1 - turn, p] = product
        sums_out[RESIDUAL, p] = largest

    return improve
