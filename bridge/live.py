"""Play a clip into a sink, or follow a running simulation, and accept commands."""

from __future__ import annotations

import logging
import math
import reprlib
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from types import TracebackType

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.io.clip import Clip

from .player import Player, checked_speed
from .sink import LONGEST_WAIT, LiveSink, Obey, Sink

Clock = Callable[[], float]
Look = Callable[[Frame], Frame]
REPORT_EVERY = 5.0
"""Time between two warnings about dropped frames [s]."""
SLOW = (
    "%d frames dropped so far: sending is slower than playback. Send fewer points "
    "(max_points), use the profile small, or lower the rate."
)
WORDS = ("play", "pause", "toggle", "next", "restart")
"""Commands without a value, each of which is a method of `Player`."""
KNOWN = f"{', '.join(WORDS)}, seek SECONDS, speed FACTOR, rate HZ, loop on|off"
log = logging.getLogger(__name__)


def play(
    clip: Clip,
    sink: LiveSink,
    player: Player,
    *,
    records: Sequence[Sink] = (),
    look: Look = lambda frame: frame,
    clock: Clock = time.monotonic,
    going: Callable[[], bool] | None = None,
    check: Callable[[], None] = lambda: None,
) -> None:
    """Play a clip until it ends.

    Args:
        clip: The clip.
        sink: Shows the clip, and receives commands.
        player: Decides which frame is due.
        records: Other sinks, which record the frames that are shown.
        look: Adds the pictures of cameras to a frame.
        clock: Function that returns the current time [s].
        going: Function that returns whether to continue, even after the last frame. If None,
            playback ends after the last frame.
        check: Function that is called before each frame; it may raise InputError.
    """

    def obey(text: str) -> str | None:
        refusal = _attempt(lambda: command(player, text, clock()))
        sink.show(player)
        return refusal

    logged, logged_at = (
        0,
        -math.inf,
    )  # number of dropped frames in the last warning, and time of the warning
    sink.show(player)
    while not player.finished if going is None else going():
        sink.listen(min(player.wait(clock()), LONGEST_WAIT), obey)
        tick = player.due(clock())
        if tick is None:
            continue
        check()
        frame = look(replace(clip.frame(tick.index, velocities=True), time=tick.stamp))
        sink.write(frame if sink.monotonic else replace(frame, time=tick.time))
        for record in records:
            record.write(frame)
        if player.finished:
            sink.show(player)
        if player.dropped > logged and clock() - logged_at >= REPORT_EVERY:
            log.warning(SLOW, player.dropped)
            logged, logged_at = player.dropped, clock()


def follow(
    frames: Iterable[Frame],
    sink: LiveSink,
    *,
    records: Sequence[Sink] = (),
    speed: float = 1.0,
) -> None:
    """Send each frame of a running simulation when the frame has been computed and is due.

    A simulation that is faster than `speed` is slowed down. A pause also pauses the simulation,
    after the current frame. Commands that seek or restart are refused, because they need a finished
    clip.

    Args:
        frames: The frames, in the order in which they are computed.
        sink: Shows the frames, and receives commands.
        records: Other sinks, which record the frames.
        speed: Largest number of simulated seconds per real second.
    """
    pacer = Pacer(speed, time.monotonic)

    def obey(text: str) -> str | None:
        refusal = _attempt(lambda: pacer.command(text))
        sink.show(pacer)
        return refusal

    sink.show(pacer)
    with Listener(sink, obey) as listener:
        for frame in frames:
            listener.check()
            while (wait := pacer.wait(frame.time)) > 0:
                listener.wait(wait)
            pacer.note(frame)
            for each in (sink, *records):
                each.write(frame)
    pacer.finished = True
    sink.show(pacer)


def command(player: Player, text: str, now: float) -> None:
    """Carry out a text command that controls the playback of a clip.

    Raises:
        InputError: There is no such command, or the command cannot be carried out now.
    """
    word, *values = text.split() or [""]
    if word in WORDS and not values:
        getattr(player, word)(now)
    elif word == "seek":
        player.seek(number(text, values), now)
    elif word == "speed":
        player.set_speed(number(text, values), now)
    elif word == "rate":
        player.set_rate(number(text, values) or None)
    elif text in ("loop on", "loop off"):
        player.loop = text == "loop on"
    else:
        raise unknown(text)


class Pacer:
    """Decides when a frame of a running simulation may be shown; thread-safe."""

    rate: float | None = None
    loop, dropped = False, 0
    """Members of `Playback` that are constant here, because a running simulation shows each frame
    once.
    """

    def __init__(self, speed: float, clock: Clock) -> None:
        self.speed = checked_speed(speed)
        self.paused = self.finished = False
        self.shown, self.position = 0, 0.0
        self._clock = clock
        self._anchor: tuple[float, float] | None = None  # clock reading and time in the clip
        self._lock = threading.Lock()

    def wait(self, time: float) -> float:
        """Return the time until the frame at `time` [s] may be shown [s]; infinite while paused."""
        with self._lock:
            return self._wait(time, self._clock())

    def _wait(self, time: float, now: float) -> float:
        if self.paused:
            # After a pause, the next frame is due immediately.
            self._anchor = None
            return math.inf
        start, first = self._anchor = self._anchor or (now, time)
        ahead = (time - first) / self.speed - (now - start)
        if ahead < 0:
            # The simulation is slower than playback. Later due times are shifted, so that playback
            # does not try to catch up.
            self._anchor = now, time
        return max(ahead, 0.0)

    def note(self, frame: Frame) -> None:
        """Count a frame that is shown now, and store its time as the position."""
        self.shown, self.position = self.shown + 1, frame.time

    def stamp_at(self, now: float) -> float:
        """Return the time of the newest frame that has been computed [s]."""
        del now
        return self.position

    def command(self, text: str) -> None:
        """Carry out a command that pauses, plays or changes the speed.

        Raises:
            InputError: The command neither pauses nor plays nor changes the speed.
        """
        word, *values = text.split() or [""]
        if word in ("play", "pause", "toggle") and not values:
            self.paused = not self.paused if word == "toggle" else word == "pause"
        elif word == "speed":
            speed = checked_speed(number(text, values))
            with self._lock:
                self.speed, self._anchor = speed, None
        else:
            limit = (
                "While the simulation runs, the only commands are play, "
                "pause, toggle and speed FACTOR."
            )
            raise InputError("command", text, limit, "For the other commands, play the saved clip.")


def _attempt(action: Callable[[], None]) -> str | None:
    try:
        action()
    except InputError as error:
        log.warning(str(error))
        return str(error)
    return None


def number(text: str, values: list[str], known: str = KNOWN) -> float:
    """Return the number that follows the name of a command.

    Raises:
        InputError: The command has no number, or more than one.
    """
    try:
        (number,) = map(float, values)
    except ValueError:
        raise unknown(text, known) from None
    return number


def unknown(text: str, known: str = KNOWN) -> InputError:
    """Return the error for an unknown command."""
    limit = f"The commands are: {known}."
    return InputError("command", reprlib.repr(text), limit, "Send one of them.")


class Listener:
    """Listens to a sink in a thread while the main thread computes; passes commands to `obey`."""

    def __init__(self, sink: LiveSink, obey: Obey) -> None:
        self._sink, self._obey = sink, obey
        self._heard, self._over = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)

    def __enter__(self) -> Listener:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Raise the error that ended the listening, unless another error was raised."""
        self._over.set()
        self._thread.join()
        if error is None:
            self.check()

    def wait(self, seconds: float) -> None:
        """Wait up to `seconds` for a command.

        If an error has ended the listening, such as a KeyboardInterrupt, raise this error.
        """
        self._heard.wait(min(seconds, LONGEST_WAIT))
        self._heard.clear()
        self.check()

    def check(self) -> None:
        """Raise the error that ended the listening, if there was an error."""
        if self._error is not None:
            raise self._error

    def _listen(self) -> None:
        try:
            while not self._over.is_set():
                self._sink.listen(LONGEST_WAIT, self._pass_on)
        except BaseException as error:
            # `check` raises the error in the main thread, which may be waiting for a command.
            self._error = error
            self._heard.set()

    def _pass_on(self, text: str) -> str | None:
        answer = self._obey(text)
        self._heard.set()
        return answer
