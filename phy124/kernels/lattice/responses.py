"""Response of a surface to an approaching point: one step of projected Gauss-Seidel.

phy124/kernels/lattice/contact.py explains the method.
"""

from typing import Any

import warp as wp

from phy124.kernels.columns import xyz

RELAXED = wp.constant(0.6)
"""Fraction of each correction that is applied. Neighbouring points have most nodes in common, so
full corrections of all points would overshoot.
"""


@wp.func
def largest_approach(gap: Any, pressed: Any, restore: Any, clock: wp.array(dtype=Any)):
    """Return the largest speed at which a surface point may approach a surface [m/s].

    Args:
        gap: Distance of the point from the surface [m], negative inside.
        pressed: Normal component of the point's last impulse [N s].
        restore: Speed at which points inside the surface move out, divided by their depth [1/s].
        clock: Kick and drift [s]; a very short drift must not make a point leave fast.
    """
    longest = wp.max(clock[0], clock[1])
    speed = gap / longest
    if gap < type(gap)(0.0) or pressed != type(gap)(0.0):
        speed = restore * gap
    return speed


@wp.func
def press_and_rub(press: Any, pressed: Any, drag: Any, n: Any, gap: Any, friction: Any):
    """Return the impulse [N s] of a surface that only presses, with Coulomb friction."""
    press = wp.max(press, type(gap)(0.0))
    most = friction * press
    size = wp.length(drag)
    if size > most:
        drag = drag * (most / size)
    return press * n + drag


@wp.func
def hold_across(press: Any, pressed: Any, drag: Any, n: Any, gap: Any, friction: Any):
    """Return the impulse [N s] of a surface that points may not leave but may slide along."""
    if gap > type(gap)(0.0) and pressed == type(gap)(0.0):
        press = wp.max(press, type(gap)(0.0))
    return press * n


@wp.func
def hold(press: Any, pressed: Any, drag: Any, n: Any, gap: Any, friction: Any):
    """Return the impulse [N s] of a surface to which points stick."""
    if gap > type(gap)(0.0) and pressed == type(gap)(0.0):
        press = wp.max(press, type(gap)(0.0))
    if press == type(gap)(0.0):
        drag = drag - drag
    return press * n + drag


LIMITS = {"separate": press_and_rub, "slip": hold_across, "sticky": hold}
"""Functions that limit a corrected impulse, by the name of the surface's response.

The arguments are the normal component of the corrected impulse, the normal component of the last
impulse, the tangential part of the corrected impulse, the normal of the surface, the distance of
the point from the surface, and the friction coefficient.
"""


@wp.func
def there_and_back(step: int, count: int):
    """Return the index of the point at a step of a sweep forwards, then backwards, over all
    points.
    """
    if step < count:
        return step
    return 2 * count - 1 - step


@wp.func
def correct(
    relative: Any, last: Any, gap: Any, part: Any, restore: Any, clock: wp.array(dtype=Any)
):
    """Correct the impulse of a surface on a surface point by one step of Gauss-Seidel.

    The results are the normal component of the impulse, the normal component of the last impulse,
    and the tangential part of the impulse. The surface's response limits these results afterwards.

    Args:
        relative: Velocity of the point relative to the surface [m/s].
        last: Last impulse [N s].
        gap: Normal of the surface, and distance of the point from the surface [m].
        part: Impulse per unit change of velocity, including relaxation [kg].
        restore: Speed at which points inside the surface move out, divided by their depth [1/s].
        clock: Kick and drift [s].
    """
    n = xyz(gap)
    speed = wp.dot(relative, n)
    along = relative - speed * n
    pressed = wp.dot(last, n)
    press = pressed - part * (speed + largest_approach(gap[3], pressed, restore, clock))
    return press, pressed, last - pressed * n - part * along
