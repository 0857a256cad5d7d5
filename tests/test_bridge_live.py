"""Playing and following, with a clock that only runs when somebody waits."""

import logging
import queue
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from bridge import live
from bridge.player import Player
from phy124.errors import InputError
from support.clips import random_clip


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
        "The commands are: play, pause, toggle, next, restart, seek SECONDS, speed FACTOR"
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


TIMEOUT = 300.0
"""Seconds after which a test that waits gives up."""


class Asked:
    """A sink whose other end asks and waits for the answer, as a service call does."""

    monotonic = True

    def __init__(self):
        self.requests = queue.Queue()
        self.shown, self.states = [], []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def ask(self, text):
        answers = queue.Queue()
        self.requests.put((text, answers))
        return answers.get(timeout=TIMEOUT)

    def write(self, frame):
        self.shown.append(frame.index)

    def listen(self, seconds, obey):
        try:
            text, answers = self.requests.get(timeout=seconds)
        except queue.Empty:
            return
        answers.put(obey(text))

    def audience(self):
        return "Asked by the test."

    def show(self, playback):
        self.states.append((playback.paused, playback.finished, playback.speed))


def test_subscriber_gets_a_frame_before_the_next_one():
    sink, before = Asked(), []

    def simulated():
        for frame in random_clip(frames=5, fps=1000).frames():
            before.append([*sink.shown])
            yield frame

    live.follow(simulated(), sink)
    assert before == [[], [0], [0, 1], [0, 1, 2], [0, 1, 2, 3]]
    assert sink.shown == [0, 1, 2, 3, 4]
    assert sink.states == [(False, False, 1.0), (False, True, 1.0)]


def test_commands_are_answered_while_a_frame_is_computed():
    sink, answers = Asked(), []

    def simulated():
        for frame in random_clip(frames=3, fps=1000).frames():
            if frame.index == 1:
                # Nobody is back in `follow` before these are answered.
                answers.extend(map(sink.ask, ["pause", "speed 5", "seek 1", "speed 0", "play"]))
            yield frame

    live.follow(simulated(), sink)
    assert answers[:2] == [None, None]
    assert "only commands are play, pause, toggle and speed" in answers[2]
    assert "The speed must lie between" in answers[3]
    assert answers[4] is None
    assert [state[0] for state in sink.states] == [False, True, True, True, True, False, False]
    assert sink.states[-1] == (False, True, 5.0)
    assert sink.shown == [0, 1, 2]


def test_pause_lets_the_simulation_rest_after_the_frame_in_hand():
    sink, made, seen = Asked(), [], []

    def simulated():
        for frame in random_clip(frames=4, fps=1000).frames():
            made.append(frame.index)
            if frame.index == 1:
                sink.ask("pause")
            yield frame

    def look_and_play():
        while not sink.states or not sink.states[-1][0]:
            time.sleep(0.001)
        for _ in range(3):
            sink.ask("speed 2")
            seen.append(([*made], [*sink.shown]))
        sink.ask("toggle")

    looking = threading.Thread(target=look_and_play, daemon=True)
    looking.start()
    live.follow(simulated(), sink)
    looking.join(TIMEOUT)
    assert seen == [([0, 1], [0])] * 3
    assert sink.shown == made == [0, 1, 2, 3]


def test_end_of_listening_ends_the_run():
    """ROS that is shut down, for instance; also while the simulation waits."""
    sink = Asked()

    def listen(seconds, obey):
        obey("pause")
        raise KeyboardInterrupt

    sink.listen = listen
    with pytest.raises(KeyboardInterrupt):
        live.follow(random_clip(frames=4, fps=0.1).frames(), sink)
    assert len(sink.shown) < 4
    assert "listener" not in {thread.name for thread in threading.enumerate()}


def test_an_interrupted_simulation_ends_the_listening():
    def simulated():
        yield random_clip().frame(0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        live.follow(simulated(), Asked())
    assert "listener" not in {thread.name for thread in threading.enumerate()}


def paced(costs, *, fps=10, speed=1.0):
    """When each frame is shown that takes so long to compute, by a clock of its own."""
    clock, shown = Clock(), []
    pacer = live.Pacer(speed, clock)
    for index, cost in enumerate(costs):
        clock.now += cost
        clock.now += pacer.wait(index / fps)
        shown.append(clock.now - 50)
    return shown


def test_a_fast_simulation_is_held_to_real_time():
    assert np.allclose(paced([0.001] * 5), np.arange(5) / 10 + 0.001)
    assert np.allclose(paced([0.001] * 5, speed=4), np.arange(5) / 40 + 0.001)


def test_after_a_slow_stretch_frames_are_not_rushed():
    shown = paced([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    assert np.allclose(np.diff(shown), [0.1, 2.0, 0.1, 0.1, 0.1])


def test_a_change_of_speed_does_not_jump():
    clock = Clock()
    pacer = live.Pacer(1.0, clock)
    assert pacer.wait(0.0) == 0
    clock.now += 5.0
    pacer.wait(5.0)
    pacer.command("speed 0.5")
    assert pacer.wait(5.1) == 0
    assert pacer.wait(5.2) == pytest.approx(0.2)
