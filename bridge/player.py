"""Player: decides when each frame is due, without any input or output.

The current time is an argument (seconds of any monotonic clock), so that tests need not wait.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError

SPEEDS = (0.01, 100.0)
"""Smallest and largest playback speed, relative to real time."""
RATES = (0.0, 1000.0)
"""Smallest and largest number of frames per second. 0 or None means that every frame is shown."""
ROUNDING = 1e-6
"""Largest difference between a time and the frame that a peer means by this time [s]. Messages
round times to nanoseconds.
"""
LATENESS = 0.15
"""Largest delay at which a frame is still sent [s].

At 30 Hz, at most 5 delayed frames are sent in a burst, as many as subscribers keep.
"""


@dataclass(frozen=True)
class Tick:
    """A frame that is to be shown."""

    index: int
    time: float
    """Time of the frame in the clip [s]."""
    stamp: float
    """Seconds of the clip played so far; this number never decreases, even at loops and seeks."""


class Player:
    """Plays frames at the times [T] in order; counts and omits frames that are too late."""

    def __init__(
        self,
        times: NDArray[np.float64],
        *,
        speed: float = 1.0,
        loop: bool = False,
        rate: float | None = None,
        paused: bool = False,
        lateness: float = LATENESS,
    ) -> None:
        """Start at the first frame; the clock starts with the first call of `due`.

        Args:
            times: Times of the frames in ascending order [T], s.
            speed: Playback speed: seconds of the clip per real second.
            loop: Whether to start again after the last frame.
            rate: Largest number of frames shown per second. If None, all frames are shown.
            paused: Whether to start paused at the first frame.
            lateness: Largest delay at which a frame is still shown [s].

        Raises:
            InputError: There are no frames, the times do not increase, or a number is out of range.
        """
        # Copied, since the times of a clip are read from its file, which may be cut while it plays.
        self.times = np.array(times, dtype=np.float64)
        if not len(self.times) or not (np.diff(self.times) > 0).all():
            limit = "The times of the frames must ascend, and there must be at least one frame."
            raise InputError("clip", f"{len(self.times)} frames", limit, "Simulate it again.")
        self.loop, self.paused, self.rate = loop, paused, _checked_rate(rate)
        self.speed, self.lateness = checked_speed(speed), lateness
        self.shown = self.dropped = self.skipped = 0
        """Numbers of frames shown, frames dropped as late, and frames skipped for `rate`."""
        self.finished = False
        self._next = 0
        self._peek = True  # whether to show the next frame even while paused
        self._start: float | None = None  # reading of the clock at which `_anchor` is due
        self._anchor = float(self.times[0])
        self._offset = -self._anchor  # time stamp minus time in the clip
        self._shown_at = -math.inf  # time in the clip of the last frame shown since a jump
        self.position = self._anchor
        """Time in the clip [s] of the last frame shown, or, after `seek`, of the next frame."""
        self._stamp: float | None = None  # time stamp of the last frame shown
        self._clock = 0.0  # last value that `stamp_at` returned

    @property
    def interval(self) -> float:
        """Mean time between frames [s]. In a loop, this is also the time from the last to the first
        frame.
        """
        if len(self.times) == 1:
            return 1.0
        return float(self.times[-1] - self.times[0]) / (len(self.times) - 1)

    def wait(self, now: float) -> float:
        """Return the time until the next frame is due [s]; infinite while paused or finished."""
        if self.finished:
            return math.inf
        if self.paused:
            return 0.0 if self._peek else math.inf
        return max(self._due_at(self._next, now) - now, 0.0)

    def due(self, now: float) -> Tick | None:
        """Return the next frame if it is due, otherwise None; omit frames that are too late.

        The newest due frame is never omitted.
        """
        if self.wait(now) > 0:
            return None
        last = len(self.times) - 1
        while self._next < last and self._is_stale(now):
            self._count_unshown(self._next)
            self._next += 1
        tick = self._show(self._next)
        self._next += 1
        if self._next > last:
            self._finish_or_loop(now)
        return tick

    def play(self, now: float) -> None:
        """Continue from the current position; if the clip is finished, restart it."""
        if self.finished:
            self.restart(now)
        elif self.paused:
            self.paused = False
            self._rebase(float(self.times[self._next]), now)

    def pause(self, now: float) -> None:
        """Pause; the last frame shown remains visible."""
        del now
        self.paused = True

    def toggle(self, now: float) -> None:
        """Play if paused or finished, otherwise pause."""
        if self.paused or self.finished:
            self.play(now)
        else:
            self.pause(now)

    def next(self, now: float) -> None:
        """Show the next frame while playback is paused.

        Raises:
            InputError: Playback is not paused, or it has finished.
        """
        del now
        if not self.paused or self.finished:
            limit = "Single frames are shown only while playback is paused and not at its end."
            raise InputError("next", self.position, limit, "Pause or restart first.")
        self._peek, self._shown_at = True, -math.inf

    def restart(self, now: float) -> None:
        """Go to the first frame and play."""
        self.paused = False
        self.seek(float(self.times[0]), now)

    def seek(self, time: float, now: float) -> None:
        """Go to the first frame whose time in the clip is `time` [s] or later.

        Differences up to `ROUNDING` are ignored.

        Raises:
            InputError: The time is outside the clip.
        """
        first, last = float(self.times[0]), float(self.times[-1])
        if not first - ROUNDING <= time <= last + ROUNDING:
            limit = f"The clip runs from {first:g} s to {last:g} s."
            raise InputError("seek", time, limit, "Seek to a time within the clip.")
        target = int(np.searchsorted(self.times, min(time, last) - ROUNDING))
        self._next, self._peek, self.finished = target, True, False
        self.position = float(self.times[target])
        self._splice(self.position)
        self._rebase(self.position, now)

    def set_speed(self, speed: float, now: float) -> None:
        """Change the speed without a jump in time; raise InputError if it is outside `SPEEDS`."""
        speed = checked_speed(speed)
        if self._start is not None:
            here = self._anchor + (now - self._start) * self.speed
            self._rebase(min(here, float(self.times[min(self._next, len(self.times) - 1)])), now)
        self.speed = speed

    def set_rate(self, rate: float | None) -> None:
        """Limit the number of frames shown per second; None removes the limit.

        Raises:
            InputError: The rate is not positive, or above the limit in `RATES`.
        """
        self.rate = _checked_rate(rate)

    def stamp_at(self, now: float) -> float:
        """Return the seconds of the clip played until `now`, which stay constant during a pause."""
        self._clock = max(self._clock, self._stamp or 0.0)
        if not self.paused and not self.finished and self._start is not None:
            next_one = float(self.times[self._next])
            here = min(self._anchor + (now - self._start) * self.speed, next_one)
            self._clock = max(self._clock, self._offset + here)
        return self._clock

    def report(self) -> str:
        """Describe in a sentence how many frames were shown, dropped and skipped."""
        text = f"{self.shown} frames shown, {self.dropped} dropped because late"
        return text + (f", {self.skipped} skipped to keep to {self.rate:g} Hz" if self.rate else "")

    def _is_stale(self, now: float) -> bool:
        if self.paused or self._due_at(self._next + 1, now) > now:
            return False
        return now - self._due_at(self._next, now) > self.lateness

    def _too_soon(self, time: float) -> bool:
        # The tolerance is 0.5 %, so that rounding does not skip frames of a 30 Hz clip with a limit
        # of 30 Hz.
        return self.rate is not None and time - self._shown_at < 0.995 * self.speed / self.rate

    def _show(self, index: int) -> Tick | None:
        self._peek = False
        time = float(self.times[index])
        if self._too_soon(time):
            self.skipped += 1
            return None
        self.shown += 1
        self._shown_at = self.position = time
        self._stamp = self._offset + time
        return Tick(index, time, self._stamp)

    def _count_unshown(self, index: int) -> None:
        if self._too_soon(float(self.times[index])):
            self.skipped += 1
        else:
            self.dropped += 1

    def _finish_or_loop(self, now: float) -> None:
        if not self.loop:
            self.finished = True
            return
        first, last = float(self.times[0]), float(self.times[-1])
        period = last - first + self.interval
        again = self._due_at(len(self.times) - 1, now) + self.interval / self.speed
        # Whole loops that passed during a long delay are counted as dropped.
        missed = max(int((now - again) * self.speed // period), 0)
        self.dropped += missed * len(self.times)
        self._stamp = self._offset + last + missed * period
        self._splice(first)
        self._next = 0
        self._rebase(first, again + missed * period / self.speed)

    def _splice(self, time: float) -> None:
        """Continue the time stamps after a jump in the clip: the next is one interval later."""
        if self._stamp is not None:
            self._offset = self._stamp + self.interval - time
        self._shown_at = -math.inf

    def _rebase(self, time: float, now: float) -> None:
        self._anchor, self._start = time, now

    def _due_at(self, index: int, now: float) -> float:
        if self._start is None:
            self._rebase(float(self.times[0]), now)
        assert self._start is not None
        return self._start + (float(self.times[index]) - self._anchor) / self.speed


def checked_speed(speed: float) -> float:
    """Check that a playback speed is within `SPEEDS`, and return it.

    Raises:
        InputError: The speed is outside `SPEEDS`.
    """
    slowest, fastest = SPEEDS
    if not slowest <= speed <= fastest:
        limit = f"The speed must lie between {slowest:g} and {fastest:g}."
        raise InputError("speed", speed, limit, "1 is real time, 0.1 ten times slower.")
    return speed


def _checked_rate(rate: float | None) -> float | None:
    if rate is not None and not 0 < rate <= RATES[1]:
        limit = f"It must be positive and at most {RATES[1]:g}."
        raise InputError("rate", rate, limit, "Without a rate, every frame is shown.")
    return rate
