"""Playing and following, with a clock that only runs when somebody waits."""

import logging
from dataclasses import dataclass, field

import numpy as np
import pytest
from bridge_clips import random_clip

from bridge import live
from bridge.player import Player
from phy124.errors import InputError


class Clock:
    def __init__(self):
        self.now = 50.0

    def __call__(self):
        return self.now


@dataclass
class FakeSink:
    """Remembers frames and says commands at set times."""

    clock: Clock
    script: list = field(default_factory=list)
    cost: float = 0.0
    monotonic: bool = True
    shown: list = field(default_factory=list)
    answers: list = field(default_factory=list)
    states: list = field(default_factory=list)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def write(self, frame):
        self.shown.append((round(self.clock.now - 50, 6), frame.index, round(frame.time, 6)))
        self.clock.now += self.cost

    def listen(self, seconds, obey):
        until = self.clock.now + seconds
        if self.script and 50 + self.script[0][0] <= until:
            when, text = self.script.pop(0)
            self.clock.now = max(self.clock.now, 50.0 + when)
            self.answers.append(obey(text))
        else:
            self.clock.now = until

    def audience(self):
        return "Heard by the test."

    def show(self, player):
        self.states.append((player.paused, player.finished, player.speed))


def play(script=(), frames=6, cost=0.0, sink_options=None, **options):
    clock = Clock()
    sink = FakeSink(clock, [*script], cost, **(sink_options or {}))
    clip = random_clip(frames=frames, fps=10)
    player = Player(clip.times, **options)
    live.play(clip, sink, player, clock=clock)
    return sink, player


def test_plays_each_frame_at_its_time():
    sink, _ = play()
    assert sink.shown == [(i / 10, i, i / 10) for i in range(6)]
    assert sink.states[-1] == (False, True, 1.0)


def test_commands_are_obeyed_and_wrong_ones_answered(caplog):
    script = [(0.15, "pause"), (0.2, "dance"), (0.3, "seek 99"), (1.0, "play"), (1.02, "speed 2")]
    sink, player = play(script)
    whens, indices, stamps = zip(*sink.shown, strict=True)
    assert indices == (0, 1, 2, 3, 4, 5)
    assert np.allclose(whens, [0, 0.1, 1.0, 1.06, 1.11, 1.16])
    assert np.allclose(stamps, np.arange(6) / 10)
    assert sink.answers[:2] == [None, sink.answers[1]]
    assert (
        "Known are: play, pause, toggle, next, restart, seek SECONDS, speed FACTOR"
        in sink.answers[1]
    )
    assert "The clip runs from 0 s to 0.5 s" in sink.answers[2]
    assert "dance" in caplog.text
    assert player.dropped == 0


def test_every_command_reaches_the_player():
    player = Player(np.arange(3.0), loop=True)
    for text in ("toggle", "next", "rate 10", "loop off", "speed 2"):
        live.command(player, text, 0.0)
    assert (player.paused, player.rate, player.loop, player.speed) == (True, 10, False, 2)
    live.command(player, "rate 0", 0.0)
    assert player.rate is None


@pytest.mark.parametrize(
    "text", ["", "loop", "loop maybe", "rate x", "play now", "seek", "seek 1 2", "seek x", "speed"]
)
def test_malformed_commands(text):
    with pytest.raises(InputError, match="Send one of them"):
        live.command(Player(np.arange(3.0)), text, 0.0)


def test_seek_jumps_and_stamps_go_on():
    sink, _ = play([(0.25, "seek 0.0")])
    assert [index for _, index, _ in sink.shown] == [0, 1, 2, 0, 1, 2, 3, 4, 5]
    assert (np.diff([stamp for *_, stamp in sink.shown]) > 0).all()


def test_sinks_with_their_own_time_line_see_clip_time():
    sink, _ = play([(0.25, "restart")], sink_options={"monotonic": False})
    assert [time for *_, time in sink.shown] == [0, 0.1, 0.2, 0, 0.1, 0.2, 0.3, 0.4, 0.5]


def test_slow_sinks_drop_frames_loudly(caplog):
    with caplog.at_level(logging.WARNING):
        sink, player = play(cost=0.25, frames=30)
    assert player.dropped > 10
    assert player.dropped + player.shown == 30
    assert len(sink.shown) == player.shown
    assert "frames dropped so far: sending is slower than playback" in caplog.text
    assert len(caplog.records) <= 2


def test_records_get_what_is_shown():
    clock = Clock()
    sink, record = FakeSink(clock), FakeSink(clock)
    clip = random_clip(frames=3, fps=10)
    live.play(clip, sink, Player(clip.times), records=[record], clock=clock)
    assert record.shown == sink.shown


def simulated(clock, clip, seconds_per_frame, made):
    for frame in clip.frames():
        clock.now += seconds_per_frame
        made.append(frame.index)
        yield frame


def test_a_subscriber_sees_each_frame_before_the_next_is_computed():
    clock, made = Clock(), []
    sink = FakeSink(clock)
    clip = random_clip(frames=5, fps=10)
    orders = []
    write = sink.write
    sink.write = lambda frame: (orders.append((frame.index, len(made))), write(frame))
    live.follow(simulated(clock, clip, 1.0, made), sink, clock=clock)
    assert orders == [(i, i + 1) for i in range(5)]
    assert [when for when, *_ in sink.shown] == [1, 2, 3, 4, 5]


def test_a_fast_simulation_is_held_to_real_time():
    clock, made = Clock(), []
    sink = FakeSink(clock)
    live.follow(simulated(clock, random_clip(frames=5, fps=10), 0.001, made), sink, clock=clock)
    assert np.allclose([when for when, *_ in sink.shown], np.arange(5) / 10 + 0.001, atol=0.002)


def test_after_a_slow_stretch_frames_are_not_rushed():
    clock = Clock()
    sink = FakeSink(clock)
    clip = random_clip(frames=6, fps=10)

    def stuttering():
        for frame in clip.frames():
            clock.now += 2.0 if frame.index == 2 else 0.0
            yield frame

    live.follow(stuttering(), sink, clock=clock)
    assert np.allclose(np.diff([when for when, *_ in sink.shown]), [0.1, 2.0, 0.1, 0.1, 0.1])


def test_pause_lets_the_simulation_rest():
    clock, made = Clock(), []
    sink = FakeSink(clock, [(1.5, "pause"), (30.0, "seek 1"), (60.0, "play")])
    live.follow(simulated(clock, random_clip(frames=4, fps=10), 1.0, made), sink, clock=clock)
    whens = [when for when, *_ in sink.shown]
    assert whens[0] == 1.0
    assert whens[1] >= 60.0
    assert whens[-1] < 64.0
    assert made == [0, 1, 2, 3]
    assert sink.answers[0] is sink.answers[2] is None
    assert "only play, pause, toggle and speed" in sink.answers[1]
