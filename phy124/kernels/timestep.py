"""Chooses the next substep's length on the device, so that a frame does not wait for the host.

The limits are the same as in phy124/mpm/timestep.py and phy124/mpm/rejection.py, and the substeps
chosen here and on the host are bitwise equal on one device. A kernel that also handles a wall may
round differently.
"""

from typing import Any

import warp as wp

from phy124.kernels import measure as at
from phy124.kernels.arguments import Doubles, Ints
from phy124.kernels.build import build_once, kernel

DONE, LOOK, CAREFUL = 1, 2, 3
"""Reasons to end a series of substeps: the target time is reached, the host must measure, or the
next substep could move a particle too far.
"""
LIMITS = 5
ELASTIC, SPEED, GRADIENT, VISCOUS, USER = range(LIMITS)
BLOCK = 4
"""Number of substeps that the CUDA graph runs without checking conditions in between."""


@wp.struct
class Limits:
    """Parameters of a series of substeps up to a target time, set by the host."""

    until: wp.float64
    """End of the series [s]."""
    dx: wp.float64
    """Grid spacing [m]."""
    reach: wp.float64
    """Courant number times the grid spacing [m]. Divided by the wave speed, it is the elastic limit
    of a substep.
    """
    stride: wp.float64
    """Largest distance that a particle may move in a substep [m]."""
    turn: wp.float64
    """Largest product of a particle's velocity gradient |C| and the substep."""
    viscous: wp.float64
    """Longest substep that is stable with the viscosity of the materials [s]."""
    ceiling: wp.float64
    """Longest substep according to the user's options [s]."""
    wall: wp.float64
    """Largest speed of a wall [m/s]."""
    acceleration: wp.float64
    """Upper bound of the acceleration of a particle by all forces [m/s^2]."""
    memory: wp.float64
    """After a measurement, the assumed stiffness is at least this fraction of the stiffness that
    was assumed before.
    """
    strain: wp.float64
    """Sum of |C| dt after which control returns to the host."""
    most: wp.int32
    """Number of substeps after which control returns to the host."""
    apart: wp.int32
    """1 if particles have left the grid, else 0; only the host can measure such particles."""
    origin: wp.vec3d
    """Position of the grid node with index 0 [m]."""
    margin: wp.int32
    """Margin of the grid's window around the particles [cells]."""
    every: wp.int32
    """Number of substeps between two measurements of the particles."""


@wp.struct
class Progress:
    """State of a series of substeps."""

    time: wp.float64
    """Current time [s]."""
    last: wp.float64
    """Length of the last substep [s]."""
    next: wp.float64
    """Length of the next substep [s]; 0 if it has not been chosen yet."""
    speed: wp.float64
    """Largest speed |v| at the last measurement [m/s]."""
    gradient: wp.float64
    """Largest velocity gradient |C| at the last measurement [1/s]."""
    stiffness: wp.float64
    """Largest A / rho0, modulus per rest density [m^2/s^2]; earlier measurements decay."""
    fastest: wp.float64
    """Largest speed in this series [m/s]."""
    steepest: wp.float64
    """Largest |C| in this series [1/s]."""
    strain: wp.float64
    """Sum of |C| dt, a bound of the strain, over this series."""
    taken: wp.int32
    since: wp.int32
    """Number of substeps since the last measurement."""
    reason: wp.int32
    """Reason why the substeps have ended; 0 while they continue."""


@wp.func
def over(a: wp.float64, b: wp.float64):
    """Return a / b, or infinity for b = 0."""
    if b > wp.float64(0.0):
        return a / b
    return wp.float64(wp.inf)


@wp.func
def finish(s: Progress, bounds: Limits):
    """Update time, strain and number of substeps, if a substep was taken."""
    if s.next > wp.float64(0.0):
        rest = bounds.until - s.time
        s.strain += s.gradient * s.next
        s.time = s.time + s.next
        if s.next == rest:
            s.time = bounds.until
        s.last = s.next
        s.taken += 1
        s.since += 1
        s.next = wp.float64(0.0)
    return s


@wp.func
def spare(x: wp.float64, origin: wp.float64, dx: wp.float64):
    """Return the first of the three nodes along an axis that a particle at x touches."""
    return int(wp.floor((x - origin) / dx - wp.float64(0.5)))


@wp.func
def corner(maxima: wp.array(dtype=Any), i: int):
    """Return three consecutive measured maxima, from index i on, as a float64 vector."""
    return wp.vec3d(wp.float64(maxima[i]), wp.float64(maxima[i + 1]), wp.float64(maxima[i + 2]))


@wp.func
def roomy(low: wp.vec3d, high: wp.vec3d, window: wp.array(dtype=wp.vec3i), bounds: Limits):
    """Return whether the margin of the window around the particles has an acceptable width."""
    fits = bool(True)
    for axis in range(3):
        first = window[0][axis]
        below = spare(low[axis], bounds.origin[axis], bounds.dx) - first
        above = first + window[1][axis] - spare(high[axis], bounds.origin[axis], bounds.dx) - 3
        minimum = bounds.margin // 2
        most = 3 * bounds.margin
        if below < minimum or above < minimum or below > most or above > most:
            fits = False
    return fits


@wp.func
def limiter(s: Progress, bounds: Limits):
    """Return the shortest limit on the substep [s], and its index (the first of equal limits)."""
    dt = over(bounds.reach, wp.sqrt(s.stiffness))
    which = int(wp.static(ELASTIC))
    if over(bounds.stride, s.speed) < dt:
        dt = over(bounds.stride, s.speed)
        which = int(wp.static(SPEED))
    if over(bounds.turn, s.gradient) < dt:
        dt = over(bounds.turn, s.gradient)
        which = int(wp.static(GRADIENT))
    if bounds.viscous < dt:
        dt = bounds.viscous
        which = int(wp.static(VISCOUS))
    if bounds.ceiling < dt:
        dt = bounds.ceiling
        which = int(wp.static(USER))
    return dt, which


@wp.func
def violent(dt: wp.float64, s: Progress, bounds: Limits):
    """Return whether a particle or wall may move more than about a cell in a substep."""
    two = wp.float64(2.0)
    return (
        two * wp.max(s.speed, bounds.wall) * dt > bounds.stride
        or two * s.gradient * dt > bounds.turn
        or bounds.acceleration * dt * dt > wp.float64(0.1) * bounds.dx
    )


@wp.func
def whole_block(dt: wp.float64, s: Progress, bounds: Limits):
    """Return whether exactly `BLOCK` substeps of about dt [s] precede the next measurement.

    The result is False if the target time is reached, or control returns to the host, before all of
    these substeps are taken.
    """
    count = int(wp.static(BLOCK))
    all = wp.float64(count)
    return (
        bounds.until - s.time > (all - wp.float64(0.5)) * dt
        and s.since + count == bounds.every
        and s.taken + count <= bounds.most
        and s.strain + all * s.gradient * dt * wp.float64(1.001) < bounds.strain
        and not violent(dt * wp.float64(1.001), s, bounds)
    )


@build_once
def make_timestep(real: Any):
    """Single-thread kernel: finishes a substep; chooses the next substep or stops with a reason.

    `look_out` is 1 if the particles have to be measured after the next substep, and `block_out` is
    1 if a whole block of substeps follows. `limiters_out` contains two numbers for each limit:
    first the counts of substeps that each limit determined, then the sums of substep / limit.
    """

    @kernel(f"phy124_timestep_{real.__name__}", real)
    def timestep(
        limits: wp.array(dtype=Limits),
        window,
        maxima,
        stray,
        progress_out: wp.array(dtype=Progress),
        clock_out: wp.array(dtype=real),
        limiters_out: Doubles,
        on_out: Ints,
        look_out: Ints,
        block_out: Ints,
    ):
        bounds = limits[0]
        block = bool(False)
        s = finish(progress_out[0], bounds)
        s.reason = 0
        look = s.strain > bounds.strain or s.taken >= bounds.most
        if s.since >= bounds.every and s.time < bounds.until:
            low = -corner(maxima, wp.static(at.LOW))
            high = corner(maxima, wp.static(at.HIGH))
            look = look or bounds.apart > 0 or stray[0] > 0 or not roomy(low, high, window, bounds)
            # If the host takes over, the host also measures.
            if not look:
                s.speed = wp.float64(maxima[wp.static(at.SPEED)])
                s.gradient = wp.float64(maxima[wp.static(at.GRADIENT)])
                s.stiffness = wp.max(
                    wp.float64(maxima[wp.static(at.STIFFNESS)]), bounds.memory * s.stiffness
                )
                s.since = 0
        s.fastest = wp.max(s.fastest, s.speed)
        s.steepest = wp.max(s.steepest, s.gradient)
        if s.time >= bounds.until:
            s.reason = wp.static(DONE)
        elif look:
            s.reason = wp.static(LOOK)
        else:
            longest, which = limiter(s, bounds)
            rest = bounds.until - s.time
            dt = rest / wp.max(wp.float64(1.0), wp.ceil(rest / longest - wp.float64(1e-9)))
            if violent(dt, s, bounds):
                s.reason = wp.static(CAREFUL)
            else:
                s.next = dt
                block = whole_block(dt, s, bounds)
                ratios = which + wp.static(LIMITS)
                limiters_out[which] = limiters_out[which] + wp.float64(1.0)
                limiters_out[ratios] = limiters_out[ratios] + dt / longest
                clock_out[0] = real((s.last + dt) / wp.float64(2.0))
                clock_out[1] = real(dt)
                clock_out[2] = real(s.time)
        progress_out[0] = s
        on_out[0] = wp.where(s.reason == 0, 1, 0)
        look_out[0] = wp.where(s.since + 1 >= bounds.every, 1, 0)
        block_out[0] = wp.where(block, 1, 0)

    return timestep
