"""Weights of the quadratic B-spline, and their derivatives."""

from typing import Any

import warp as wp


@wp.func
def spline(f: Any):
    """Quadratic B-spline weights of three nodes; f in [0.5, 1.5) is the distance to the first."""
    half = type(f)(0.5)
    a = type(f)(1.5) - f
    b = f - type(f)(1.0)
    c = f - half
    return wp.vector(half * a * a, type(f)(0.75) - b * b, half * c * c)


@wp.func
def slope(f: Any):
    """Derivatives of these weights by the particle's place, per cell."""
    return wp.vector(f - type(f)(1.5), type(f)(2.0) - type(f)(2.0) * f, f - type(f)(0.5))


@wp.func
def offsets(f: Any):
    """0, 1, 2 in the precision of f (casting a loop index would retype the index itself)."""
    return wp.vector(type(f)(0.0), type(f)(1.0), type(f)(2.0))
