"""Effects that a scene requires, and effects that are left out, with reasons."""

import numpy as np
import pytest

from phy124.budget.effects import Effects
from phy124.monitor.sleep import Sleep
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation, prepare
from support.liquids import pool
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {"accuracy": {"cells": 8}, "time.frames": 3}


def whys(effects: Effects) -> dict[str, str]:
    return {o.name: o.why for o in effects.left_out}


def test_effects_follow_the_scene():
    free = Effects.of(Scene.named("push_right"))
    pressed = Effects.of(Scene.named("press"))
    assert "colliders" in [o.name for o in free.left_out]
    assert "collider press (separate)" in pressed.ran
    assert "return mapping" in [o.name for o in pressed.left_out]


def test_saving_of_an_omission_grows_with_the_work():
    effects = Effects.of(Scene.named("press").replaced({"accuracy.solver": "mpm"}))
    work = {"particles": 10**6, "substeps": 1000, "nodes": 10**5}
    saved = saved_by(effects, **work)
    assert saved["return mapping"] == 70
    assert saved["dense grid"] == pytest.approx(1.8 * 0.9, rel=1e-3)
    assert saved["velocities"] is None
    assert saved_by(effects, **work, threads=2)["return mapping"] == 35
    assert "dense grid" in saved and saved_by(effects, **{**work, "nodes": 2 * 10**6}) != saved
    assert "saved_seconds" not in str(effects.data())


@pytest.mark.parametrize("name", ["press", "water"])
def test_without_mpm_no_effect_of_its_grid_is_reported(name):
    effects = Effects.of(Scene.named(name))
    rows, why = (*effects.ran, *whys(effects)), whys(effects)
    assert not {"SIMD rows", "dense grid", "RPIC damping"} & set(rows)
    assert why["transfers between particles and a grid"] == "MPM moves no object"


def test_on_lattices_no_cost_of_mpm_is_reported():
    effects = Effects.of(Scene.named("press"))
    assert not any(saved_by(effects, particles=10**6, substeps=1000, nodes=10**5).values())
    assert not any("trial substeps" in row for row in effects.ran)
    assert whys(effects)["double precision"].endswith("float64 would also choose the solver mpm")


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


def test_gaussians_are_particles_only_for_who_asks():
    scene = Scene.named("press")
    assert "binding is lattice" in whys(Effects.of(scene))["one particle for each Gaussian"]
    assert (
        "one particle for each Gaussian" in Effects.of(scene.replaced({"binding": "particles"})).ran
    )


def test_velocities_are_computed_only_for_who_asks():
    scene = Scene.named("push_right").replaced(QUICK)
    bare = Simulation(prepare(ball(300), scene)).run()
    assert bare.velocities is None
    assert "derive them from the positions" in whys(Effects.of(scene))["velocities"]
    asked = scene.replaced({"velocities": True})
    full = Simulation(prepare(ball(300), asked)).run()
    assert "velocities" in Effects.of(asked).ran
    assert np.array_equal(full.means, bare.means)
    assert full.velocities is not None and full.velocities.shape == full.means.shape


def test_differenced_velocities_match_the_run():
    """Free flight: the difference over two frames is the mean velocity between them."""
    fall = {"object.lift": 5.0, "object.velocity": [1.0, 0, 2.0], "velocities": True}
    clip = Simulation(prepare(ball(300), Scene.named("drop").replaced({**QUICK, **fall}))).run()
    bare = type(clip)(**{**vars(clip), "velocities": None})
    kept, match = clip.frame(1).velocities, bare.frame(1, velocities=True).velocities
    assert bare.frame(1).velocities is None
    assert np.abs(match - kept).max() < 0.01 * 9.81 * clip.report["substep"]["mean"]


def test_sleep_and_static_parts_are_named():
    scene = Scene.named("drop")
    assert "sleep while all objects rest" in Effects.of(scene).ran
    sleep = Sleep(size=1.0, frames=20, fps=24.0)
    never = whys(Effects.of(scene, observers=[sleep]))
    assert never["sleep while all objects rest"].startswith("the object was never")
    off = Effects.of(scene.replaced({"time.sleep": False}))
    assert whys(off)["sleep while all objects rest"] == "time.sleep is off"
    sleep.since, sleep.skipped, sleep.saved = 5, 9, 900
    slept = Effects.of(scene, observers=[sleep])
    assert (
        "sleep while all objects rest: asleep from frame 5, 9 frames, saved 900 substeps"
        in slept.ran
    )
    part = {"static": True, "region": {"upper": [0, 9, 9]}}
    static = scene.replaced({"parts": [part]})
    assert "static Gaussians: 7 never enter the solver" in Effects.of(static, static=7).ran
    assert (
        whys(Effects.of(static))["several materials"] == "all moving parts have the same material"
    )


def test_gravity_of_zero_is_left_out():
    """So is every other force that never pushes; a stream at rest still drags."""
    still = [
        {"kind": "gravity", "g": [0, 0, 0]},
        {"kind": "particle_force", "f": [0, 0, 0]},
        {"kind": "attraction", "g": 0.0},
    ]
    scene = Scene.from_data({"forces": still, "boundaries": []})
    why = whys(Effects.of(scene))
    assert why["uniform acceleration"] == "no force acts on the whole body"
    assert "particle forces" in why
    run = Simulation(prepare(ball(100), scene.replaced(QUICK)))
    assert not run.solver._forces
    wind = Scene.from_data({"forces": [{"kind": "wind", "v": [0, 0, 0]}]})
    assert "particle forces" in Effects.of(wind).ran


def test_checks_are_effects_with_a_cost():
    scene = Scene.named("press").replaced({**QUICK, "accuracy.solver": "mpm"})
    effects = Effects.of(scene)
    assert "limits of the substep measured every 16 substeps or sooner" in effects.ran
    assert "balance of momentum and energy" in effects.ran
    report = Simulation(prepare(ball(100), scene)).run().report
    costs = {stage["name"]: stage["seconds"] for stage in report["substep_stages"]}
    assert costs["measure"] > 0 and costs["external work"] > 0
    free = whys(Effects.of(Scene.named("spin")))
    assert "their work need not be summed" in free["balance of momentum and energy"]


@pytest.mark.parametrize("solver", ["lattice", "mpm"])
def test_stages_of_a_pool_include_those_of_its_liquid(solver):
    scene = pool(time={"frames": 3, "fps": 24}).replaced({"accuracy.solver": solver})
    stages = Simulation(prepare(ball(100), scene)).run().report["substep_stages"]
    assert {"pressure", "snapshot"} < {stage["name"] for stage in stages}


@pytest.mark.parametrize("gradient", ["affine", pytest.param("spline", marks=pytest.mark.slow)])
def test_effects_name_the_kernels_that_run(gradient):
    accuracy = {"cells": 8, "gradient": gradient, "solver": "mpm"}
    scene = Scene.named("press").replaced({"accuracy": accuracy})
    effects, form = Effects.of(scene), Simulation(prepare(ball(100), scene)).solver.model.form
    assert ("SIMD rows" in effects.ran) == (form == "simd") == (gradient == "affine")
    assert ("gradients of the weights" in effects.ran) == (form == "spline")
    omitted = "gradients of the weights" if gradient == "affine" else "SIMD rows"
    assert "accuracy.gradient" in whys(effects)[omitted]


def test_tear_checks_and_substep_trials_are_listed():
    search = "search for torn material and separate pieces in each frame"
    scenes = [Scene.named(name) for name in ("press", "water")]
    named = [scene.replaced({"accuracy": {"solver": "mpm"}}) for scene in scenes]
    solid, flowing = (Effects.of(scene) for scene in named)
    assert search in solid.ran and "flow" in whys(flowing)[search]
    for item in (solid, flowing):
        assert (
            "trial substeps, which are repeated with a shorter substep if they are too long"
            in item.ran
        )


def test_less_watching_costs_less_and_moves_the_same():
    changes = {"accuracy.solver": "mpm", "material.E": 1e7, "checks.measure": 4}
    scene = Scene.named("press").replaced({**QUICK, **changes})
    rarely = scene.replaced({"checks": {"measure": 32, "balance": False}})
    usual, few = Simulation(prepare(ball(100), scene)), Simulation(prepare(ball(100), rarely))
    a, b = usual.run(), few.run()
    assert np.abs(a.means - b.means).max() < 2e-3
    measured = [run.solver.timings["measure"][1] for run in (usual, few)]
    assert measured[1] < 0.6 * measured[0]
    assert "external work" in usual.solver.timings and "external work" not in few.solver.timings
    assert b.report["balance"]["energy_gain"] is None
    left = {o["effect"]: o["why"] for o in b.report["effects"]["left_out"]}
    assert "checks.balance is off" in left["balance of momentum and energy"]


@pytest.mark.parametrize(("every", "solver"), [(1, "mpm"), (32, "mpm"), (32, "lattice")])
def test_impact_is_sound_at_any_measuring_interval(every, solver):
    """Faster than sound: measured in time, since it is fast."""
    scene = Scene.from_data(
        {
            "object": {"lift": 0.1, "velocity": [0, 0, -20]},
            "material": {"law": "neo_hookean"},
            "accuracy": {"cells": 8, "solver": solver},
            "time": {"frames": 4, "fps": 60},
            "checks": {"measure": every},
            "binding": "lattice",
        }
    )
    report = Simulation(prepare(ball(100), scene)).run().report
    assert report["complete"] and not report["balance"]["inside_out"]
    assert report["balance"]["energy_gain"] < 0.01
    assert report["balance"]["min_J"] > 0
    viscous = any("artificial viscosity" in row for row in report["effects"]["ran"])
    assert viscous == (solver == "lattice")


def test_without_a_balance_broken_numbers_still_stop_a_run():
    changes = {"accuracy.solver": "mpm", "checks": {"balance": False}}
    scene = Scene.named("push_right").replaced({**QUICK, **changes})
    run = Simulation(prepare(ball(100), scene))
    v = run.solver.state.v.numpy().copy()
    v[3] = np.nan
    run.solver.state.v.assign(v)
    assert "NaN or infinite" in run.run().report["stopped"]
