"""Remedies: each is a change the scene takes, and does what its words say."""

import pytest

from phy124.budget.remedies import (
    REMEDIES,
    SLOW,
    advise,
    find_remedies,
    find_speedups,
    join_alternatives,
)
from phy124.monitor.watchdog import FAST
from phy124.runtime.context import RunContext
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball
from support.liquids import pool

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.mark.parametrize("name", preset_names())
def test_every_remedy_can_be_followed(name):
    scene = Scene.named(name)
    for cause in REMEDIES:
        for words, changes in find_remedies([cause], scene):
            assert words
            assert scene.replaced(changes) != scene, cause


def test_each_makes_its_cause_less():
    law_and_solver = {"material.law": "hencky", "accuracy": {"cells": 32, "solver": "mpm"}}
    scene = Scene.named("press").replaced({**law_and_solver, "material.E": 1e6})
    (law,), (shorter,), (coarser,), (softer,) = (
        find_remedies([cause], scene) for cause in ("law", "substep", "cells", "softer")
    )
    assert scene.replaced(law.changes).material.law == "neo_hookean"
    assert scene.replaced(law.changes).material.E == 1e6
    assert scene.replaced(shorter.changes).resolution.cfl == scene.resolution.cfl / 4
    assert scene.replaced(coarser.changes).resolution.cells == scene.resolution.cells // 2
    assert scene.replaced(softer.changes).material.E == 1e6 / 16


def test_no_shorter_substep_is_proposed_for_projected_liquids():
    water = Scene.named("water")
    assert water.projects and find_remedies(["substep"], water) == ()
    compressible = water.replaced({"accuracy.liquid": "compressible"})
    assert find_remedies(["substep"], compressible)


def test_particles_are_a_remedy_on_the_lattice_only():
    scene = Scene.named("press").replaced({"accuracy": {"cells": 32, "solver": "lattice"}})
    (remedy,) = find_remedies(["solver"], scene)
    assert remedy.words == "accuracy.solver = mpm"
    assert not scene.replaced(remedy.changes).on_lattice
    assert find_remedies(["solver"], scene.replaced(remedy.changes)) == ()


def test_lattices_are_a_remedy_in_a_liquid():
    """The substeps of bodies do not change the steps of the liquid."""
    scene = pool().replaced({"accuracy.solver": "mpm"})
    (remedy,) = find_remedies(["solver", "substep"], scene)
    assert remedy.words == "accuracy.solver = lattice"
    assert not scene.immerses and scene.replaced(remedy.changes).immerses
    assert find_remedies(["solver"], pool(material={"law": "sand"})) == ()


def test_only_sure_remedies_are_proposed_on_lattices():
    """A gentler push, fewer cells and a shorter substep often do not help there."""
    squeezed = {"accuracy.solver": "lattice", "material.law": "hencky"}
    scene = Scene.named("press").replaced(squeezed)
    causes = ("law", *FAST, "substep")
    law, solver = find_remedies(causes, scene)
    assert law.changes["material"]["law"] == "neo_hookean"
    assert solver.changes["accuracy"]["solver"] == "mpm"
    assert len(find_remedies(causes, scene.replaced(solver.changes))) == 4


@pytest.mark.parametrize("up", [pytest.param(0.05, marks=pytest.mark.slow), 0.2])
def test_each_remedy_of_a_flattened_body_works(up):
    """The law of the ball has a finite stress at zero volume; the ball is not damped."""
    press = {"kind": "press", "depth": 0.8, "down": 0.1, "up": up, "friction": 0.6}
    data = {
        "material": {"law": "fixed_corotated", "E": 3e4, "damping": 0.0},
        "boundaries": [{"kind": "ground", "friction": 0.6}, press],
        "accuracy": {"cells": 8, "solver": "lattice"},
        "time": {"frames": 12},
    }
    scene, ball = Scene.from_data(data), surface_of_ball()

    def run(scene):
        simulation = Simulation(prepare(ball, scene, RunContext(threads=1)))
        simulation.run()
        return simulation

    stopped = run(scene)
    assert stopped.remedies
    for remedy in stopped.remedies:
        assert run(scene.replaced(remedy.changes)).stopped is None, remedy.words


def test_gentler_push_halves_speeds_forces_and_press():
    scene = Scene.named("press").replaced({"object.velocity": (0, 2, 0)})
    (gentler,) = find_remedies(["push"], scene)
    changed = scene.replaced(gentler.changes)
    assert changed.object.velocity == (0, 1, 0)
    assert changed.forces[0].g[2] == scene.forces[0].g[2] / 2
    press, before = (next(w for w in s.boundaries if w.kind == "press") for s in (changed, scene))
    assert (press.down, press.up) == (2 * before.down, 2 * before.up)


def test_gentler_push_halves_speeds_of_walls_and_objects():
    path = {"kind": "path", "times": [0, 0.5], "points": [[0, 0, 0], [0, 1, 0]]}
    swing = {"kind": "swing", "frequency": 4.0}
    other = {"name": "other", "shape": "sphere", "velocity": [0, 2, 0], "place": [0, 3]}
    moved = {"name": "moved", "shape": "sphere", "motion": path, "place": [0, -3]}
    scene = Scene.from_data(
        {
            "forces": [
                {"kind": "wind", "v": [0, 6, 0]},
                {"kind": "set_velocity", "spin": [0, 0, 8]},
            ],
            "boundaries": [{"kind": "ground", "motion": path}, {"kind": "foot", "motion": swing}],
            "objects": [other, moved],
        }
    )
    (gentler,) = find_remedies(["push"], scene)
    changed = scene.replaced(gentler.changes)
    assert changed.forces[0].v == (0, 3, 0) and changed.forces[1].spin == (0, 0, 4)
    assert changed.boundaries[0].motion.times == (0, 1) == changed.objects[1].motion.times
    assert changed.boundaries[1].motion.frequency == 2 and changed.objects[0].velocity == (0, 1, 0)


def test_inapplicable_remedies_are_left_out():
    scene = Scene.named("drop").replaced(
        {"material.law": "neo_hookean", "accuracy": {"cells": 4, "precision": "float64"}}
    )
    assert find_remedies(["law", "precision", "cells", "ceiling"], scene) == ()
    assert (
        find_remedies(["friction"], Scene.named("drop").replaced({"material.damping": 0.0})) == ()
    )


@pytest.mark.parametrize("limiter", SLOW)
def test_a_slow_run_may_always_be_given_more_time(limiter):
    scene = Scene.named("drop")
    last = find_speedups(scene, limiter, 0.5)[-1]
    assert scene.replaced(last.changes).time.budget == pytest.approx(
        16 * scene.time.budget, rel=0.05
    )


def test_words():
    assert [join_alternatives(words) for words in (["a"], ["a", "b"], ["a", "b", "c"])] == [
        "a",
        "a or b",
        "a, b or c",
    ]
    assert advise(()) == ""
    assert advise(find_remedies(["softer", "cells"], Scene.named("press"))).startswith(
        "Use material.E"
    )


def test_a_remedy_beyond_a_bound_is_left_out():
    scene = Scene.named("press").replaced({"material.E": 1.0, "time.substep": 1.0})
    assert find_remedies(["softer", "ceiling"], scene) == ()


def test_remedy_of_a_lasting_prescribed_motion_is_its_end():
    """Whatever else changes, the object is moved on into the ground."""
    fall = {"kind": "set_velocity", "v": [0, 0, -3], "start": 0.1}
    scene = Scene.named("drop").replaced({"forces": [fall]})
    (ending,) = find_remedies(["push", "cells"], scene, 0.3)
    assert ending.words == "forces.0.end = 0.2"
    ended = scene.replaced(ending.changes)
    assert ended.forces[0].end == 0.2
    assert ending not in find_remedies(["push"], ended, 0.3)
    assert ending not in find_remedies(["push"], scene)
