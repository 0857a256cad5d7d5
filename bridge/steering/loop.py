"""The loop of a steered run: frames when they are due, and in between what peers send."""

from __future__ import annotations

import time
from collections.abc import Sequence

from phy124.errors import InputError
from phy124.gaussians import Frame

from ..controls import Controls
from ..options import Options
from ..sink import LONGEST_WAIT, LiveSink, Recorder
from ..topics import FACTOR, STEERED, TF, contact
from .contacts import contact_messages, factor_message
from .run import SteeredRun
from .standard import Standard

ROUNDS = 8
"""How often a sink is listened to between two frames, however late the next one is."""


def controls(run: SteeredRun, accuracy: str, *, action: bool) -> Controls:
    """What a sink offers to those who steer a run.

    Args:
        run: The run.
        accuracy: How exact it is, in a sentence for diagnostics.
        action: Whether the sink has actions.
    """
    from phy124.monitor.wrenches import wall_names

    walls = wall_names(run.live.scene.with_solids().boundaries)
    return Controls(
        node=STEERED,
        published=(TF, FACTOR, *(contact(at) for at in (*walls, *run.live.pairs))),
        heard=run.inputs.heard,
        services=Standard(run, action=action).services,
        steps=run.steps if action else None,
        refused=run.remarks.add,
        clock=True,
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
    frames: int | None = None,
) -> None:
    """Let a run go on until it is quit.

    Args:
        run: The run.
        sink: Where it is shown and from where it is steered, opened with its `controls`.
        options: How frames become messages, with an epoch.
        records: Recordings that get each frame and the wrenches.
        frames: End after so many frames; None: when it is quit.
    """
    from phy124.live import RealTime

    listening = _Listening(run, sink)
    run.show = _Outlets(run, sink, options, records).show
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
            sink.send(factor_message(clock.wait(), options, run.position))
    sink.show(run)


class _Outlets:
    """Where a frame goes, and what is sent with it."""

    def __init__(
        self, run: SteeredRun, sink: LiveSink, options: Options, records: Sequence[Recorder]
    ) -> None:
        self._live, self._sink, self._options, self._records = run.live, sink, options, records

    def show(self, frame: Frame) -> None:
        for each in (self._sink, *self._records):
            each.write(frame)
        for message in contact_messages(self._live, self._options, frame.time):
            for each in (self._sink, *self._records):
                each.send(message)


class _Listening:
    """Listens to the sink, and carries out the commands that come as text."""

    def __init__(self, run: SteeredRun, sink: LiveSink) -> None:
        self._run, self._sink = run, sink

    def once(self, seconds: float) -> None:
        """Until something comes, at most so many seconds."""
        self._sink.listen(seconds, self._obey)

    def briefly(self) -> None:
        """To what has come already."""
        for _ in range(ROUNDS):
            self.once(0.0)

    def during(self, seconds: float) -> None:
        """For so many seconds."""
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
