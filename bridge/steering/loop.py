"""Computes the frames of a steered run when they are due, sends messages, and reads inputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from phy124.errors import InputError
from phy124.gaussians import Frame

from .. import cdr
from ..cameras import SeenFrame
from ..options import Options
from ..sink import LONGEST_WAIT, LiveSink, Recorder
from ..topics import FACTOR, PUSH, STEERED, TF, Controls, Message, contact
from .inputs import centre_frame, centre_frames, object_frame
from .run import SteeredRun
from .standard import Standard

if TYPE_CHECKING:
    from phy124.live import Live

IDLE = 3
"""Number of reads without a message after which the queue is assumed to be empty."""
READING, SHARE = 0.02, 0.25
"""Limit on the time for which messages are read before each frame: `READING` [s] or, if this is
longer, the fraction `SHARE` of the time since the last reading. In a slow run, more messages arrive
between two readings.
"""
FLOOD = "Messages arrive faster than they are read: only the newest of each topic are kept."


def controls(run: SteeredRun, options: Options, accuracy: str, *, action: bool) -> Controls:
    """Return the controls that a sink offers to peers, so that they can steer a run.

    Args:
        run: The run.
        options: Options that define how frames become messages.
        accuracy: Sentence about the accuracy of the run, for the diagnostics.
        action: Whether the sink supports actions.
    """
    return Controls(
        node=STEERED,
        published=(TF, FACTOR, *map(contact, run.live.contact_names)),
        heard=run.inputs.heard,
        services=Standard(run, options, action=action).services,
        steps=run.steps if action else None,
        refused=run.remarks.add,
        clock=True,
        patient=False,
        values=lambda: {
            "accuracy": accuracy,
            "held": run.live.holds,
            "remarks": run.remarks.count,
            "last remark": run.remarks.last,
        },
    )


def steer(
    run: SteeredRun,
    sink: LiveSink,
    options: Options,
    *,
    records: Sequence[Recorder] = (),
    look: Callable[[Frame], Frame] = lambda frame: frame,
    frames: int | None = None,
) -> None:
    """Compute frames until a peer quits the run.

    Args:
        run: The run.
        sink: Sink that shows the run and receives inputs, opened with its `controls`.
        options: Options that define how frames become messages, with an epoch (time of the start).
        records: Recordings of the frames and wrenches.
        look: Adds the pictures of cameras to a frame.
        frames: Number of frames after which the run ends, or None.
    """
    from phy124.live import RealTime

    run.epoch = options.epoch or 0.0
    listening, outlets = _Listening(run, sink), (sink, *records)

    def show(frame: Frame) -> None:
        seen = look(frame)
        run.inputs.see(seen.pictures if isinstance(seen, SeenFrame) else ())
        for outlet in outlets:
            outlet.write(seen)
        for message in contact_messages(run.live, options, frame.time):
            for outlet in outlets:
                outlet.send(message)

    run.show = show
    run.changed = lambda: sink.show(run)
    sink.show(run)
    run.advance()
    clock = RealTime(run.fps, sleep=listening.during)
    while not run.finished and (frames is None or run.shown < frames):
        listening.briefly()
        if run.paused:
            listening.once(LONGEST_WAIT)
            clock.restart()
        elif not run.finished:
            run.advance()
            clock.speed = run.speed
            factor = clock.wait()
            stamp = cdr.stamp(run.epoch, run.position)
            sink.send(cdr.message(FACTOR, stamp, {"data": factor}))
    sink.show(run)


class _Listening:
    def __init__(self, run: SteeredRun, sink: LiveSink) -> None:
        self._run, self._sink = run, sink
        self._last = time.perf_counter()

    def once(self, seconds: float) -> bool:
        return bool(self._sink.listen(seconds, self._obey))

    def briefly(self) -> None:
        inputs, idle = self._run.inputs, 0
        before, start = inputs.wrenches, time.perf_counter()
        until = start + max(READING, SHARE * (start - self._last))
        while idle < IDLE and time.perf_counter() <= until:
            idle = 0 if self.once(0.0) else idle + 1
        if idle == 0 or inputs.wrenches - before >= PUSH.depth:
            self._run.remarks.add(FLOOD)
        self._last = time.perf_counter()

    def during(self, seconds: float) -> None:
        until = time.perf_counter() + seconds
        while (left := until - time.perf_counter()) > 0:
            self.once(min(left, LONGEST_WAIT))

    def _obey(self, text: str) -> str | None:
        try:
            self._run.command(text)
        except InputError as error:
            self._run.remarks.add(str(error))
            return str(error)
        return None


def contact_messages(live: Live, options: Options, seconds: float) -> list[Message]:
    """Return messages with the forces and torques on walls and between objects.

    Torques on a wall are about the centre of mass of all objects. Torques on an object are about
    that object's centre of mass. The header names the coordinate frame.

    The time `seconds` of the frame counts from the epoch.
    """
    stamp, centre = cdr.stamp(options.epoch or 0.0, seconds), live.centre
    when, whole = cdr.time(stamp), centre_frame(options)
    frames = centre_frames(live, options)
    header = {"stamp": when, "frame_id": options.frame_id}
    axes = {"rotation": (0.0, 0.0, 0.0, 1.0)}  # those of the world
    links = [
        {
            "header": header,
            "child_frame_id": child,
            "transform": {"translation": at.tolist(), **axes},
        }
        for child, at in frames.items()
    ]
    messages = [cdr.message(TF, stamp, {"transforms": links})]
    for name, (force, torque) in live.contacts().items():
        acted_on = live.pairs.get(name)
        frame = whole if acted_on is None else object_frame(options, acted_on)
        torque = torque + np.cross(centre - frames[frame], force)
        content = {
            "header": {"stamp": when, "frame_id": frame},
            "wrench": {"force": force.tolist(), "torque": torque.tolist()},
        }
        messages.append(cdr.message(contact(name), stamp, content))
    return messages
