"""How a surface responds to a point that approaches it: a step of projected Gauss-Seidel.

Kernels of contact with walls, bodies, free solids and material on a grid share these functions
(phy124/kernels/lattice/contact.py explains the method).
"""

from typing import Any

import warp as wp

from phy124.kernels.columns import xyz

RELAXED = wp.constant(0.6)
"""Fraction of each point's correction that is applied. Neighbouring points share most of their
nodes, so full corrections would overshoot together.
"""


@wp.func
def largest_approach(gap: Any, pressed: Any, restore: Any, clock: wp.array(dtype=Any)):
    """Return the largest speed at which a point may approach a surface [m/s].

    Args:
        gap: Distance of the point [m], negative inside.
        pressed: Normal part of its last impulse [N s].
        restore: Gain by which points come out [1/s].
        clock: Kick and drift [s]; a very short drift must not make a point leave fast.
    """
    longest = wp.max(clock[0], clock[1])
    speed = gap / longest
    if gap < type(gap)(0.0) or pressed != type(gap)(0.0):
        speed = restore * gap
    return speed


@wp.func
def press_and_rub(press: Any, pressed: Any, drag: Any, n: Any, gap: Any, friction: Any):
    """Return the impulse of a surface that only presses, with friction in Coulomb's cone [N s]."""
    press = wp.max(press, type(gap)(0.0))
    most = friction * press
    size = wp.length(drag)
    if size > most:
        drag = drag * (most / size)
    return press * n + drag


@wp.func
def hold_across(press: Any, pressed: Any, drag: Any, n: Any, gap: Any, friction: Any):
    """Return the impulse of a surface that holds points once they touch it, but lets them slide."""
    if gap > type(gap)(0.0) and pressed == type(gap)(0.0):
        press = wp.max(press, type(gap)(0.0))
    return press * n


@wp.func
def hold(press: Any, pressed: Any, drag: Any, n: Any, gap: Any, friction: Any):
    """Return the impulse of a surface that holds points once they touch it [N s]."""
    if gap > type(gap)(0.0) and pressed == type(gap)(0.0):
        press = wp.max(press, type(gap)(0.0))
    if press == type(gap)(0.0):
        drag = drag - drag
    return press * n + drag


LIMITS = {"separate": press_and_rub, "slip": hold_across, "sticky": hold}
"""Maps a surface's response to the function that limits a corrected impulse.

The arguments are its normal part and that of the last impulse, its part along the surface, the
normal, the distance of the point and the friction coefficient.
"""


@wp.func
def there_and_back(step: int, count: int):
    """Return the list index of the point that a pass visits; a pass goes forwards, then back."""
    if step < count:
        return step
    return 2 * count - 1 - step


@wp.func
def correct(
    relative: Any, last: Any, gap: Any, part: Any, restore: Any, clock: wp.array(dtype=Any)
):
    """Correct the impulse of a surface on a point, before its response limits it.

    The results are the normal part of the impulse, the normal part of the last impulse, and the
    part along the surface.

    Args:
        relative: Velocity of the point relative to the surface [m/s].
        last: Last impulse [N s].
        gap: Normal of the surface and distance from it [m].
        part: Impulse per change of velocity, after relaxation [kg].
        restore: Gain by which points come out [1/s].
        clock: Kick and drift [s].
    """
    n = xyz(gap)
    speed = wp.dot(relative, n)
    along = relative - speed * n
    pressed = wp.dot(last, n)
    press = pressed - part * (speed + largest_approach(gap[3], pressed, restore, clock))
    return press, pressed, last - pressed * n - part * along
