"""Time profiles: what the device reads from a table, and that kicks tile time without gaps."""

import numpy as np
import pytest
import warp as wp
from pydantic import TypeAdapter, ValidationError

from phy124.tracks import AnyProfile, Constant, Keyframes, Ramp, Sine, Table, Track, Tracks

REALS = [wp.float32, wp.float64]


def sample(track: Track, time: float, kick: float = 0.0, drift: float = 0.0, real=wp.float64):
    """Value, whether active, and rate of one track at a time."""
    tracks = Tracks(real=real, device="cpu")
    slot = tracks.add(track)
    clock = wp.array([kick, drift, time], dtype=real)
    tracks.upload(clock)
    tracks.record().launch()
    value, rate = tracks.values.numpy()[slot], tracks.rates.numpy()[slot]
    return value[0], value[3], rate[0]


def scaled(profile: Table, start: float = 0.0, end: float = 1e30, *, mean: bool = False) -> Track:
    return Track.scaled((2.0, 0.0, 0.0), profile, start, end, mean=mean)


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


def test_what_a_track_does_at_most_is_asked_for_a_time():
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
    # One that repeats is as fast at any time.
    assert scaled(Sine(frequency=1.0)).fastest(70.1, 70.2) == pytest.approx(12.56, rel=0.01)


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


def test_uniform_accelerations_add_up_in_slot_zero():
    tracks = Tracks(real=wp.float64, device="cpu")
    tracks.accelerate(Track.scaled((0, 0, -9.81), Constant(), 0.0, 1e30, mean=True))
    tracks.add(scaled(Constant(), mean=True))
    tracks.accelerate(Track.scaled((4.0, 0, 0), Sine(frequency=1.0), 0.0, 1e30, mean=True))
    assert tracks.vary
    clock = wp.array([1e-3, 1e-3, 0.25], dtype=wp.float64)
    tracks.upload(clock)
    tracks.record().launch()
    np.testing.assert_allclose(tracks.values.numpy()[0, :3], [4.0, 0, -9.81], rtol=1e-3)


def test_what_never_changes_is_sampled_once():
    tracks = Tracks(real=wp.float32, device="cpu")
    tracks.accelerate(Track.scaled((0, 0, -9.81), Constant(), 0.0, 1e30, mean=True))
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
