"""What a scene calls for, and what is left out and why."""

import numpy as np
import pytest
from shapes import ball

from phy124.effects import Effects
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation

QUICK = {"accuracy": {"cells": 8}, "time.frames": 3}


def whys(effects: Effects) -> dict[str, str]:
    return {o.effect: o.why for o in effects.left_out}


def test_effects_follow_the_scene():
    free = Effects.of(Scene.named("push_right"))
    pressed = Effects.of(Scene.named("press"))
    assert "colliders" in [o.effect for o in free.left_out]
    assert "collider press (separate)" in pressed.ran
    assert "return mapping" in [o.effect for o in pressed.left_out]


def test_what_leaving_out_saves_grows_with_the_work():
    effects = Effects.of(Scene.named("press"))
    work = {"particles": 10**6, "substeps": 1000, "nodes": 10**5}
    saved = saved_by(effects, **work)
    assert saved["return mapping"] == 70
    assert saved["dense grid"] == pytest.approx(1.8 * 0.9, rel=1e-3)
    assert saved["velocities"] is None
    assert saved_by(effects, **work, threads=2)["return mapping"] == 35
    assert "dense grid" in saved and saved_by(effects, **{**work, "nodes": 2 * 10**6}) != saved
    assert "saved_seconds" not in str(effects.data())


def saved_by(effects: Effects, **work: int) -> dict:
    return {o["effect"]: o.get("saved_seconds") for o in effects.data(**work)["left_out"]}


def test_effects_know_profiles_wind_and_motion():
    scene = Scene.from_data(
        {
            "forces": [{"kind": "wind", "profile": {"kind": "sine"}}],
            "boundaries": [{"kind": "ground", "motion": {"kind": "swing"}}],
        }
    )
    ran = Effects.of(scene).ran
    assert "particle forces" in ran
    assert "time tables" in ran
    assert "uniform acceleration" not in ran


@pytest.mark.parametrize("name", preset_names())
def test_each_effect_either_runs_or_is_left_out_with_a_reason(name):
    effects = Effects.of(Scene.named(name))
    assert not set(effects.ran) & set(whys(effects))
    assert all(whys(effects).values())


def test_velocities_are_computed_only_for_who_asks():
    scene = Scene.named("push_right").replaced(QUICK)
    bare = Simulation(ball(300), scene).run()
    assert bare.velocities is None
    assert "follow from the places" in whys(Effects.of(scene))["velocities"]
    asked = scene.replaced({"velocities": True})
    full = Simulation(ball(300), asked).run()
    assert "velocities" in Effects.of(asked).ran
    assert np.array_equal(full.means, bare.means)
    assert full.velocities is not None and full.velocities.shape == full.means.shape


def test_velocities_from_neighbouring_frames_are_those_of_the_run():
    """Free flight: the difference over two frames is the mean velocity between them."""
    fall = {"object.lift": 5.0, "object.velocity": [1.0, 0, 2.0], "velocities": True}
    clip = Simulation(ball(300), Scene.named("drop").replaced({**QUICK, **fall})).run()
    bare = type(clip)(**{**vars(clip), "velocities": None})
    kept, found = clip.frame(1).velocities, bare.frame(1, velocities=True).velocities
    assert bare.frame(1).velocities is None
    # A velocity is half a substep behind its place.
    assert np.abs(found - kept).max() < 9.81 * clip.report["substep"]["mean"]


def test_sleep_and_static_parts_are_named():
    scene = Scene.named("drop")
    assert "sleep while all rests" in Effects.of(scene).ran
    assert whys(Effects.of(scene, slept=None))["sleep while all rests"].startswith("it was never")
    off = Effects.of(scene.replaced({"time.sleep": False}))
    assert whys(off)["sleep while all rests"] == "time.sleep is off"
    slept = Effects.of(scene, slept="asleep from frame 5, 9 frames, saved 900 substeps")
    assert "sleep while all rests: asleep from frame 5, 9 frames, saved 900 substeps" in slept.ran
    part = {"static": True, "region": {"upper": [0, 9, 9]}}
    static = scene.replaced({"parts": [part]})
    assert "static Gaussians: 7 never enter the solver" in Effects.of(static, static=7).ran
    assert whys(Effects.of(static))["several materials"] == "all that moves is of one"
