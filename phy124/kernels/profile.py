"""Samples piecewise linear tracks (values over time) on the device, once per substep.

A force is averaged over the interval of its kick. These intervals cover time without gaps, so the
total impulse of a force is exact for any sequence of substeps. If the period of a wall's motion is
shorter than a substep, the wall's velocity is its displacement during the substep, divided by the
length of the substep.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel

MEAN = 1
"""The values are averaged over the kick."""
JOINS = 2
"""The value is added to the uniform acceleration (slot 0 of the tracks)."""
LIMITED = 4
"""The stage that uses the track limits the track's effect on particles."""
KICK = 8
"""The values are averaged over the kick even while the track is inactive."""
DRIFT = 16
"""The values are averaged over the next substep even while the track is inactive."""


@wp.func
def value_at(times: wp.array(dtype=Any), keys: wp.array(dtype=Any), i: int, at: Any):
    """Return the value of a track at a time between the keys i and i + 1."""
    span = times[i + 1] - times[i]
    return keys[i] + ((at - times[i]) / span) * (keys[i + 1] - keys[i])


@wp.func
def integral(
    times: wp.array(dtype=Any), keys: wp.array(dtype=Any), first: int, last: int, a: Any, b: Any
):
    """Return the integral of a track from a to b [s]; outside its keys, a track is constant."""
    zero = a - a
    total = wp.max(wp.min(b, times[first]) - a, zero) * keys[first]
    total += wp.max(b - wp.max(a, times[last]), zero) * keys[last]
    i = first
    while i < last and times[i] < b:
        low = wp.max(a, times[i])
        high = wp.min(b, times[i + 1])
        if high > low:
            total += (high - low) * value_at(times, keys, i, (low + high) / type(a)(2.0))
        i += 1
    return total


@wp.func
def fold(at: Any, period: Any):
    """Return a time modulo a track's period (0: no period); negative times are unchanged."""
    if period > type(at)(0.0) and at > type(at)(0.0):
        return at - period * wp.floor(at / period)
    return at


@wp.func
def mean(
    times: wp.array(dtype=Any),
    keys: wp.array(dtype=Any),
    first: int,
    last: int,
    span: Any,
    a: Any,
    b: Any,
):
    """Return the mean of a track's value from a to b [s].

    The track is zero outside span = (start, end, origin, period).
    """
    zero = a - a
    low = wp.max(a, span[0])
    high = wp.min(b, span[1])
    if high <= low:
        return zero * keys[first]
    if first == last:
        return ((high - low) / (b - a)) * keys[first]
    at = fold(low - span[2], span[3])
    to = at + (high - low)
    total = integral(times, keys, first, last, at, to)
    if span[3] > zero and to > span[3]:
        total = integral(times, keys, first, last, at, span[3])
        rest = to - span[3]
        turns = wp.floor(rest / span[3])
        if turns > zero:
            total += turns * integral(times, keys, first, last, zero, span[3])
        total += integral(times, keys, first, last, zero, rest - turns * span[3])
    return total / (b - a)


@wp.func
def read(times: wp.array(dtype=Any), keys: wp.array(dtype=Any), first: int, last: int, at: Any):
    """Return the value and the rate of a track; outside the keys the track is constant."""
    value = keys[last]
    rate = value - value
    if at < times[first]:
        value = keys[first]
    i = first
    while i < last and times[i] <= at:
        if at < times[i + 1]:
            value = value_at(times, keys, i, at)
            rate = (keys[i + 1] - keys[i]) / (times[i + 1] - times[i])
        i += 1
    return value, rate


@wp.func
def keys_within(times: wp.array(dtype=Any), first: int, last: int, a: Any, b: Any):
    """Return the number of a track's keys, except the first key, in the interval (a, b] [s]."""
    count = int(0)
    for i in range(first + 1, last + 1):
        if times[i] > a and times[i] <= b:
            count += 1
    return count


@wp.func
def skips(times: wp.array(dtype=Any), first: int, last: int, at: Any, to: Any, period: Any):
    """Return whether a whole segment between two keys lies between two times [s]."""
    passed = keys_within(times, first, last, at, to)
    if period > type(at)(0.0) and to > period:
        passed += keys_within(times, first, last, type(at)(0.0), to - period)
    return passed > 1


@build_once
def make_sampler(real: Any):
    """Kernel: samples the value and the rate of every track; slot 0 is the uniform acceleration.

    The fourth component of a value is 1 while the track is active.
    """
    t = types(real)

    @kernel(f"phy124_tracks_{real.__name__}", real, seconds=0.65)
    def sample(
        starts: Ints,
        times: t.reals,
        keys: t.vec3s,
        spans: t.vec4s,
        flags: Ints,
        clock,
        values_out: t.vec4s,
        rates_out: t.vec4s,
    ):
        slot = wp.tid()
        now = clock[2]
        b = now + real(0.5) * clock[1]
        a = b - clock[0]
        # Before the first substep there is no interval; constant tracks are sampled only then.
        if b <= a:
            a = now
            b = now + real(1.0)
        value = t.vec3()
        rate = t.vec3()
        first = starts[slot]
        last = starts[slot + 1] - 1
        span = spans[slot]
        if slot == 0:
            for s in range(1, flags.shape[0]):
                if (flags[s] & wp.static(JOINS)) != 0:
                    value += mean(times, keys, starts[s], starts[s + 1] - 1, spans[s], a, b)
        elif (flags[slot] & wp.static(MEAN)) != 0:
            value = mean(times, keys, first, last, span, a, b)
        else:
            at = fold(now - span[2], span[3])
            value, rate = read(times, keys, first, last, at)
            ahead = clock[1]
            if ahead > real(0.0):
                if (flags[slot] & wp.static(KICK | DRIFT)) != 0:
                    if (flags[slot] & wp.static(DRIFT)) != 0:
                        a = now
                        b = now + ahead
                    always = wp.vector(a, b, span[2], span[3])
                    value = mean(times, keys, first, last, always, a, b)
                elif skips(times, first, last, at, at + ahead, span[3]):
                    to = fold(at + ahead, span[3])
                    later, _ = read(times, keys, first, last, to)
                    rate = (later - value) / ahead
        active = real(0.0)
        if now >= span[0] and now < span[1]:
            active = real(1.0)
        values_out[slot] = wp.vector(value[0], value[1], value[2], active)
        rates_out[slot] = wp.vector(rate[0], rate[1], rate[2], real(0.0))

    return sample
