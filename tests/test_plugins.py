"""Materials, forces, boundaries and generators from outside, passed as instances or by name."""

import re
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
import warp as wp
from pydantic import Field

from phy124 import generators, pipeline, plugins
from phy124.boundaries import Ground
from phy124.effects import Effects
from phy124.errors import InputError
from phy124.forces import Force, Gravity
from phy124.materials import FixedCorotated
from phy124.mpm import Stage
from phy124.scene import Part, Scene
from phy124.simulation import Simulation
from support.shapes import ball

QUICK = {"accuracy": {"cells": 8}, "time.frames": 3}


class Rubber(FixedCorotated):
    """A fixed corotated solid that keeps what its base says of itself."""

    law: Literal["rubber"] = "rubber"
    E: float = Field(default=3e4, ge=1, le=1e9, description="Young's modulus [Pa].")


@wp.kernel(module="test_plugins", enable_backward=False)
def freeze(v: wp.array(dtype=wp.vec3)):
    v[wp.tid()] = wp.vec3()


class Freeze(Force):
    """Stops every particle in every substep."""

    kind: Literal["freeze"] = "freeze"
    sudden: ClassVar[bool] = True

    def attach(self, model, state, tracks):
        del tracks
        return [Stage("freeze", lambda grid: model.launch(freeze, len(model), [state.v], []), True)]


class Table(Ground):
    """A ground that another package offers."""

    kind: Literal["table"] = "table"


@pytest.fixture
def installed(monkeypatch):
    """A package with entry points for all of them."""
    points = EntryPoints(
        EntryPoint(name, f"test_plugins:{kind.__name__}", f"phy124.{group}")
        for name, kind, group in (
            ("rubber", Rubber, "materials"), ("freeze", Freeze, "forces"),
            ("table", Table, "boundaries"), ("sphere", round_thing, "generators"),
        )
    )  # fmt: skip
    monkeypatch.setattr(plugins, "entry_points", points.select)
    monkeypatch.setattr(EntryPoint, "load", lambda self: globals()[self.value.partition(":")[2]])


def round_thing():
    """Makes balls."""
    return lambda image_rgba, *, seed, progress: ball(100)


def own(**changes) -> Scene:
    return Scene(material=Rubber(), boundaries=(Table(),), **changes).replaced(QUICK)


def test_instances_of_ones_own_classes_move():
    run = Simulation(ball(300), own(forces=(Freeze(),)))
    clip = run.run()
    assert clip.report["complete"] and "freeze" in run.solver.timings
    assert np.abs(clip.means[-1] - clip.means[0]).max() < 1e-5


def test_what_they_are_they_say_themselves():
    scene = own(forces=(Freeze(),))
    ran = Effects.of(scene).ran
    assert {"stress rubber", "particle forces", "collider table (separate)"} <= set(ran)
    run = Simulation(ball(300), scene)
    assert run.solver.rejection.sudden(run.solver.clock)
    run.watchdog._fastest = 2 * scene.material.sound_speed()
    assert any("may stay squeezed flat" in note for note in run.watchdog.notes())


def test_a_scene_with_them_is_changed_but_not_written_without_a_name():
    scene = own().replaced({"time.fps": 30})
    assert isinstance(scene.material, Rubber) and scene.time.fps == 30
    with pytest.raises(InputError, match=r"Rubber.* which a file cannot name\. Register it"):
        scene.to_toml()


def test_a_part_of_ones_own_material_is_kept_when_the_scene_is_changed():
    scene = Scene(parts=(Part(gaussians=(0, 100), material=Rubber()),)).replaced(QUICK)
    assert isinstance(scene.parts[0].material, Rubber)


def test_a_run_whose_scene_cannot_be_written_is_refused_before_it_begins(tmp_path):
    with pytest.raises(InputError, match="which a file cannot name"):
        pipeline.simulate(ball(300), own(), tmp_path / "out", progress=pytest.fail)
    assert not (tmp_path / "out").exists()


def test_a_registered_name_is_read_and_written(installed, tmp_path):
    scene = own(forces=(Freeze(),))
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    again = Scene.from_toml(tmp_path / "scene.toml")
    assert again == scene and type(again.material) is Rubber
    assert type(Scene.from_data({"material": {"law": "rubber"}}).material) is Rubber
    with pytest.raises(InputError, match=r"rubber.E|material.E"):
        Scene.from_data({"material": {"law": "rubber", "E": -1}})


def test_a_registered_generator_is_found_by_name(installed):
    assert len(generators.make("sphere")(None, seed=0, progress=None)) == 100
    with pytest.raises(InputError, match="sphere"):
        generators.make("sphee")


def test_a_plugin_does_not_replace_what_is_there(installed, monkeypatch):
    monkeypatch.setattr(plugins, "registered", lambda group, name: Rubber)
    assert type(Scene.from_data({"material": {"law": "sand"}}).material).__name__ == "Sand"


def test_one_that_cannot_be_loaded_says_so(monkeypatch):
    points = EntryPoints([EntryPoint("odd", "no_such_module:Odd", "phy124.materials")])
    monkeypatch.setattr(plugins, "entry_points", points.select)
    with pytest.raises(InputError, match="cannot be loaded"):
        Scene.from_data({"material": {"law": "odd"}})


def test_the_examples_of_the_docs_move():
    """docs/guide/extending.md: a material, a force and a boundary of one's own."""
    page = (Path(__file__).parents[1] / "docs/guide/extending.md").read_text()
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", page[page.index("## A material") :], re.S):
        exec(block, names)
    parts = {"forces": (names["Quake"](), Gravity()), "boundaries": (names["Ramp"](),)}
    scene = Scene(material=names["Rubber"](), **parts).replaced(QUICK)
    clip = Simulation(ball(300), scene).run()
    assert clip.report["complete"]
    assert clip.means[-1, :, 0].mean() > clip.means[0, :, 0].mean()
    assert {"stress rubber", "collider ramp (separate)"} <= set(clip.report["effects"]["ran"])
