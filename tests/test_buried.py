"""Walls inside which the object already stands, and other nonsense: refused, or noted."""

import pytest

from phy124.errors import InputError
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DOWN = {"kind": "half_space", "point": [0, 0, 0.5], "normal": [0, 0, -1.0]}
UP = {"kind": "half_space", "point": [0, 0, 0.9], "normal": [0, 0, 1.0]}
QUICK = {"accuracy": {"cells": 12}, "time.frames": 3, "time.fps": 24.0}


def run(**changes) -> Simulation:
    return Simulation(prepare(ball(400), Scene.named("drop").replaced({**QUICK, **changes})))


@pytest.mark.parametrize(
    ("walls", "kind"),
    [
        ([{"kind": "ground", "height": 0.8}], "ground"),
        ([DOWN], "half_space"),
        ([DOWN, UP], "half_space"),
        (
            [{"kind": "container", "inside": {"lower": [-0.1, -0.1, 0], "upper": [0.1, 0.1, 2]}}],
            "container",
        ),
        ([{"kind": "press", "top": 0.5}], "press"),
        ([{"kind": "box", "lower": [-1, -1, 0], "upper": [1, 1, 1]}], "box"),
        ([{"kind": "sphere", "radius": 0.6, "centre": [0, 0, 0.5]}], "sphere"),
        (
            [{"kind": "capsule", "radius": 0.5, "start": [0, -1, 0.5], "end": [0, 1, 0.5]}],
            "capsule",
        ),
        (
            [{"kind": "ground", "motion": {"kind": "path", "points": [[0, 0, 1], [0, 0, 0]]}}],
            "ground",
        ),
    ],
)
def test_an_object_that_starts_inside_a_wall_is_refused(walls, kind):
    with pytest.raises(InputError) as refused:
        run(boundaries=walls)
    assert refused.value.value == kind
    assert "of the material starts inside it" in str(refused.value)


def test_a_little_inside_a_wall_is_noted_and_touching_is_not():
    resting = run(**{"object.lift": 0.0})
    assert not any("starts inside" in note for note in resting.report()["notes"])
    deep = run(**{"object.lift": 0.0, "boundaries": [{"kind": "ground", "height": 0.12}]})
    (note,) = (note for note in deep.report()["notes"] if "starts inside" in note)
    assert note.startswith("The ground: 4.") and "and stays there" in note


def test_all_sides_of_a_container_count_together():
    """Each of the four sides contains less than a tenth of the ball."""
    sides = {"lower": [-0.35, -0.35, -1], "upper": [0.35, 0.35, 2]}
    with pytest.raises(InputError) as refused:
        run(boundaries=[{"kind": "container", "inside": sides}])
    assert "inside it at x_low, x_high, y_low, y_high, up to" in str(refused.value)


def test_a_small_object_inside_a_wall_is_refused():
    """The object is only a few per cent of the material in the scene."""
    small = {"name": "pebble", "shape": "sphere", "size": 0.3, "place": [1.2, 0.0], "lift": 0.1}
    tank = {"kind": "container", "inside": {"lower": [-0.6, -0.6, 0], "upper": [0.6, 0.6, 9]}}
    with pytest.raises(InputError, match=r"^boundaries.1 = container: 100.0% of pebble starts"):
        run(boundaries=[{"kind": "ground"}, tank], objects=[small])


def test_an_object_on_a_path_that_contains_another_is_named():
    ram = {"name": "ram", "shape": "sphere", "size": 0.9, "lift": 0.1}
    still = {"kind": "path", "times": [0, 1], "points": [[0, 0, 0], [1, 0, 0]]}
    with pytest.raises(InputError, match=r"^objects.0 = sphere: .* starts inside it"):
        run(objects=[{**ram, "motion": still}])


AWAY = {"lower": [5, 5, 5], "upper": [6, 6, 6]}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"boundaries": [{"kind": "ground"}, {"kind": "held", **AWAY}]},
            r"^boundaries.1 = held: at the start, it contains no material",
        ),
        (
            {"forces": [{"kind": "gravity"}, {"kind": "impulse", "p": [1, 0, 0], "region": AWAY}]},
            r"^forces.1.region = .*: it holds no particle",
        ),
        (
            {"parts": [{"region": AWAY, "material": {"law": "sand"}}]},
            r"^parts.0 = a section with region: it holds no particle",
        ),
        (
            {"objects": [{"name": "hat", "shape": "box", "place": [3, 0], "on": "object"}]},
            r"^objects.0.on = object: it is not above",
        ),
    ],
)
def test_what_contains_or_meets_nothing_is_refused_by_its_path(changes, said):
    with pytest.raises(InputError, match=said):
        run(**changes)


def test_a_clamp_may_wait_for_particles():
    run(**{"boundaries": [{"kind": "held", **AWAY}], "accuracy.solver": "mpm"})


def test_a_rigid_body_faster_than_its_stiffness_is_noted():
    hard = {"material": {"law": "rigid"}, "time.frames": 2, "object.lift": 3.0}
    slow = run(**hard, **{"object.velocity": [0, 0, -3.0]})
    fast = run(**hard, **{"object.velocity": [0, 0, -100.0], "time.fps": 200.0})
    for item in (slow, fast):
        item.run()
    assert not any("its stiffness is for impacts" in note for note in slow.report()["notes"])
    assert any("speed = 100 makes" in note for note in fast.report()["notes"])


@pytest.mark.parametrize(
    ("material", "speed", "fps"),
    [({"law": "metal"}, 300.0, 100.0), ({"law": "foam", "density": 1e5}, 10.0, 10.0)],
)
def test_a_solid_that_swells_is_noted(material, speed, fps):
    fast = run(
        **{
            "material": material,
            "object.lift": 0.05,
            "time.frames": 3,
            "object.velocity": [0, 0, -speed],
            "time.fps": fps,
        }
    )
    fast.run()
    assert any("swelled to" in note for note in fast.report()["notes"])
    assert fast.report()["balance"]["max_J"] > 2


def test_a_stiffness_that_repeats_within_a_frame_is_noted():
    profile = {"kind": "sine", "frequency": 1000.0, "offset": 2.0}
    quick = run(stiffness_profile=profile)
    slow = run(stiffness_profile={**profile, "frequency": 1.0})
    result = [
        [n for n in item.report()["notes"] if "stiffness_profile" in n] for item in (quick, slow)
    ]
    assert len(result[0]) == 1 and not result[1]


@pytest.mark.parametrize("cfl", [0.75, 0.9])
def test_a_larger_cfl_that_only_shortens_substeps_is_noted(cfl):
    accuracy = {"cells": 8, "cfl": cfl, "solver": "mpm"}
    thick = {"material.damping": 2e4, "accuracy": accuracy, "time.frames": 2}
    first = run(**thick, **{"object.lift": 0.0})
    first.run()
    assert set(first.solver.clock.limiters) == {"viscous"}
    result = [note for note in first.report()["notes"] if "accuracy.cfl = 0.75" in note]
    assert len(result) == (cfl > 0.75)
