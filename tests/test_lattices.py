"""Which scenes compute their elastic objects on lattices (phy124/scene/lattices.py)."""

import numpy as np
import pytest

from phy124.accuracy import companion, probe
from phy124.budget.effects import Effects
from phy124.errors import InputError
from phy124.lattice.shock import STALLED
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.lattices import choose_solver, keep_lattice, reason_for_mpm
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SAND = {"name": "sand", "shape": "box", "sides": [1.0, 1.0, 1.0], "material": {"law": "sand"}}
SOLID = {"name": "hammer", "shape": "sphere", "size": 0.5, "place": [3.0, 0.0]}
FAST = {"kind": "swing", "amplitude": (0, 0, 1.0), "frequency": 20.0}
"""A motion at 126 m/s, which is 7 times the speed of sound in the preset `drop`."""
FOOT = {"kind": "foot", "fraction": 0.2}
DOWN = {"kind": "set_velocity", "v": (0, 0, -30.0)}
POINTS = [[0, 0, 0], [0, 0, 0.25], [0, 0, 0]]
UP_AND_DOWN = {"kind": "path", "times": [0, 0.01, 0.02], "points": POINTS, "smooth": False}
JERK = {"kind": "ground", "motion": UP_AND_DOWN}
AUTO = {"accuracy": {"cells": 6, "solver": "auto"}, "time.frames": 2}


def scene(name="drop", **changes):
    return Scene.named(name).replaced({**AUTO, **changes})


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"material": {"law": "sand"}}, "elastic materials"),
        ({"objects": [{**SAND, "place": [3.0, 0.0]}]}, "elastic materials"),
        ({"accuracy.precision": "float64"}, "accuracy.precision is float64"),
        ({"accuracy.transfer": "xpic2"}, "accuracy.transfer is xpic2"),
        ({"accuracy.solver": "mpm"}, "accuracy.solver is mpm"),
        ({"binding": "particles"}, "binding is particles"),
        ({"properties.file": "laws.npz"}, "in a file"),
        ({"object.velocity": (0, 0, -40)}, "at 2.2 times its speed of sound"),
        ({"object.lift": 4.0, "material.E": 500.0}, "squeezed at 9.9 times its speed"),
        ({"boundaries": [{"kind": "ground", "motion": FAST}]}, "squeezed at 7 times its speed"),
        ({"objects": [{**SOLID, "motion": FAST}]}, "squeezed at 7 times its speed"),
        ({"boundaries": [{**JERK, "contact": "slip"}]}, "squeezed at 2.8 times its speed"),
        (
            {"forces": [{"kind": "set_velocity", "v": (0, 0, -40)}]},
            "squeezed at 2.2 times its speed",
        ),
        ({"forces": [{"kind": "impulse", "p": (0, 0, 1e4)}]}, "squeezed at 7 times its speed"),
        ({"boundaries": [FOOT], "forces": [{**DOWN, "end": 0.03}]}, "squeeze the held object flat"),
        ({"forces": [{"kind": "attraction", "g": 5e3}]}, "squeezed at 5 times its speed"),
    ],
)
def test_auto_chooses_mpm_for_a_reason(changes, reason):
    chosen = scene(**changes)
    assert scene().on_lattice and not chosen.on_lattice
    assert reason in reason_for_mpm(chosen)
    assert not chosen.alone(0).on_lattice


@pytest.mark.parametrize(
    "changes",
    [
        {"boundaries": [{"kind": "ground", "motion": {**FAST, "start": 10.0}}]},
        {"boundaries": [JERK]},
        {"forces": [{"kind": "wind", "v": (0, 10.0, 0), "rate": 1e6}]},
        {"forces": [DOWN]},
        {"boundaries": [FOOT], "forces": [{**DOWN, "end": 0.01}]},
    ],
)
def test_lattices_stay_if_nothing_is_too_fast(changes):
    assert scene(**changes).on_lattice


def test_auto_runs_as_the_solver_that_it_chooses():
    context = RunContext(threads=1)
    named = [scene(), scene(**{"accuracy.solver": "lattice"})]
    clips = [Simulation(prepare(ball(100), each, context)).run() for each in named]
    assert np.array_equal(clips[0].means, clips[1].means)
    assert any("rest lattice" in row for row in clips[0].report["effects"]["ran"])


def test_fine_computes_in_float32_on_lattices_alone():
    fine = scene(accuracy="fine")
    assert (fine.on_lattice, fine.precision) == (True, "float32")
    for changes in ({"accuracy.solver": "mpm"}, {"material": {"law": "sand"}}):
        assert fine.replaced(changes).precision == "float64"
    both = {"objects": [{**SAND, "place": [3.0, 0.0]}], "accuracy.solver": "lattice"}
    assert fine.replaced(both).couples and fine.replaced(both).precision == "float64"


def test_effects_tell_why_there_is_no_lattice():
    chosen = scene(**{"checks.energy": True, "accuracy.precision": "float64"})
    omitted = {row.name: row.why for row in Effects.of(chosen).left_out}
    assert omitted["rest lattice"].startswith("accuracy.precision is float64")
    (sand,) = (row for row in Effects.of(scene("sand")).left_out if row.name == "rest lattice")
    assert sand.why == "lattices are for elastic materials"
    pool = {"name": "pool", "shape": "box", "place": [2.0, 0.0], "material": {"law": "fluid"}}
    light = {"material.density": 5.0, "material.damping": 0.0, "object.lift": 0.1}
    light = scene(objects=[pool]).replaced(light)
    (afloat,) = (row for row in Effects.of(light).left_out if row.name == "rest lattice")
    assert "so light that it would gain energy" in (afloat.why or "")


PLATE = {"kind": "half_space", "motion": {"kind": "swing", "amplitude": (0, 0, 0.01)}}


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"accuracy.solver": "mpm"}, "accuracy.solver is mpm"),
        ({"binding": "particles"}, "binding is particles: its particles are not on a lattice"),
        ({"boundaries": [PLATE, {**FOOT, "contact": "slip"}]}, "contact is slip: a body on a"),
        ({"objects": [{**SAND, "place": [3.0, 0.0]}]}, "lattices are for elastic materials"),
        (
            {"objects": [{**SAND, "place": [3.0, 0.0]}], "accuracy.solver": "lattice"},
            "some objects yield or flow",
        ),
    ],
)
def test_refusal_of_the_lost_energy_names_what_prevents_lattices(changes, why):
    with pytest.raises(InputError, match="unless all objects are on lattices; here") as refusal:
        scene(**{"boundaries": [PLATE], "checks.energy": True, **changes})
    assert why in str(refusal.value) and ".." not in str(refusal.value)


def test_lost_energy_brings_scenes_that_need_it_to_lattices(tmp_path):
    np.savez(tmp_path / "laws.npz", points=np.eye(3)[:2], law=np.array(["hencky"] * 2))
    file = {"properties.file": str(tmp_path / "laws.npz")}
    for changes in ({"accuracy.precision": "float64"}, file):
        assert not scene(boundaries=[PLATE], **changes).on_lattice
        assert scene(**{"boundaries": [PLATE], "checks.energy": True, **changes}).on_lattice


def left_out_on_gpu(scene, **known):
    """Return the rows of the report on lattices that are left out on a GPU."""
    rows = Effects.of(scene, device="cuda:0", **known).left_out
    return [row for row in rows if row.name == "rest lattice"]


def test_auto_is_mpm_on_a_gpu():
    assert choose_solver(scene(), "cuda:0").solver == "mpm"
    for changes, why in (({}, "slower on a GPU"), ({"binding": "particles"}, "binding")):
        (row,) = left_out_on_gpu(scene(**changes))
        assert why in row.why and "accuracy.solver" not in row.why
        chosen = choose_solver(scene(**changes), "cuda:0")
        assert left_out_on_gpu(chosen, no_lattice=row.why) == [row]
    named = scene(**{"accuracy.solver": "lattice"})
    assert choose_solver(named, "cuda:0") is named and choose_solver(scene(), "cpu").on_lattice


def test_changes_coarse_grids_and_studies_keep_the_solver():
    before, after = scene(), scene(**{"accuracy.precision": "float64"})
    assert keep_lattice(after, before).on_lattice and keep_lattice(before, before) is before
    assert not keep_lattice(before, after).on_lattice
    bound = scene(binding="particles")
    assert not companion.coarsen(bound).on_lattice and companion.coarsen(before).on_lattice
    assert not probe.coarsen(bound).on_lattice and probe.coarsen(before).on_lattice


def test_objects_that_are_all_held_stay_still():
    held = scene(**{"object.held": True, "accuracy.solver": "lattice"})
    clip = Simulation(prepare(ball(100), held, RunContext(threads=1))).run()
    assert np.array_equal(clip.means[0], clip.means[-1])


def test_an_impact_that_takes_too_many_substeps_ends():
    fast = scene(**{"object.velocity": (0, 0, -1000), "accuracy.solver": "lattice"})
    simulation = Simulation(prepare(ball(100), fast, RunContext(threads=1)))
    simulation.run()
    assert (
        f"{STALLED} substeps together lasted less than one substep of the undeformed body"
        in simulation.stopped
    )
