"""Sums over the nodes of a surface point, and impulses on these nodes.

The nodes are rows of three nodes that are consecutive in memory. In float32 on a CPU, the nine
numbers of a row occupy an AVX2 register and a scalar (phy124/kernels/native/rows.h).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.native import code

Vectors = wp.array(dtype=wp.vec3)
Numbers = wp.array(dtype=wp.float32)
Weights = wp.array2d(dtype=wp.float32)
Nodes = wp.array2d(dtype=int)


@wp.func
def moved_by(
    values: wp.array(dtype=Any),
    nodes: wp.array2d(dtype=int),
    weights: wp.array2d(dtype=Any),
    s: int,
):
    """Return the sum of w_i a_i over the nodes of a surface point."""
    total = weights[s, 0] * values[nodes[s, 0]]
    for k in range(1, weights.shape[1]):
        total += weights[s, k] * values[nodes[s, k]]
    return total


@wp.func
def yielding(
    inverse: wp.array(dtype=Any),
    nodes: wp.array2d(dtype=int),
    weights: wp.array2d(dtype=Any),
    s: int,
):
    """Return sum w_i^2 / m_i: the change of a point's velocity per unit impulse [1/kg]."""
    total = weights[s, 0] * weights[s, 0] * inverse[nodes[s, 0]]
    for k in range(1, weights.shape[1]):
        total += weights[s, k] * weights[s, k] * inverse[nodes[s, k]]
    return total


@wp.func
def strike(
    v: wp.array(dtype=Any),
    inverse: wp.array(dtype=Any),
    nodes: wp.array2d(dtype=int),
    weights: wp.array2d(dtype=Any),
    s: int,
    impulse: Any,
):
    """Apply an impulse [N s] to the nodes of a surface point."""
    for k in range(weights.shape[1]):
        n = nodes[s, k]
        v[n] = v[n] + (weights[s, k] * inverse[n]) * impulse


@wp.func_native(code("rows", "rows:moved"))
def moved_rows(values: Vectors, nodes: Nodes, weights: Weights, s: int) -> wp.vec3:
    """Version of `moved_by` with vector instructions of a CPU."""
    ...


@wp.func_native(code("rows", "rows:yielding"))
def yielding_rows(inverse: Numbers, nodes: Nodes, weights: Weights, s: int) -> wp.float32:
    """Version of `yielding` with vector instructions of a CPU."""
    ...


@wp.func_native(code("rows", "rows:strike"))
def strike_rows(
    v: Vectors, inverse: Numbers, nodes: Nodes, weights: Weights, s: int, impulse: wp.vec3
):
    """Version of `strike` with vector instructions of a CPU."""
    ...


class Rows(NamedTuple):
    """Functions on the nodes of a surface point, either scalar or vectorised."""

    name: str
    """Prefix of the names of Warp modules."""
    moved_by: Callable[..., Any]
    yielding: Callable[..., Any]
    strike: Callable[..., Any]


PLAIN = Rows("", moved_by, yielding, strike)
SIMD = Rows("simd_", moved_rows, yielding_rows, strike_rows)


def rows_for(real: Any, device: str, *, vectors: bool = True) -> Rows:
    """Return the functions on the nodes of surface points for a precision and a device."""
    return SIMD if vectors and real is wp.float32 and device == "cpu" else PLAIN
