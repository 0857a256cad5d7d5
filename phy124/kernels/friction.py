"""What a wall does to the velocity of a node, and how much of the motion along it it takes.

`sticky`, `slip` and `separate` answer for a node by itself; `all_of_it`, `none_of_it` and `coulomb`
are the fraction of the motion along the wall that is taken from a column which meets it.
"""

from typing import Any

import warp as wp


@wp.func
def sticky(v: Any, wall: Any, n: Any, friction: Any):
    """The node moves with the wall."""
    return wall


@wp.func
def slip(v: Any, wall: Any, n: Any, friction: Any):
    """No motion through or away from the wall, free motion along it."""
    return v - wp.dot(v - wall, n) * n


@wp.func
def separate(v: Any, wall: Any, n: Any, friction: Any):
    """May leave the wall; Coulomb friction while pressed on it (Stomakhin et al. 2013, sec. 8)."""
    relative = v - wall
    speed = wp.dot(relative, n)
    if speed >= type(speed)(0.0):
        return v
    along = relative - speed * n
    length = wp.length(along)
    if length <= -friction * speed:
        return wall
    return wall + along * (type(speed)(1.0) + friction * speed / length)


@wp.func
def all_of_it(along: Any, pressed: Any, friction: Any):
    """1: a sticky wall takes all of the motion along it."""
    return type(pressed)(1.0)


@wp.func
def none_of_it(along: Any, pressed: Any, friction: Any):
    """0: a wall without friction takes none of the motion along it."""
    return type(pressed)(0.0)


@wp.func
def coulomb(along: Any, pressed: Any, friction: Any):
    """Fraction of the motion along the wall that friction can stop."""
    wanted = wp.length(along)
    if wanted <= friction * pressed:
        return type(pressed)(1.0)
    return friction * pressed / wanted
