"""Runs beyond hours or memory are refused before they start, with the setting that would fit."""

import math

import pytest

from phy124.budget.cost import Work, estimate, estimate_memory, largest_speed, rest_substeps
from phy124.budget.limits import check_limits, duration, note_scene
from phy124.errors import InputError
from phy124.particles import make_particles
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

TWICE = {"kind": "ramp", "duration": 0.1, "first": 2.0, "last": 2.0}

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {"accuracy": {"cells": 8}, "time.frames": 5}


def run(**changes) -> Simulation:
    return Simulation(prepare(ball(300), Scene.named("push_right").replaced({**QUICK, **changes})))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"material.E": 1e13, "time.frames": 10_000},
            r"estimated to take .* days .* material.E = .* or time.budget = .* would fit",
        ),
        (
            {"time.substep": 1e-9, "time.frames": 1000},
            r"estimated to take .* time.substep = .* would fit",
        ),
    ],
)
def test_runs_of_hours_are_refused_before_they_start(changes, message):
    with pytest.raises(InputError, match=message):
        run(**changes)


def test_durations_below_a_second_are_not_rounded_to_zero():
    assert [duration(t) for t in (0.42, 9.8, 42, 7200)] == ["0.42 s", "9.8 s", "42 s", "2.0 hours"]


@pytest.mark.parametrize(
    "hard",
    [
        {"material.E": 1e12},
        {"material.damping": 1e7},
        {
            "accuracy.liquid": "compressible",
            "material.law": "fluid",
            "material.density": 1.0,
            "material.viscosity": 1e5,
        },
    ],
)
def test_the_setting_that_would_fit_fits(hard):
    """The message names the setting that shortens the substeps, and the suggested value runs in
    time."""
    hard = {**hard, "time.frames": 200, "time.budget": 60.0}
    with pytest.raises(InputError) as refusal:
        run(**hard)
    words, changes = refusal.value.remedies[0]
    assert list(changes) == [list(hard)[-3]]
    assert f"{words}, " in str(refusal.value)
    scene = Scene.named("push_right").replaced({**QUICK, **hard}).replaced(changes)
    gaussians = run().setup.gaussians
    particles = make_particles(gaussians, density=1000, spacing=scene.dx / 2)
    assert estimate(gaussians, particles, scene, "cpu").seconds <= 60


def test_a_gpu_with_too_little_memory_is_named_before_the_run(monkeypatch):
    simulation = run()
    needs = [simulation.setup.gaussians, simulation.setup.particles, simulation.scene]
    free = {"cpu": 1e12, "cuda:1": 1e5}
    monkeypatch.setattr("phy124.budget.limits.free_memory", lambda device="cpu": free[device])
    with pytest.raises(InputError, match=r"device = cuda:1: .* 0\.0 GB are free\. Use a coarser"):
        check_limits(*needs, "cuda:1")
    assert check_limits(*needs, "cpu").state > 1e5


def test_heights_beyond_float32_are_refused():
    """A ball of 5 cm at 10 km: float32 knows its places to a millimetre, a sixth of a cell."""
    with pytest.raises(InputError, match=r"object\.lift = 10000 m: .*Use at most 620 m") as refusal:
        run(**{"object.size": 0.05, "object.lift": 1e4})
    changes = refusal.value.remedies[0].changes
    assert run(**{"object.size": 0.05, **changes}).setup.particles.x.max() < 621


def test_cells_of_liquids_take_more_memory_than_nodes():
    water = Scene.named("water")
    compressible = water.replaced({"accuracy": {"liquid": "compressible"}})
    assert (water.projects, compressible.projects) == (True, False)
    more = (
        estimate_memory(water, 10, 10, 1e5, 1)[0] - estimate_memory(compressible, 10, 10, 1e5, 1)[0]
    )
    assert 0.3e9 < more < 0.5e9


def test_clips_beyond_the_memory_are_refused(monkeypatch):
    monkeypatch.setattr("phy124.budget.limits.free_memory", lambda: 2e6)
    with pytest.raises(InputError, match=r"GB of memory, .* Use a coarser accuracy or fewer"):
        run(**{"time.frames": 500})


def test_a_part_that_rules_the_substep_is_named():
    base = {"region": {"upper": [9, 9, 0.2]}, "material": {"law": "rigid", "speed": 3.0}}
    scene = Scene.named("push_right").replaced({"parts": [base], "material.E": 1e4})
    (said,) = note_scene(scene)
    assert said.startswith("parts.0.material (rigid) is so stiff that it needs")
    assert "parts.0.static = true" in said
    notes = Simulation(prepare(ball(300), scene.replaced(QUICK))).report()["notes"]
    assert any(note.startswith("parts.0.material (rigid)") for note in notes)
    slower = scene.replaced({"parts.0.material.speed": 0.02})
    assert note_scene(slower) == []
    assert note_scene(Scene.named("drop")) == []


@pytest.mark.parametrize(
    ("preset", "size", "force"),
    [
        ("drop", 0.8, {"kind": "wrench", "force": [2e6, 0, 0]}),
        ("drop", 0.8, {"kind": "force", "f": [0, 0, 2e6]}),
        ("water", 0.001, {"kind": "gravity"}),
    ],
)
def test_motion_that_takes_many_substeps_is_noted_before_a_run(preset, size, force):
    scene = Scene.named(preset).replaced({"object.size": size, "forces": [force]})
    (said,) = note_scene(scene)
    assert "times as many as at rest" in said and "smaller forces and speeds" in said


@pytest.mark.parametrize(
    "changes",
    [
        {"forces": [{"kind": "set_velocity", "v": [0.0, 12.0, 16.0]}]},
        {"forces": [{"kind": "impulse", "p": [0.0, 20 * 0.19 * 1000.0, 0.0]}]},
        {"forces": [{"kind": "wind", "v": [0.0, 20.0, 0.0], "rate": 1000.0}]},
        {"forces": [{"kind": "acceleration", "a": [0.0, 20.0, 0.0], "profile": TWICE}]},
        {"boundaries": [{"kind": "press", "depth": 0.5, "down": 0.1, "up": math.pi / 80}]},
    ],
)
def test_largest_speed_counts_all_forces_and_walls(changes):
    """Each force or wall causes 20 m/s, the last one by a cosine ramp."""
    size = {"object.size": 1.0, "material.density": 1000.0, "time.frames": 25}
    scene = Scene.named("push_right").replaced({"forces": [], **size, **changes})
    assert largest_speed(scene) == pytest.approx(20)


def test_gentle_forces_are_not_called_slow():
    pull = {"kind": "attraction", "g": 3.0, "centre": [0, 0, 1], "radius": 0.3}
    forces = [{"kind": "wrench", "force": [200, 0, 0]}, {"kind": "gravity"}, pull]
    assert note_scene(Scene.named("drop").replaced({"forces": forces})) == []


def test_liquid_by_projection_is_not_called_stiff():
    soft = {"law": "neo_hookean", "E": 1e4}
    toys = [{"name": name, "shape": "box", "size": 0.4, "material": soft} for name in "ab"]
    scene = Scene.from_data({"material": {"law": "fluid"}, "objects": toys})
    assert scene.projects and note_scene(scene) == []


def test_only_compressible_liquids_are_called_stiff():
    oil = Scene.named("oil").replaced({"accuracy": "draft", "material.density": 1})
    assert oil.projects and note_scene(oil) == []
    (said,) = note_scene(oil.replaced({"accuracy.liquid": "compressible"}))
    assert said.startswith("material (fluid) is so stiff")
    assert "a smaller material.bulk_modulus makes" in said


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"contacts": True}, "forces of walls on single particles (contacts)."),
        ({"view.outputs": ["force"]}, "forces of walls on single particles (view.outputs)."),
        ({"binding": "particles"}, "binding is particles."),
    ],
)
def test_note_names_the_setting_that_replaces_projection(changes, why):
    scene = Scene.named("water")
    assert note_scene(scene) == []
    (note,) = note_scene(scene.replaced(changes))
    assert f"{why} In a compressible liquid" in note and "sink and rise too slowly" in note
    assert note_scene(scene.replaced({**changes, "accuracy.liquid": "compressible"})) == []


@pytest.mark.parametrize("name", ["press", "sway"])
def test_closed_formulas_know_lattices(name):
    """Substeps at rest within 30 %; less work than with particles, but more memory per point."""
    accuracy = {"cells": 12, "solver": "lattice"}
    scene = Scene.named(name).replaced({"accuracy": accuracy, "time.frames": 3})
    run = Simulation(prepare(ball(800), scene))
    at_rest = 2 / scene.time.fps / run.solver.limits.substep_at_rest
    assert rest_substeps(scene) == pytest.approx(at_rest, rel=0.3)
    fine = scene.replaced({"accuracy.cells": 32})
    plain = fine.replaced({"accuracy.solver": "mpm"})
    assert Work.of(fine).particles < 0.7 * Work.of(plain).particles
    double = fine.replaced({"accuracy.precision": "float64"})
    assert Work.of(double).particles > 5 * Work.of(fine).particles
    assert estimate_memory(scene, 10, 1e5, 0, 1) > estimate_memory(plain, 10, 1e5, 0, 1)
