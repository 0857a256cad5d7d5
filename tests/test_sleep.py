"""Substeps are left out while everything rests, and only then."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.gaussians import Gaussians
from phy124.monitor.sleep import STILL, Sleep, next_change
from phy124.mpm.tracks import Constant, Keyframes, Ramp, Sine, Track
from phy124.pipeline import resume
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import lattice
from support.runs import resumed
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

UP = (0.0, 0.0, 1.0)
BLOW = {"kind": "impulse", "p": [0, 200.0, 0], "start": 0.25, "duration": 0.02}
DAMPING = {"kind": "wind", "v": [0, 0, 0], "rate": 200.0}
GRAVITY = {"kind": "gravity"}


def scene(solver="mpm", **changes) -> Scene:
    """A scene of particles: without damping, bodies on lattices keep vibrating invisibly."""
    usual = {
        "accuracy": {"cells": 6, "solver": solver},
        "object.lift": 0.0,
        "time.frames": 14,
        "time.fps": 24,
    }
    return Scene.named("drop").replaced({**usual, **changes})


def cube() -> Gaussians:
    """A solid cube of ten round Gaussians a side."""
    x = lattice((10,) * 3, 0.1)
    n = len(x)
    quats, scales = np.tile([1, 0, 0, 0], (n, 1)), np.full((n, 3), 0.04)
    return Gaussians.from_rgb(x, quats, scales, np.full(n, 0.95), x)


def track(profile, start: float = 0.0, end: float = 1e30) -> Track:
    return Track.of_profile(UP, profile, start, end, mean=True)


@pytest.mark.parametrize(
    ("moving", "at", "change"),
    [
        (Track.constant(UP), 0.0, math.inf),
        (track(Constant(), 2.0), 1.0, 2.0),
        (track(Constant(), 0.0, 3.0), 1.0, 3.0),
        (track(Constant(), 0.0, 3.0), 3.0, 3.0),
        (track(Ramp(duration=0.5), 2.0), 1.0, 2.0),
        (track(Ramp(duration=0.5), 2.0), 2.2, 2.2),
        (track(Sine(), 2.0), 1.0, 2.0),
        (track(Sine(), 2.0), 9.7, 9.7),
        (track(Sine(), 0.0, 4.0), 3.5, 3.5),
        (track(Keyframes(times=(0.5, 1, 2), factors=(1, 1, 3))), 0.0, 1.0),
        (track(Keyframes(times=(0, 1, 2), factors=(1, 1, 1), repeat=True), 0.0, 5.0), 2.5, 5.0),
        (track(Keyframes(times=(0, 1), factors=(1, 3), repeat=True), 0.0, 5.0), 2.5, 2.5),
    ],
)
def test_when_a_track_next_changes(moving, at, change):
    assert next_change(moving, at) == change


@pytest.mark.parametrize("profile", [Ramp(duration=0.5), Keyframes(times=(0, 1), factors=(1, 3))])
def test_after_its_last_key_a_track_stays(profile):
    assert next_change(track(profile), 1.5) > 1e20


@pytest.mark.parametrize(("solver", "walls"), [("mpm", [{"kind": "ground"}]), ("lattice", [])])
def test_at_rest_it_sleeps_until_a_blow_and_nothing_differs(solver, walls):
    """Without forces rest is exact: what comes after the blow is the same bit for bit."""
    runs, blown = [], {"forces": [BLOW], "boundaries": walls}
    for sleep in (True, False):
        run = Simulation(prepare(ball(300), scene(solver, **blown, **{"time.sleep": sleep})))
        runs.append((run, run.run()))
    (slept, a), (_, b) = runs
    assert np.array_equal(a.means, b.means) and np.array_equal(a.quats, b.quats)
    assert np.ptp(a.means[:, 0, 1]) > 1e-3, "the blow woke it"
    assert (a.means[6] == a.means[0]).all() and (a.means[7] != a.means[0]).any()
    # Frames 1 and 2 show that it rests, 3 to 6 end before the blow.
    assert slept.report()["sleep"] == {
        "since": 3,
        "frames": 4,
        "substeps": b.report["substeps"] - a.report["substeps"],
    }
    sentence = f"asleep from frame 3, 4 frames, saved {slept.find(Sleep).saved} substeps"
    assert f"sleep while all objects rest: {sentence}" in a.report["effects"]["ran"]
    (left_out,) = (o for o in b.report["effects"]["left_out"] if "sleep" in o["effect"])
    assert left_out["why"] == "time.sleep is off"


def test_settled_block_sleeps_within_the_tolerance():
    forces, clips = [DAMPING, GRAVITY, {**BLOW, "start": 1.25}], []
    floor = [{"kind": "ground", "contact": "sticky"}]
    for sleep in (True, False):
        changes = {"material.E": 4e6, "time.frames": 34, "time.sleep": sleep}
        run = Simulation(prepare(cube(), scene(forces=forces, boundaries=floor, **changes)))
        clips.append(run.run())
        report = run.report()["sleep"]
        if sleep:
            assert report is not None and report["frames"] >= 3 and report["since"] > 3
        else:
            assert report is None
    apart = np.abs(clips[0].means - clips[1].means).max(axis=(1, 2))
    # Slept frames, and those after the blow at 1.25 s, which begins in frame 31.
    assert 0 < apart[:31].max() < STILL / 3
    assert apart[31:].max() < STILL / 3
    assert np.abs(clips[0].means[33] - clips[0].means[30]).max() > 0.0004


@pytest.mark.parametrize("fps", [24, 1000])
@pytest.mark.parametrize("frames", [11, 14, 21])
def test_a_thrown_body_never_sleeps_in_the_air(fps, frames):
    """At frame 10 it stands still for an instant; at 1000 frames/s the frames around look still."""
    up = 9.81 * 10 / fps
    changes = {"time.fps": fps, "time.frames": frames, "object.velocity": [0, 0, up]}
    run = Simulation(prepare(ball(200), scene(**changes, **{"object.lift": 0.5})))
    highest = max((float(f.gaussians.means[:, 2].mean()), f.index) for f in run)[1]
    assert highest == 10
    assert run.report()["sleep"] is None


def test_slowly_creeping_object_does_not_sleep():
    """A thick fluid that sinks by less than a tenth of the tolerance per frame."""
    material = {"law": "fluid", "viscosity": 2e3, "bulk_modulus": 2e5}
    forces = [{"kind": "gravity", "g": [0, 0, -0.01]}, {**DAMPING, "rate": 5.0}]
    run = Simulation(
        prepare(ball(300), scene(material=material, forces=forces, **{"time.frames": 40}))
    )
    clip = run.run()
    per_frame = np.abs(np.diff(clip.means, axis=0)).max(axis=(1, 2))
    assert 0 < per_frame[20:].max() < STILL / 3
    assert np.abs(clip.means[-1] - clip.means[20]).max() > STILL
    assert run.report()["sleep"] is None


def test_something_that_moves_anywhere_keeps_it_awake():
    swing = {"kind": "swing", "amplitude": [0.1, 0, 0], "frequency": 1.0}
    far = {"kind": "sphere", "centre": [0, 0, 90.0], "radius": 1.0, "motion": swing}
    awake = Simulation(prepare(ball(300), scene(forces=[], boundaries=[far])))
    awake.run()
    assert awake.report()["sleep"] is None
    still = Simulation(prepare(ball(300), scene(forces=[], boundaries=[{**far, "motion": None}])))
    still.run()
    assert still.report()["sleep"] is not None
    left_out = awake.report()["effects"]["left_out"]
    (why,) = (o["why"] for o in left_out if "sleep" in o["effect"])
    assert why == "the object was never at rest long enough"


@pytest.mark.parametrize("pause", [1, 2, 4, 8])
def test_a_run_paused_asleep_goes_on_bit_for_bit(tmp_path, pause):
    chosen = scene(forces=[BLOW])
    whole = Simulation(prepare(ball(300), chosen)).run()
    run = Simulation(prepare(ball(300), chosen))
    again = resumed(run, pause, tmp_path / "pause.safetensors")
    clip = again.run()
    assert np.array_equal(clip.means, whole.means)
    assert clip.report["sleep"] == whole.report["sleep"]
    assert clip.report["substeps"] == whole.report["substeps"]


def test_colours_of_a_run_resumed_asleep_stay_turned(tmp_path, rng):
    """The object was rotated and then held at rest: the repeated frame has the rotated colours."""
    gaussians = ball(200)
    gaussians = replace(gaussians, sh=rng.normal(size=(200, 4, 3)).astype(np.float32))
    turn = {"kind": "set_velocity", "spin": [0, 0, 1.0], "centre": [0, 0, 0], "end": 0.25}
    stop = {"kind": "set_velocity", "start": 0.25}
    chosen = scene(forces=[turn, stop], **{"material.E": 1e6, "time.frames": 20})
    run, streamed = Simulation(prepare(gaussians, chosen)), []
    for frame in run:
        streamed.append(frame)
        if frame.index == 17:
            resume.save(run, tmp_path / "pause")
    assert run.report()["sleep"] is not None and run.find(Sleep).since <= 17
    again = resume.load(tmp_path / "pause")
    for frame in again:
        assert np.array_equal(frame.gaussians.sh, streamed[frame.index].gaussians.sh)
    assert np.abs(streamed[-1].gaussians.sh - gaussians.sh).max() > 0.1


def left_out(path, frames: int, acts: Track | None = None) -> list[int]:
    """Which frames of a particle on a path x(frame) [m] a sleeper of size 1 leaves out."""
    fps = 24.0
    at = SimpleNamespace(x=0.0)
    state = SimpleNamespace(x=SimpleNamespace(numpy=lambda: np.array([[at.x, 0.0, 0.0]])))
    values = SimpleNamespace(numpy=lambda: np.zeros((1, 4)))
    clock = SimpleNamespace(recent=SimpleNamespace(speed=0.0, gradient=0.0))
    tracks = SimpleNamespace(tracks=[acts or Track.constant(UP)], values=values)
    solver = SimpleNamespace(
        model=SimpleNamespace(dx=0.1),
        state=state,
        clock=clock,
        tracks=tracks,
        outliers=SimpleNamespace(count=0),
        free=SimpleNamespace(all=[]),
    )
    sleeper, slept = Sleep(size=1.0, frames=frames, fps=fps), []
    sleeper.bind(solver)
    for index in range(1, frames):
        if sleeper.skip_to(index) is not None:
            slept.append(index)
            continue
        at.x = path(index)
        clock.recent.speed = abs(path(index) - path(index - 1)) * fps
        sleeper.observe(index, 1)
    return slept


def test_no_even_acceleration_goes_astray_further_than_promised(rng):
    """In all skipped substeps, the particle is within `STILL` of its displayed position."""
    worst, asleep = 0.0, 0
    for _ in range(400):
        speed, gain = rng.choice([-1, 1], 2) * 10 ** rng.uniform([-7, -9], [-4, -6])
        turn, frames = rng.uniform(0, 40), int(rng.integers(5, 60))

        def path(frame, speed=speed, gain=gain, turn=turn):
            return speed * frame + gain * (frame - turn) ** 2

        slept = left_out(path, frames)
        if slept:
            assert slept == list(range(slept[0], frames)), "it sleeps to the end"
            shown = path(slept[0] - 1)
            worst = max(worst, *(abs(path(frame) - shown) for frame in slept))
            asleep += 1
    assert asleep > 40
    assert STILL / 30 < worst <= STILL


def test_toppling_object_is_awake():
    """Growing by a fifth per frame, it is invisible at first and far away in the end."""
    assert left_out(lambda frame: 1e-9 * 1.2**frame, 60) == []
    assert left_out(lambda frame: 1e-9 * 0.8**frame, 60) != []


@pytest.mark.parametrize("solver", ["mpm", "lattice"])
def test_new_force_wakes_a_run(solver):
    still = scene(solver, forces=[], boundaries=[])
    run = Simulation(prepare(ball(300), still, changes=True))
    heights = []
    for index in range(12):
        if index == 7:
            run.change(still.replaced({"forces": [GRAVITY]}))
        heights.append(run.step().gaussians.means[:, 2].mean())
    assert run.report()["sleep"]["frames"] == 4 and np.ptp(heights[:7]) == 0
    assert heights[0] - heights[-1] == pytest.approx(9.81 * (5 / 24) ** 2 / 2, rel=0.1)


def test_new_target_of_a_grab_wakes_a_run():
    place = [0, 0, 0.5]
    grab = {"kind": "grab", "point": place, "radius": 0.3, "targets": [place, place]}
    still = scene("lattice", forces=[grab], boundaries=[])
    aside = still.replaced({"forces": [{**grab, "targets": [[0.2, 0, 0.5]] * 2}]})
    run = Simulation(prepare(ball(300), still, changes=True))
    places = []
    for index in range(14):
        if index == 11:
            run.change(aside)
        places.append(run.step().gaussians.means[:, 0].mean())
    assert np.ptp(places[:11]) < 1e-3 and run.report()["sleep"]["frames"] > 0
    assert places[-1] - places[0] > 0.02


def test_after_a_change_it_must_be_seen_to_rest_again():
    """A force changes during frame 10: that and two more are computed."""
    change = track(Constant(), 9.5 / 24)
    slept = left_out(lambda frame: 0.0, 20, change)
    assert slept == [3, 4, 5, 6, 7, 8, 9, 13, 14, 15, 16, 17, 18, 19]
