"""Time profiles: what the device reads from a table, and that kicks tile time without gaps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from pydantic import TypeAdapter, ValidationError

from phy124.mpm.tracks import AnyProfile, Constant, Keyframes, Ramp, Sine, Table, Track, Tracks

REALS = [wp.float32, wp.float64]


def sample(track: Track, time: float, kick=0.0, drift=0.0, real: Any = wp.float64):
    """Value, whether active, and rate of one track at a time."""
    tracks = Tracks(real=real, device="cpu")
    slot = tracks.add(track)
    clock = wp.array([kick, drift, time], dtype=real)
    tracks.upload(clock)
    tracks.record().launch()
    value, rate = tracks.values.numpy()[slot], tracks.rates.numpy()[slot]
    return value[0], value[3], rate[0]


def scaled(profile: Table, start: float = 0.0, end: float = 1e30, *, mean: bool = False) -> Track:
    return Track.of_profile((2.0, 0.0, 0.0), profile, start, end, mean=mean)


@pytest.mark.parametrize(
    ("profile", "time", "expected"),
    [
        (Constant(), 5.0, 1.0),
        (Ramp(duration=0.5), 0.1, 0.2),
        (Ramp(duration=0.5), 3.0, 1.0),
        (Ramp(duration=2.0, first=1.0, last=-1.0), 0.5, 0.5),
        (Sine(frequency=2.0), 0.125, 1.0),
        (Sine(frequency=2.0), 10.375, -1.0),
        (Sine(frequency=1.0, phase=90.0, offset=3.0), 7.0, 4.0),
        (Keyframes(times=(0.2, 0.4, 1.0), factors=(1.0, 3.0, 0.0)), 0.1, 1.0),
        (Keyframes(times=(0.2, 0.4, 1.0), factors=(1.0, 3.0, 0.0)), 0.3, 2.0),
        (Keyframes(times=(0.2, 0.4, 1.0), factors=(1.0, 3.0, 0.0)), 9.0, 0.0),
        (Keyframes(times=(0.0, 1.0), factors=(0.0, 4.0), repeat=True), 7.25, 1.0),
    ],
)
@pytest.mark.parametrize("real", REALS)
def test_profiles_are_read_where_they_are_sampled(profile, time, expected, real):
    value, active, _ = sample(scaled(profile), time, real=real)
    assert value == pytest.approx(2 * expected, abs=2e-5)
    assert active == 1
    later, active, _ = sample(scaled(profile, start=0.5), time + 0.5, real=real)
    assert later == pytest.approx(value, abs=1e-4)


def test_a_track_is_active_in_its_window_only():
    track = scaled(Constant(), 0.2, 0.4)
    assert [sample(track, t)[1] for t in (0.0, 0.19, 0.2, 0.39, 0.4, 5.0)] == [0, 0, 1, 1, 0, 0]


def test_largest_value_of_a_track_in_an_interval():
    keys = ((0.0, (0.0, 0.0, 0.0)), (1.0, (3.0, 4.0, 0.0)), (3.0, (3.0, 4.0, 0.0)))
    track = Track(keys, start=2.0, end=5.0, origin=2.0)
    times = [(0, 1), (2.5, 2.6), (3.5, 4), (5.5, 9)]
    assert [track.acts(*time) for time in times] == [False, True, True, False]
    assert [track.largest(*time) for time in times] == [0, 5, 5, 0]
    assert [track.fastest(*time) for time in times] == [0, 5, 0, 0]
    steady = scaled(Constant(), 2.0, 5.0)
    assert [steady.changes(*time) for time in [(0, 1), (1, 2.5), (3, 4), (4, 6)]] == [0, 1, 0, 1]
    begins, ends = steady.start, steady.end
    assert not steady.changes(begins - 1, begins) and not steady.changes(ends - 1, ends)
    assert steady.changes(begins, begins + 1) and steady.changes(ends, ends + 1)
    assert track.changes(3, 4) and not scaled(Constant()).changes(0, 9)
    # One that repeats is as fast at any time after its start.
    assert scaled(Sine(frequency=1.0)).fastest(70.1, 70.2) == pytest.approx(12.56, rel=0.01)
    assert scaled(Sine(frequency=1.0), 2.0, 99.0).fastest(0, 2) == 0


def test_largest_jump_is_the_largest_change_of_the_velocity():
    """A track rises at 2 per second, falls at 3 per second, and stops at 3 s."""
    keys = ((0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, 2.0, 0.0)), (2.0, (0.0, -1.0, 0.0)))
    track = Track(keys, origin=1.0)
    assert [track.largest_jump(end) for end in (1.0, 1.5, 2.5, 9.0)] == [0, 2, 5, 5]
    valley = tuple((float(t), (0.0, 0.0, z)) for t, z in enumerate((0.0, -3.0, -3.0, 0.0)))
    again = Track(valley, period=3.0)
    assert [again.largest_jump(end) for end in (2.5, 3.5)] == [3, 6]
    assert scaled(Constant()).largest_jump(9.0) == 0


def test_rates_are_slopes_and_zero_outside():
    track = Track(((0.0, (0.0, 0.0, 0.0)), (0.5, (3.0, 0.0, 0.0))), origin=1.0)
    assert [sample(track, t)[2] for t in (0.5, 1.0, 1.2, 1.5, 9.0)] == [0, 6, 6, 0, 0]
    repeated = Track(track.keys, origin=1.0, period=0.5)
    assert [sample(repeated, t)[0] for t in (0.6, 1.25, 1.75)] == pytest.approx([0.0, 1.5, 1.5])


def test_a_force_is_its_mean_over_the_kick():
    """The kick that straddles the edge of a window counts with its fraction."""
    track = scaled(Constant(), 0.2, 0.4, mean=True)
    assert sample(track, 0.3, 0.1, 0.1)[0] == pytest.approx(2.0)
    assert sample(track, 0.2, 0.1, 0.1)[0] == pytest.approx(1.0)
    assert sample(track, 0.39, 0.1, 0.1)[0] == pytest.approx(1.2)
    assert sample(track, 0.5, 0.1, 0.1)[0] == 0.0
    always = scaled(Constant(), mean=True)
    assert sample(always, 0.0, 0.05, 0.1)[0] == 2.0, "not a bit off, or scaled units would differ"


@pytest.mark.parametrize(
    "profile",
    [
        Constant(),
        Ramp(duration=0.3),
        Sine(frequency=3.3, phase=20.0, offset=0.2),
        Keyframes(times=(0.0, 0.05, 0.3, 0.31), factors=(0.0, 5.0, 1.0, 0.0), repeat=True),
    ],
    ids=lambda profile: profile.kind,
)
@pytest.mark.parametrize(("real", "close"), [(wp.float32, 1e-5), (wp.float64, 1e-12)])
def test_kicks_of_any_substeps_add_up_to_the_impulse(profile, real, close, rng):
    """Sum of kick times mean = integral of the table, whatever the substeps."""
    tracks = Tracks(real=real, device="cpu")
    slot = tracks.add(scaled(profile, 0.1, 0.77, mean=True))
    clock = wp.zeros(3, dtype=real)
    tracks.upload(clock)
    launch = tracks.record()
    total, time, last = 0.0, 0.0, 0.0
    while time < 1.0:
        dt = rng.uniform(0.001, 0.03)
        clock.assign(np.array([(last + dt) / 2, dt, time]))
        launch.launch()
        total += (last + dt) / 2 * tracks.values.numpy()[slot, 0]
        time, last = time + dt, dt
    times, factors = profile.table()
    fine = np.linspace(0, 0.67, 670001)
    local = fine % profile.period if profile.period else fine
    at = 2 * np.interp(local, times, factors)
    exact = ((at[1:] + at[:-1]) / 2 * np.diff(fine)).sum()
    tolerance = max(close, 2e-5 if profile.period else 0)  # the sum here has its own error
    assert total == pytest.approx(exact, abs=tolerance)


def integral(track: Track, a: float, b: float) -> float:
    """Exact integral of a track's first component from a to b [s], inside its window."""
    times = np.array([time for time, _ in track.keys])
    values = np.array([value[0] for _, value in track.keys])
    sums = np.append(0, np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(times)))

    def once(t: float) -> float:
        """From the first key to t, constant outside the keys."""
        i = int(np.clip(np.searchsorted(times, t) - 1, 0, len(times) - 2))
        inner = min(max(t, times[0]), times[-1])
        rise = (values[i] + np.interp(inner, times, values)) / 2 * (inner - times[i])
        outer = min(t - times[0], 0) * values[0] + max(t - times[-1], 0) * values[-1]
        return sums[i] + rise + outer

    def since(t: float) -> float:
        """From the origin to t."""
        if track.period == 0 or t <= 0:
            return once(t) - once(0)
        turns = np.floor(t / track.period)
        return turns * (once(track.period) - once(0)) + once(t - turns * track.period) - once(0)

    low, high = max(a, track.start), min(b, track.end)
    return since(high - track.origin) - since(low - track.origin) if high > low else 0.0


def random_track(rng: np.random.Generator) -> Track:
    """A mean of random keys, repeated or not, that take from 1e-5 s to 1 s."""
    times = np.cumsum(rng.uniform(0.1, 1, rng.integers(2, 9)))
    times = (times - times[0] * rng.integers(0, 2)) * 10 ** rng.uniform(-5, 0) / times[-1]
    factors = rng.normal(size=len(times))
    profile = Keyframes(times=tuple(times), factors=tuple(factors), repeat=rng.random() < 0.7)
    return scaled(profile, rng.uniform(0, 0.1), rng.uniform(0.1, 0.9), mean=True)


def test_kicks_longer_than_a_profile_give_its_whole_impulse(rng):
    for _ in range(60):
        track = random_track(rng)
        total, time, last = 0.0, 0.0, 0.0
        while time < 1:
            dt = 10 ** rng.uniform(-3, -0.7)
            kick = (last + dt) / 2
            value = sample(track, time, kick, dt)[0]
            exact = integral(track, time - last / 2, time + dt / 2)
            assert kick * value == pytest.approx(exact, abs=1e-12)
            total, time, last = total + kick * value, time + dt, dt
        assert total == pytest.approx(integral(track, -1, 2), abs=1e-11)


def test_the_mean_of_a_quick_sine_is_its_offset():
    for frequency, kick in [(1e3, 3.33e-3), (400.0, 6.1e-3), (1e4, 0.05)]:
        track = scaled(Sine(frequency=frequency, phase=90, offset=0.25), mean=True)
        for real, close in ((wp.float32, 2e-3), (wp.float64, 1e-12)):
            value = sample(track, 0.1, kick, kick, real)[0]
            most = 2 / (np.pi * frequency * kick)  # what half a period adds at most
            assert abs(value - 0.5) < most * (1 + 2e-3) + close


@pytest.mark.parametrize("over", ["kick", "drift"])
def test_a_quick_value_is_averaged_beyond_its_window(over, rng):
    for _ in range(20):
        track = random_track(rng)
        tracks = Tracks(real=wp.float64, device="cpu")
        slot = tracks.add(replace(track, mean=False), over=over)
        kick, drift, time = 0.03, 0.04, track.end - 0.01
        tracks.upload(wp.array([kick, drift, time], dtype=wp.float64))
        tracks.record().launch()
        a = time if over == "drift" else time + drift / 2 - kick
        b = a + (drift if over == "drift" else kick)
        always = replace(track, start=-9.0, end=9.0)
        exact = integral(always, a, b) / (b - a)
        assert tracks.values.numpy()[slot, 0] == pytest.approx(exact, abs=1e-12)


def test_a_wall_that_turns_within_a_substep_keeps_its_way(rng):
    """The rates times the substeps are the way from its first to its last position."""
    sine = Sine(frequency=370.0)
    track = replace(scaled(sine), origin=0.05)
    way, time = 0.0, 0.05
    for dt in rng.uniform(1e-3, 9e-3, 40):
        value, _, rate = sample(track, time, dt, dt)
        assert value == pytest.approx(track.values(np.array([time]))[0, 0], abs=1e-12)
        way, time = way + dt * rate, time + dt
    assert way == pytest.approx(track.values(np.array([time]))[0, 0], abs=1e-9)


def test_uniform_accelerations_add_up_in_slot_zero():
    tracks = Tracks(real=wp.float64, device="cpu")
    tracks.accelerate(Track.of_profile((0, 0, -9.81), Constant(), 0.0, 1e30, mean=True))
    tracks.add(scaled(Constant(), mean=True))
    tracks.accelerate(Track.of_profile((4.0, 0, 0), Sine(frequency=1.0), 0.0, 1e30, mean=True))
    assert tracks.vary
    clock = wp.array([1e-3, 1e-3, 0.25], dtype=wp.float64)
    tracks.upload(clock)
    tracks.record().launch()
    np.testing.assert_allclose(tracks.values.numpy()[0, :3], [4.0, 0, -9.81], rtol=1e-3)


def test_constant_tracks_are_sampled_once():
    tracks = Tracks(real=wp.float32, device="cpu")
    tracks.accelerate(Track.of_profile((0, 0, -9.81), Constant(), 0.0, 1e30, mean=True))
    assert not tracks.vary
    tracks.upload(wp.zeros(3, dtype=wp.float32))
    tracks.record().launch()
    assert tracks.values.numpy()[0, 2] == np.float32(-9.81)


def test_a_sine_is_straight_pieces_within_a_tenth_of_a_per_cent():
    times, factors = Sine(frequency=5.0).table()
    fine = np.linspace(0, 0.2, 10001)
    error = np.interp(fine, times, factors) - np.sin(2 * np.pi * 5 * fine)
    assert np.abs(error).max() < 1.3e-3


def test_profiles_refuse_what_makes_no_sense():
    adapter = TypeAdapter(AnyProfile)
    assert adapter.validate_python({"kind": "sine", "frequency": 2.0}) == Sine(frequency=2.0)
    with pytest.raises(ValidationError, match="3 times and 2 factors do not match"):
        Keyframes(times=(0.0, 1.0, 2.0), factors=(0.0, 1.0))
    with pytest.raises(ValidationError, match="must increase"):
        Keyframes(times=(0.0, 1.0, 1.0), factors=(0.0, 1.0, 2.0))
    with pytest.raises(ValidationError, match="greater than or equal to"):
        Sine(frequency=0.0)
