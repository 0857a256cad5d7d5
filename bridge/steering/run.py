"""A live run that other programs (peers) steer.

The class is not thread-safe: sinks call it from `listen`, in the thread that computes the frames.
Requests take effect in the next frame. If the same requests arrive at the same frames, the results
are identical in every byte.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from phy124.errors import InputError
from phy124.gaussians import Frame

from ..live import number, unknown
from ..options import Options
from ..player import checked_speed
from .inputs import Inputs, Remarks

if TYPE_CHECKING:
    from phy124.live import Live
from enum import IntEnum

WORDS = ("play", "pause", "toggle", "next", "restart")
DURATIONS = (0.001, 3600.0)
"""Shortest and longest duration of a wrench [s]."""
KNOWN = f"{', '.join(WORDS)}, step COUNT, speed FACTOR"
MOST_STEPS = 100_000
"""Largest number of steps that one request may ask for."""


GRAB_SECONDS, OLDEST_STAMP = 60.0, 2.0
"""Default time after which a grab ends, and default value of the largest age of a message [s]."""


def checked_duration(name: str, seconds: float) -> float:
    """Check a duration [s], which is the value of the option `name`.

    Raises:
        InputError: The duration is out of range.
    """
    shortest, longest = DURATIONS
    if not shortest <= seconds <= longest:
        limit = f"It must lie between {shortest:g} and {longest:g}."
        raise InputError(name, seconds, limit, "To use the default, remove the option.")
    return seconds


class SteeredRun:
    """A live run that other programs push, pause, step and reset; sinks show it as a playback."""

    rate: float | None = None
    loop, dropped = False, 0
    """Members of `Playback` that are constant, because a live run shows each frame exactly once."""

    def __init__(
        self,
        live: Live,
        options: Options,
        *,
        push_seconds: float = 0.1,
        grab_seconds: float = GRAB_SECONDS,
        oldest_stamp: float = OLDEST_STAMP,
        speed: float = 1.0,
        paused: bool = False,
    ) -> None:
        """Prepare the run; the first call of `advance` computes the first frame.

        Args:
            live: The run.
            options: Options that define how frames become messages.
            push_seconds: Time for which a wrench acts, unless a new wrench replaces it [s].
            grab_seconds: Time after which a grab ends, unless a new message moves the grab [s].
            oldest_stamp: Largest age of a message, determined from its time stamp [s].
            speed: Simulated seconds per real second.
            paused: Whether the run starts paused.

        Raises:
            InputError: The speed or a duration is out of range.
        """
        self.live, self.remarks = live, Remarks()
        self.epoch = options.epoch or 0.0
        """Time stamp of the first frame [s since 1970]."""
        self.inputs = Inputs(
            live,
            options,
            self.remarks,
            push_seconds=checked_duration("push_seconds", push_seconds),
            grab_seconds=checked_duration("grab_seconds", grab_seconds),
            oldest=checked_duration("oldest_stamp", oldest_stamp),
            now=lambda: self.epoch + self.position,
        )
        self.state = State.PAUSED if paused else State.PLAYING
        self.stopped: str | None = None
        self.speed = checked_speed(speed)
        self.shown, self.position = 0, 0.0
        self.show: Callable[[Frame], object] = lambda frame: None
        """Function that receives each frame; times count from the start or the last reset."""
        self.changed: Callable[[], object] = lambda: None
        self._ticks, self._note = 0, ""

    @property
    def fps(self) -> float:
        """Frames per simulated second."""
        return self.live.scene.time.fps

    @property
    def paused(self) -> bool:
        """Whether the simulated time stands still, because the run is paused or stopped."""
        return self.state in (State.PAUSED, State.STOPPED)

    @property
    def finished(self) -> bool:
        """Whether the run has ended."""
        return self.state is State.QUITTING or self.stopped is not None

    def stamp_at(self, now: float) -> float:
        """Return the time of the newest frame that has been computed [s]."""
        del now
        return self.position

    def advance(self) -> None:
        """Compute and show the next frame; end the run if the simulation fails permanently."""
        from phy124.simulation import Stopped

        self.inputs.apply()
        try:
            frame = self.live.step()
        except Stopped as stop:
            self.stopped = str(stop)
            self.enter(State.QUITTING)
            return
        finally:
            self._say_notes()
        self.position = self._ticks / self.fps
        self._ticks, self.shown = self._ticks + 1, self.shown + 1
        self.show(replace(frame, time=self.position))

    def steps(self, count: float) -> Iterator[int]:
        """Compute `count` frames as fast as possible. After each frame, yield the number of frames
        computed so far.

        Raises:
            InputError: The run is not paused, or the number is out of range.
        """
        self._must_be_paused(count)
        if not (0 <= count <= MOST_STEPS and count == int(count)):
            limit = f"it must be a whole number up to {MOST_STEPS:,}."
            raise InputError("steps", count, limit, "Request fewer steps at once.")
        for done in range(int(count)):
            self._must_be_paused(count)
            self.advance()
            if self.stopped is not None:
                raise InputError("steps", count, self.stopped, "The run has ended.")
            yield done + 1

    def _must_be_paused(self, count: float) -> None:
        if self.state is not State.PAUSED:
            limit = f"steps need a paused simulation, but it is {self.state.name.lower()}."
            raise InputError("steps", count, limit, "Pause it first.")

    def enter(self, state: State) -> None:
        """Change to another state; the state STOPPED also resets the run."""
        if state is State.STOPPED:
            self._restart(time=True)
        self.state = state
        self.changed()

    def reset(self, *, time: bool = True, state: bool = True) -> None:
        """Reset the object to its initial state, the time to 0, or both."""
        if state:
            self._restart(time=time)
        elif time:
            self._ticks, self.position = 0, 0.0
        self.changed()

    def command(self, text: str) -> None:
        """Carry out a command of `/phy124/command`.

        Raises:
            InputError: The command is unknown, or cannot be carried out in the current state.
        """
        word, *values = text.split() or [""]
        if word in WORDS and not values:
            self._carry_out(word)
        elif word == "step":
            for _ in self.steps(number(text, values, KNOWN)):
                pass
        elif word == "speed":
            self.speed = checked_speed(number(text, values, KNOWN))
            self.changed()
        else:
            raise unknown(text, KNOWN)

    def _carry_out(self, word: str) -> None:
        if word == "next":
            for _ in self.steps(1):
                pass
        elif word == "restart":
            self.reset()
        else:
            plays = word == "play" or (word == "toggle" and self.paused)
            self.enter(State.PLAYING if plays else State.PAUSED)

    def _restart(self, *, time: bool) -> None:
        self.live.reset()
        self.inputs.clear()
        if time:
            self._ticks = 0
        self.advance()

    def _say_notes(self) -> None:
        newest = self.live.notes[-1] if self.live.notes else ""
        if newest != self._note:
            self._note = newest
            self.remarks.add(newest)


class State(IntEnum):
    """States of `simulation_interfaces/msg/SimulationState`."""

    STOPPED = 0
    PLAYING = 1
    PAUSED = 2
    QUITTING = 3
