"""Zeros of functions, for the theories that need one."""

from __future__ import annotations

from collections.abc import Callable


def root(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function is zero between two places at which its signs differ.

    Args:
        function: Of one number.
        low: The one place.
        high: The other one.
    """
    from scipy.optimize import brentq

    return float(brentq(function, low, high))  # pyright: ignore[reportArgumentType]
