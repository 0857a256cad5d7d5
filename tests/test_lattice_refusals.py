"""Which scenes the lattice solver supports (phy124/lattice/refusals.py)."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.lattice.refusals import reason_for_particles, refuse_for_lattice
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

ALONE = {"accuracy": {"cells": 6, "solver": "lattice"}}
SAND = {"name": "sand", "shape": "box", "sides": [1.0, 1.0, 1.0], "material": {"law": "sand"}}
WATER = {**SAND, "name": "water", "material": {"law": "fluid"}}
BALL = {"name": "ball", "shape": "sphere", "sides": [1.0, 1.0, 1.0], "motion": {"kind": "free"}}
WIND = {"kind": "wind", "v": [1.0, 0.0, 0.0]}
SOFTENING = {"kind": "sine", "frequency": 1.0, "offset": 2.0}
SLIPPERY = {"kind": "foot", "fraction": 0.2, "contact": "slip"}
ELASTIC = ("drop", "bounce", "collide", "jelly", "press", "stack", "sway", "spin", "wind")
OTHERS = ("sand", "snow", "water", "metal", "foam")


def scene(*objects, **changes):
    """Return a scene of an elastic object on its lattice, and further objects."""
    placed = [{**item, "place": [3.0 * (k + 1), 0.0]} for k, item in enumerate(objects)]
    return Scene.from_data({**ALONE, "objects": placed, **changes})


CASES = [
    ([], {"material": {"law": "sand"}}, "material.law"),
    (
        [],
        {"parts": [{"region": {"upper": [9, 9, 0.2]}, "material": {"law": "sand"}}]},
        "parts.0.material.law",
    ),
    ([], {"binding": "particles"}, "binding"),
    ([], {"accuracy": {**ALONE["accuracy"], "particles_per_axis": 3}}, "accuracy.particles"),
    ([], {"boundaries": [SLIPPERY]}, "boundaries.foot.contact"),
    ([SAND], {"forces": [WIND]}, "forces.0"),
    ([SAND, BALL], {}, "objects.motion"),
    ([SAND], {"stiffness_profile": SOFTENING}, "stiffness_profile"),
]


@pytest.mark.parametrize(("objects", "changes", "field"), CASES)
def test_lattice_refuses_what_it_cannot_do(objects, changes, field):
    refused = scene(*objects, **changes)
    with pytest.raises(InputError, match='solver = "mpm"') as refusal:
        refuse_for_lattice(refused, refused.materials)
    assert refusal.value.field.startswith(field)
    by_default = refused.replaced({"accuracy.solver": "mpm"})
    assert reason_for_particles(refused) == reason_for_particles(by_default) != ""


@pytest.mark.parametrize("setting", ["transfer=xpic2", "gradient=spline", "rpic_damping=5.0"])
def test_lattice_has_no_transfer_options(setting):
    name, value = setting.split("=")
    with pytest.raises(InputError, match=f"^accuracy.{name} = {value}: .* no transfers"):
        Scene.from_data({"accuracy": {"solver": "lattice", name: value}})
    reason = reason_for_particles(Scene.from_data({"accuracy": {name: value}}))
    assert reason == f"accuracy.{name} is {value}"


def test_lattices_in_a_liquid_support_forces_but_no_free_solids():
    assert reason_for_particles(scene(WATER, forces=[WIND], accuracy={"cells": 6})) == ""
    assert "free solids" in reason_for_particles(scene(WATER, BALL, accuracy={"cells": 6}))
    two = [WATER, {**WATER, "name": "oil"}]
    forces = [{**WIND, "object": "oil"}]
    assert "several liquids" in reason_for_particles(
        scene(*two, forces=forces, accuracy={"cells": 6})
    )
    assert reason_for_particles(scene(WATER, accuracy={"liquid": "compressible"})) == ""


def test_a_law_that_may_collapse_needs_damping_on_a_lattice():
    for damping in (0.0, 10.0):
        reason = reason_for_particles(
            scene(material={"law": "fixed_corotated", "damping": damping})
        )
        assert ("squeezed flat" in reason) == (damping == 0)


def test_every_preset_is_supported_or_has_a_reason():
    lacking = {name: reason_for_particles(Scene.named(name)) for name in (*ELASTIC, *OTHERS)}
    assert not any(lacking[name] for name in ELASTIC)
    assert all(lacking[name] for name in OTHERS)


def test_laws_in_a_file_of_properties_must_be_elastic(tmp_path):
    path = tmp_path / "laws.npz"
    for laws, field in ((["neo_hookean", "sand"], "properties.file"), (["hencky"] * 2, None)):
        np.savez(path, points=np.eye(3)[:2], law=np.array(laws))
        varied = scene(SAND, properties={"file": str(path)})
        assert (field or "") in reason_for_particles(varied)
        assert bool(reason_for_particles(varied)) == bool(field)


def test_a_run_refuses_forces_that_it_cannot_change_to():
    before = scene(SAND, time={"frames": 2})
    run = Simulation(prepare(surface_of_ball(50), before, RunContext(threads=1)))
    with pytest.raises(InputError) as refusal:
        run.change(before.replaced({"forces": [WIND]}))
    assert refusal.value.field == "forces.0" and run.scene is before
