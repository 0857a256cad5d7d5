"""The player's clock, without waiting: time is handed in."""

import math

import numpy as np
import pytest

from bridge.player import Player
from phy124.errors import InputError

TIMES = np.arange(10) / 10


def run(player, until, step=0.01, start=100.0):
    """Ask every `step` seconds; what was shown when."""
    shown = []
    for i in range(round(until / step) + 1):
        tick = player.due(start + i * step + 1e-9)
        if tick:
            shown.append((round(i * step, 6), tick.index, round(tick.stamp, 6)))
    return shown


def test_each_frame_at_its_time():
    player = Player(TIMES)
    assert run(player, 2) == [(i / 10, i, i / 10) for i in range(10)]
    assert player.finished
    assert (player.shown, player.dropped) == (10, 0)
    assert player.wait(200) == math.inf


def test_speed_scales_waiting_but_not_stamps():
    player = Player(TIMES, speed=2)
    assert run(player, 2) == [(i / 20, i, i / 10) for i in range(10)]


def test_slightly_late_frames_catch_up():
    player = Player(TIMES, lateness=0.15)
    player.due(0.0)
    # Frame 1 is 0.24 s late, frame 2 only 0.14 s.
    assert [player.due(0.34).index for _ in range(2)] == [2, 3]
    assert player.due(0.34) is None
    assert player.dropped == 1


def test_late_frames_are_dropped_and_counted():
    player = Player(TIMES, lateness=0)
    player.due(0.0)
    tick = player.due(0.57)
    assert (tick.index, player.dropped) == (5, 4)
    assert player.due(0.58) is None
    assert player.report() == "2 frames shown, 4 dropped because late"


def test_loop_stamps_go_on_growing():
    shown = run(Player(TIMES, loop=True), 2.95)
    assert [index for _, index, _ in shown] == [*range(10)] * 3
    np.testing.assert_allclose(
        [stamp for *_, stamp in shown], np.arange(30) / 10, rtol=0, atol=1e-9
    )
    np.testing.assert_allclose([when for when, *_ in shown], np.arange(30) / 10, atol=0.011)


def test_player_keeps_its_times_if_those_of_the_clip_change():
    times = TIMES.copy()
    player = Player(times, loop=True)
    times[:] = 0.0
    assert len(run(player, 1.95)) == 20


def test_long_stall_is_not_raced_through():
    player = Player(TIMES, loop=True, lateness=0)
    player.due(0.0)
    assert player.due(1000.05).index == 9
    # 1000 rounds of ten frames: one shown at the start, one at the stall, one from now on.
    tick = player.due(1000.05)
    assert (tick.index, player.shown) == (0, 3)
    assert player.dropped == 8 + 999 * 10
    assert tick.stamp == pytest.approx(1000.0)
    assert player.due(1000.06) is None


def test_pause_and_play():
    player = Player(TIMES)
    assert player.due(0.0).index == 0
    player.pause(0.05)
    assert player.wait(5.0) == math.inf
    assert player.due(5.0) is None
    player.play(9.0)
    assert player.due(9.0).index == 1
    assert player.wait(9.0) == pytest.approx(0.1)
    assert player.dropped == 0


def test_paused_start_shows_the_first_frame_only():
    player = Player(TIMES, paused=True)
    assert player.due(0.0).index == 0
    assert player.due(1.0) is None


def test_seek_shows_the_frame_even_while_paused():
    player = Player(TIMES)
    player.due(0.0)
    player.pause(0.0)
    player.seek(0.55, 1.0)
    tick = player.due(1.0)
    assert (tick.index, player.position) == (6, 0.6)
    assert player.due(2.0) is None


@pytest.mark.parametrize("fps", [24, 30, 60])
def test_seek_to_a_time_in_nanoseconds_shows_its_frame(fps):
    times = np.arange(240) / fps
    for index in range(240):
        player = Player(times, paused=True)
        player.seek(round(times[index] * 1e9) / 1e9, 0.0)
        assert player.position == times[index], "before the frame is shown"
        assert player.due(0.0).index == index


def test_stamps_grow_through_seeks_back_and_forth():
    player, stamps, now = Player(TIMES, loop=True), [], 0.0
    rng = np.random.default_rng(1)
    for _ in range(300):
        if rng.random() < 0.3:
            for _ in range(rng.integers(1, 4)):
                player.seek(rng.uniform(0, 0.9), now)
        if rng.random() < 0.1:
            player.set_speed(rng.uniform(0.1, 5), now)
        tick = player.due(now)
        stamps += [tick.stamp] if tick else []
        now += rng.uniform(0, 0.3)
    assert len(stamps) > 100
    assert (np.diff(stamps) > 0).all()


def test_restart_after_the_end():
    player = Player(TIMES)
    run(player, 1)
    player.play(300.0)
    tick = player.due(300.0)
    assert (tick.index, tick.stamp) == (0, pytest.approx(1.0))
    assert not player.finished


def test_speed_change_does_not_jump():
    player = Player(TIMES)
    player.due(0.0)
    player.set_speed(0.5, 0.05)
    assert player.wait(0.05) == pytest.approx(0.1)


def test_rate_leaves_frames_out_on_purpose():
    player = Player(np.arange(60) / 30, rate=10)
    shown = run(player, 2.1, step=0.001)
    assert [index for _, index, _ in shown] == list(range(0, 60, 3))
    assert (player.skipped, player.dropped) == (40, 0)
    assert "40 skipped to keep to 10 Hz" in player.report()


def test_rate_of_the_clip_itself_leaves_nothing_out():
    player = Player(np.arange(60) / 30, rate=30)
    run(player, 2.1, step=0.001)
    assert (player.shown, player.skipped, player.dropped) == (60, 0, 0)


def test_single_frame():
    player = Player(np.zeros(1))
    assert player.due(0.0).index == 0
    assert player.finished


@pytest.mark.parametrize("speed", [0, -1, 1e9, math.nan])
def test_bad_speed(speed):
    with pytest.raises(InputError, match=r"between 0\.01 and 100"):
        Player(TIMES, speed=speed)
    with pytest.raises(InputError, match=r"between 0\.01 and 100"):
        Player(TIMES).set_speed(speed, 0.0)


@pytest.mark.parametrize("time", [-0.1, 0.95, math.nan])
def test_seek_outside_the_clip(time):
    with pytest.raises(InputError, match=r"runs from 0 s to 0.9 s. Seek to a time within"):
        Player(TIMES).seek(time, 0.0)


@pytest.mark.parametrize("times", [[], [0.0, 0.0], [1.0, 0.5]])
def test_times_must_ascend(times):
    with pytest.raises(InputError, match="must ascend"):
        Player(np.array(times))


@pytest.mark.parametrize("rate", [0, 5000, float("nan")])
def test_bad_rate(rate):
    with pytest.raises(InputError, match="must be positive and at most 1000"):
        Player(TIMES, rate=rate)


def test_bad_rate_while_playing():
    player = Player(TIMES, rate=5)
    with pytest.raises(InputError, match="must be positive"):
        player.set_rate(-1)
    assert player.rate == 5


def test_next_shows_single_frames_while_paused():
    player = Player(TIMES, paused=True, rate=1)
    assert player.due(0.0).index == 0
    for index in (1, 2):
        player.next(index)
        assert player.due(index).index == index
        assert player.due(index) is None
    player.play(9.0)
    with pytest.raises(InputError, match="only while playback is paused"):
        player.next(9.0)


def test_next_ends_at_the_last_frame():
    player = Player(TIMES, paused=True)
    player.seek(0.9, 0.0)
    assert player.due(0.0).index == 9
    with pytest.raises(InputError, match="not at its end"):
        player.next(1.0)


def test_toggle():
    player = Player(TIMES)
    run(player, 1)
    player.toggle(300.0)
    assert (player.due(300.0).index, player.paused) == (0, False)
    player.toggle(300.05)
    assert player.paused
    player.toggle(301.0)
    assert not player.paused


def test_the_stamp_runs_on_between_frames_and_never_back():
    player, stamps, shown, now = Player(TIMES, loop=True), [], [], 0.0
    rng = np.random.default_rng(2)
    for _ in range(2000):
        now += rng.uniform(0, 0.02)
        if rng.random() < 0.01:
            player.seek(rng.uniform(0, 0.9), now)
        if rng.random() < 0.02:
            player.toggle(now)
        tick = player.due(now)
        stamps.append(player.stamp_at(now))
        if tick:
            shown.append((tick.stamp, stamps[-1]))
    assert (np.diff(stamps) >= 0).all()
    # A frame never comes with a stamp the clock has passed already, nor long before it.
    assert all(stamp == pytest.approx(clock, abs=0.03) for stamp, clock in shown)


def test_the_stamp_stands_still_while_paused():
    player = Player(TIMES)
    player.due(0.0)
    assert player.stamp_at(0.05) == pytest.approx(0.05)
    player.pause(0.05)
    assert player.stamp_at(0.07) == player.stamp_at(9.0)
