"""Runs of scenes: their frames and reports; runs that fail, take too long or are tried again."""

import json
import re
from functools import cache

import numpy as np
import pytest

from phy124.budget.cost import estimate
from phy124.errors import Cancelled, InputError
from phy124.io.clip import Clip
from phy124.mpm import Unstable
from phy124.mpm.timestep import CFL
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.scenes import each_preset
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {"accuracy": {"cells": 12}, "time.frames": 6}


def run(name: str, **changes) -> Clip:
    """The clip of a preset; several tests look at the same one."""
    return _simulated(name, json.dumps(changes))


@cache
def _simulated(name: str, changes: str) -> Clip:
    scene = Scene.named(name).replaced({**QUICK, **json.loads(changes)})
    return Simulation(prepare(ball(), scene)).run()


def middle(clip: Clip) -> np.ndarray:
    return clip.means.mean(axis=1)


@pytest.mark.parametrize("name", each_preset())
def test_every_preset_runs_and_keeps_the_object_whole(name):
    clip = run(name)
    assert clip.report["complete"]
    assert len(clip) == 6
    assert np.isfinite(clip.means).all()
    assert np.isfinite(clip.scales).all()
    assert np.abs(np.linalg.norm(clip.quats, axis=2) - 1).max() < 1e-5
    assert (np.einsum("tnk,tnk->tn", clip.quats[1:], clip.quats[:-1]) >= 0).all()
    assert np.ptp(clip.means[-1], axis=0).max() < 2.5


def test_the_first_frame_is_the_object_at_rest():
    scene = Scene.named("press").replaced(QUICK)
    s = Simulation(prepare(ball(), scene))
    first = next(iter(s)).gaussians
    assert np.array_equal(first.means, s.setup.gaussians.means)
    assert np.allclose(first.scales, s.setup.gaussians.scales, rtol=1e-6)
    assert np.allclose(first.quats, s.setup.gaussians.quats, atol=1e-6)


def test_each_frame_is_announced_at_once():
    simulation, seen = Simulation(prepare(ball(), Scene.named("press").replaced(QUICK))), []
    clip = simulation.run(lambda frame: seen.append((frame.index, simulation.count)))
    assert seen == [(index, index + 1) for index in range(len(clip))]


def test_the_papers_control_experiment():
    """f, 1.5 f and a third along another axis: ratio, direction and axis (Phy124, sec. 4)."""
    presets = ("push_right", "push_right_harder", "push_away")
    right, harder, away = (np.subtract(*middle(run(name))[[-1, 0]]) for name in presets)
    ratio = np.linalg.norm(harder) / np.linalg.norm(right)
    assert abs(ratio / 1.5 - 1) < 0.01
    for path, axis in ((right, [0, 1, 0]), (harder, [0, 1, 0]), (away, [-1, 0, 0])):
        angle = np.degrees(np.arccos(path @ axis / np.linalg.norm(path)))
        assert angle < 0.5
    assert abs(np.linalg.norm(away) / np.linalg.norm(right) - 1) < 0.01


def test_a_push_moves_it_as_far_as_mechanics_says():
    clip = run("push_right")
    expected = 0.5 * 2.0 * clip.times[-1] ** 2
    assert np.allclose(middle(clip)[-1] - middle(clip)[0], [0, expected, 0], atol=1e-4)


def test_press_flattens_and_lets_go():
    clip = run("press", **{"time.frames": 14})
    height = np.ptp(clip.means[..., 2], axis=1)
    assert height.min() < 0.75 * height[0]
    assert height[-1] > 0.9 * height[0]
    assert clip.means[..., 2].min() > -0.05


def test_drop_falls_and_stays_above_the_floor():
    clip = run("drop", **{"time.frames": 14})
    z = middle(clip)[:, 2]
    assert z[0] - z.min() > 0.4
    assert clip.means[..., 2].min() > -0.05


def test_bounce_comes_up_again():
    z = middle(run("bounce", **{"time.frames": 14}))[:, 2]
    lowest = z.argmin()
    assert 0 < lowest < 13
    assert z[lowest:].max() > z[lowest] + 0.15


def test_spin_turns_about_the_upright_axis():
    clip = run("spin")
    r = clip.means[:, :, :2] - middle(clip)[:, None, :2]
    far = np.linalg.norm(r[0], axis=1) > 0.3
    turned = np.angle((r[1, far, 0] + 1j * r[1, far, 1]) / (r[0, far, 0] + 1j * r[0, far, 1]))
    assert np.allclose(turned, 7.0 / 24, atol=0.05)


def test_sway_holds_the_foot_and_moves_the_top():
    clip = run("sway", **{"time.frames": 10})
    moved = np.linalg.norm(clip.means - clip.means[0], axis=2).max(axis=0)
    z = clip.means[0, :, 2]
    assert moved[z < 0.05].max() < 0.02
    assert moved[z > 0.9].min() > 0.03


def test_gaussians_may_be_bound_to_the_field():
    """The binding changes who carries the physics, not the physics."""
    # Those on the surface meet the floor a tenth of a cell before a lattice does.
    finer = {"time.frames": 14, "accuracy": {"cells": 16, "solver": "mpm"}}
    bound = run("drop", **finer, binding="particles")
    field = run("drop", **finer)
    assert field.report["particles"] < bound.report["particles"]
    assert np.linalg.norm(middle(bound) - middle(field), axis=1).max() < 0.02


def test_progress_may_cancel_between_substeps():
    calls = []

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate":
            calls.append((stage, done, total))
        if len(calls) == 5:
            raise Cancelled

    s = Simulation(prepare(ball(), Scene.named("press").replaced(QUICK), RunContext(progress=stop)))
    with pytest.raises(Cancelled):
        s.run()
    assert s.solver.clock.substeps < 10


def test_an_unstable_frame_is_tried_again_then_given_up(monkeypatch):
    scene = Scene.named("push_right").replaced({**QUICK, "accuracy.solver": "mpm"})
    s = Simulation(prepare(ball(), scene))
    tried = []

    def fail(until, **_):
        tried.append(s.solver.clock.cfl)
        raise Unstable("3 particles left the grid")

    frames = iter(s)
    next(frames)
    next(frames)
    monkeypatch.setattr(s.solver, "advance", fail)
    clip = Simulation.run(s)
    assert tried[:2] == [CFL, CFL / 2]
    assert not clip.report["complete"]
    assert "3 particles left the grid" in clip.report["stopped"]
    assert len(clip) >= 1


def test_a_users_substep_is_a_ceiling_and_reported():
    fine = run("push_right", **{"time.substep": 1e-3})
    assert fine.report["limiters"] == {"user": fine.report["substeps"]}
    assert fine.report["substeps"] >= 5 / 24 / 1e-3


def test_report_has_the_documented_keys():
    report = run("press").report
    assert set(report) >= {
        "complete", "stopped", "gaussians", "particles", "mass", "cleaning", "grid", "substeps",
        "limiters", "frames", "effects", "substep_stages",
    }  # fmt: skip
    assert abs(report["mass"] / (1000 * np.pi / 6) - 1) < 0.05
    assert report["effects"]["ran"]
    assert all(o["why"] for o in report["effects"]["left_out"])


@pytest.mark.parametrize("height", [0.0, 0.13])
def test_node_plane_is_three_quarters_below_the_floor(height):
    """Only then does the object touch the floor instead of hovering above or sinking into it."""
    boundaries = [{"kind": "ground", "height": height}]
    scene = Scene.from_data({"boundaries": boundaries, "accuracy": {"cells": 10}})
    grid = Simulation(prepare(ball(800), scene)).solver.grid
    below = (height - grid.origin[2]) / grid.dx
    assert abs(below % 1 - 0.75) < 1e-9


def test_nothing_visible_is_refused():
    g = ball()
    from dataclasses import replace

    with pytest.raises(InputError, match=r"finite, visible and within 1e\+18 m"):
        Simulation(prepare(replace(g, opacities=g.opacities * 0), Scene()))


def test_streaming_run_gives_equal_frames_and_no_clip(tmp_path):
    scene = Scene.named("press").replaced(QUICK)
    kept = Simulation(prepare(ball(400), scene)).run()
    s = Simulation(prepare(ball(400), scene, keep=False))
    for frame in s:
        assert np.array_equal(frame.gaussians.means, kept.means[frame.index])
        assert s.frames == [frame]
        if frame.index == 2:
            resume.save(s, tmp_path / "pause")
    assert (s.report()["frames"], s.report()["complete"]) == (6, True)
    with pytest.raises(ValueError, match="does not keep its frames"):
        s.clip()
    again = resume.load(tmp_path / "pause")
    assert [f.index for f in again.frames] == [2]
    for frame in again:
        assert np.array_equal(frame.gaussians.means, kept.means[frame.index])
    assert again.count == 6


def test_memory_for_frames_that_are_not_kept_is_not_asked_for():
    scene = Scene.named("press").replaced({**QUICK, "time.frames": 10_000})
    s = Simulation(prepare(ball(400), scene, keep=False))
    kept = estimate(s.setup.gaussians, s.setup.particles, scene, "cpu")
    assert kept.memory - s.setup.estimate.memory == pytest.approx(9_999 * 40 * 400)


SHORT = {"accuracy": {"cells": 8}, "time.frames": 5}


def pushed(**changes) -> Simulation:
    changes = {**SHORT, "accuracy.solver": "mpm", **changes}
    return Simulation(prepare(ball(300), Scene.named("push_right").replaced(changes)))


def test_a_frame_that_fails_once_is_retried_from_its_start(monkeypatch):
    """Sabotage: the second frame fails until the substep is halved."""
    plain, s = pushed(), pushed()
    advance = s.solver.advance

    def fail_once(until, **options):
        advance(until, **options)
        if until > 0.05 and s.solver.clock.cfl > 0.5:
            raise Unstable("5 particles left the grid")

    monkeypatch.setattr(s.solver, "advance", fail_once)
    clip, usual = s.run(), plain.run()
    assert clip.report["complete"]
    assert clip.report["substep"]["retried"] == [2, 3, 4]
    assert clip.report["limiters"].get("retry", 0) > 0
    assert "user" not in clip.report["limiters"], "time.substep is not set"
    assert s.solver.clock.cfl == CFL
    assert np.abs(clip.means - usual.means).max() < 1e-4


def test_frame_cancelled_during_its_retry_is_listed_once(monkeypatch):
    s = pushed()
    advance, attempts = s.solver.advance, iter([Unstable("lost"), Cancelled(), Unstable("lost")])

    def fail(until, **options):
        for error in attempts:
            raise error
        advance(until, **options)

    s.step()
    monkeypatch.setattr(s.solver, "advance", fail)
    with pytest.raises(Cancelled):
        s.step()
    s.restore(s.snapshot())
    s.step()
    assert s.retried == [1]


def test_a_frame_that_fails_twice_stops_and_keeps_the_good_ones(tmp_path, monkeypatch):
    """Sabotage: particles lose their numbers in the third frame."""
    s = pushed()
    advance = s.solver.advance

    def poison(until, **options):
        advance(until, **options)
        if until > 0.1:
            v = s.solver.state.v.numpy().copy()
            v[11] = np.inf
            s.solver.state.v.assign(v)

    monkeypatch.setattr(s.solver, "advance", poison)
    clip = s.run()
    assert len(clip) == 3
    assert not clip.report["complete"]
    stopped = clip.report["stopped"]
    assert "frame 3 is not valid" in stopped
    assert "particle 11 of law neo_hookean" in stopped
    assert stopped.endswith("Use accuracy.cfl = 0.188.")
    assert clip.report["remedies"][0]["accuracy"]["cfl"] == pytest.approx(CFL / 4)
    clip.save(tmp_path / "c.safetensors")
    again = Clip.load(tmp_path / "c.safetensors")
    assert np.isfinite(again.means).all() and not again.report["complete"]


def test_first_non_finite_particle_is_named(monkeypatch):
    """Sabotage: the strain of one particle is lost within the third frame."""
    s = pushed()
    step = s.solver.step

    def poison(kick, drift):
        step(kick, drift)
        if s.solver.clock.time > 0.095:
            F = s.solver.state.F.numpy()
            F[150] = np.nan
            s.solver.state.F.assign(F)

    monkeypatch.setattr(s.solver, "step", poison)
    stopped = s.run().report["stopped"]
    assert "1 particles are NaN or infinite, first particle 150 of law" in stopped


def test_graph_names_the_same_non_finite_particle(monkeypatch):
    """The graph loses its numbers at its next visit; the frame is repeated without it."""
    s = pushed()
    s.solver.on_device = True
    graph, step = s.solver._graph.run, s.solver.step
    visits = []

    def lost() -> None:
        if s.solver.clock.time > 0.095:
            F = s.solver.state.F.numpy()
            F[150] = np.nan
            s.solver.state.F.assign(F)

    def poisoned_graph(*inputs, **options):
        lost()
        visits.append(s.solver.clock.time)
        return graph(*inputs, **options)

    def poisoned_step(*inputs):
        step(*inputs)
        lost()

    monkeypatch.setattr(s.solver._graph, "run", poisoned_graph)
    monkeypatch.setattr(s.solver, "step", poisoned_step)
    stopped = s.run().report["stopped"]
    assert max(visits) > 0.095
    assert re.search(r"frame \d is not valid.* first particle 150 of law", stopped)


def test_the_report_says_what_limited_the_substep():
    report = pushed(**{"time.substep": 1.0}).run().report
    assert report["substep"]["fractions"] == {"elastic": 1.0}
    assert report["substep"]["asked"] == 1.0 and report["substep"]["split"]
    assert set(report["balance"]) >= {"energy_gain", "momentum_gain", "min_J", "ballistic"}


def test_a_run_that_turns_out_endless_stops_by_itself(monkeypatch):
    s = pushed(**{"time.budget": 1e3})
    monkeypatch.setattr(
        "phy124.simulation.spent.time.thread_time", iter(range(0, 10**9, 500)).__next__
    )
    clip = s.run()
    stopped = clip.report["stopped"]
    assert re.search(r"time.budget: a substep is .+ s, limited by the stiffness of the", stopped)
    assert "fastest is particle" in stopped
    assert len(clip) >= 1


@pytest.mark.parametrize(
    ("preset", "solver"), [("drop", "lattice"), ("drop", "mpm"), ("water", "auto")]
)
def test_stored_velocities_are_those_at_the_positions(preset, solver):
    """Free fall from rest, with few substeps: the motion does not depend on the velocities."""
    data = {"time.fps": 60, "time.frames": 4, "object.lift": 2, "accuracy.cells": 8}
    soft = {"material.E": 2e3, "material.damping": 0, "accuracy.solver": solver}
    scene = Scene.named(preset).replaced(data | (soft if preset == "drop" else {}))
    asked = scene.replaced({"velocities": True})
    fallen, bare = (Simulation(prepare(ball(300), each)).run() for each in (asked, scene))
    assert fallen.report["substeps"] < 12
    vertical = fallen.velocities.mean(axis=1)[:, 2]
    assert np.allclose(vertical, -9.81 * fallen.times, rtol=1e-3, atol=1e-6)
    assert np.array_equal(fallen.means, bare.means) and np.array_equal(fallen.quats, bare.quats)
    assert fallen.report["substeps"] == bare.report["substeps"]
