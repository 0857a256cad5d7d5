import importlib
import re
from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from phy124.boundaries import Sphere
from phy124.errors import InputError
from phy124.forces import Wind
from phy124.mpm.tracks import Sine
from phy124.scene import (
    PRESETS,
    Accuracy,
    AccuracyName,
    Scene,
    Timing,
    parse_value,
    preset_names,
    summarise,
)
from reference.material_point import KINDS

EXPECTED = {
    "bounce", "drop", "foam", "jelly", "metal", "press", "push_away", "push_right",
    "push_right_harder", "sand", "snow", "spin", "sway", "water", "wind",
}  # fmt: skip


@pytest.mark.parametrize("name", preset_names())
def test_presets_survive_toml(name, tmp_path):
    scene = Scene.named(name)
    assert scene.description.endswith(".")
    (tmp_path / "s.toml").write_text(scene.to_toml())
    assert Scene.from_toml(tmp_path / "s.toml") == scene


@pytest.mark.parametrize("name", preset_names())
def test_objects_that_are_held_at_the_foot_stand_on_a_floor(name):
    """Otherwise, a bent part would hang below the floor of the film."""
    boundaries = {boundary.kind: boundary for boundary in Scene.named(name).boundaries}
    if "foot" in boundaries:
        assert boundaries["ground"].motion == boundaries["foot"].motion


def test_all_named_presets_are_there():
    assert set(preset_names()) >= EXPECTED


def test_the_papers_pushes_keep_ratio_and_axis():
    right, harder, away = (
        Scene.named(n).forces[0].a for n in ("push_right", "push_right_harder", "push_away")
    )
    assert harder == tuple(1.5 * a for a in right)
    # Paper (x, y, z) = ours (y, -x, z): f = (-1, 0, 0) to image right, (0, -1, 0) away.
    assert right[1] > 0
    assert away[0] == -right[1]
    assert right[0] == right[2] == away[1] == away[2] == 0


def test_a_scene_cannot_be_changed():
    with pytest.raises(ValidationError, match="frozen"):
        Scene().seed = 3


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"materiall": 1}, r"materiall = 1: there is no such key. Did you mean material\?"),
        ({"object": {"sise": 1}}, r"object.sise = 1: there is no such key. Did you mean size\?"),
        (
            {"material": {"law": "neo_hookean", "E": -5}},
            r"material.E = -5: it must be a number from 1 to 1e13. Try 100000. It is: Young",
        ),
        (
            {"material": {"law": "sandd"}},
            r"material.law = sandd: there is no such law. Did you mean s",
        ),
        (
            {"forces": [{"g": [0, 0, 1]}]},
            "forces.0.kind = nothing: its kind is missing. Give one of",
        ),
        (
            {"material": "sand"},
            "material = sand: it must be a table whose law is one of fixed_coro",
        ),
        ({"box": 1}, "box = 1: there is no such key. Known keys: accuracy, binding"),
        (
            {"accuracy": {"box": 1}},
            "accuracy.box = 1: there is no such key. Known keys: blend, cells, cfl",
        ),
        ({"accuracy": {"binding": 1}}, "there is no such key here. binding belongs at the top"),
        ({"stiffness": {"kind": "picture"}}, "stiffness.file = nothing: it is required: text"),
        ({"accuracy": "standart"}, "it must be one of draft, .* Did you mean standard"),
        (
            {"forces": [{"kind": "wind", "profile": {"kind": "sine", "freq": 2}}]},
            "forces.0.profile.freq = 2: there is no such key. Did you mean frequency",
        ),
        (
            {"object": {"size": "1 m"}},
            r"object.size = 1 m: it must be a number .* longest side \[m\]",
        ),
        (
            {"time": {"frames": 0}},
            "time.frames = 0: it must be a whole number from 1 to 10000. Try 14",
        ),
        (
            {"material": {"law": "fluid", "viscosity": 1e6}},
            "material.viscosity = 1000000.0: it must be a number from 0 to 100000. Try 100000.",
        ),
        ({"time": {"frames": 2.5}}, "time.frames = 2.5: it must be a whole number"),
        ({"accuracy": {"cells": 2}}, "accuracy.cells = 2: it must be a whole number from 4 to 256"),
        (
            {"view": {"views": ["frnt"]}},
            "view.views.0 = frnt: it must be one of .* Did you mean front",
        ),
        ({"view": {"views": []}}, "there must be at least one view"),
        (
            {"view": {"background": [0, 2, 0]}},
            "view.background.1 = 2: it must be a number from 0 to 1",
        ),
        ({"view": {"background": "graay"}}, "this is not a CSS colour name. Did you mean gray"),
        ({"material": {"law": "fluid", "tint": "water"}}, 'colour name. Write "grey", "#80'),
        ({"object": {"size": float("nan")}}, "object.size = nan: it must be a number"),
        (
            {"forces": [{"kind": "gravity", "start": 2, "end": 1}]},
            "start 2.0 s must be before end 1.0 s",
        ),
    ],
)
def test_refusals_name_field_value_limit_and_remedy(data, message):
    with pytest.raises(InputError, match=message):
        Scene.from_data(data)


def test_broken_files_are_refused(tmp_path):
    path = tmp_path / "s.toml"
    with pytest.raises(InputError, match="there is no such file"):
        Scene.from_toml(path)
    path.write_text("size = = 3")
    with pytest.raises(InputError, match="it is not valid TOML"):
        Scene.from_toml(path)
    path.write_text(f"seed = {'1' * 6000}")
    with pytest.raises(InputError, match="thousands of digits"):
        Scene.from_toml(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"it is not text in UTF-8\. Save it again"):
        Scene.from_toml(path)


def test_an_unknown_preset_names_the_nearest():
    with pytest.raises(InputError, match="Did you mean press"):
        Scene.named("pres")


@pytest.mark.parametrize("law", sorted(KINDS))
def test_a_new_law_takes_its_own_defaults(law):
    """The values of the preset's law have no meaning for another law."""
    for name in preset_names():
        scene = Scene.named(name)
        if scene.material.law != law:
            assert scene.replaced({"material.law": law}).material == KINDS[law]()


def test_only_what_is_set_beside_a_new_law_stays():
    made = Scene.named("press").replaced({"material.nu": 0.1, "material.law": "metal"}).material
    assert made == KINDS["metal"](nu=0.1)
    part = {"region": {"upper": [0, 0, 0]}, "material": {"law": "sand", "E": 3e4}}
    scene = Scene(parts=[part]).replaced({"parts.0.material.law": "foam"})
    assert scene.parts[0].material == KINDS["foam"]()
    assert scene.parts[0].region.upper == (0, 0, 0)


def test_the_same_law_again_changes_nothing():
    scene = Scene.named("press")
    assert scene.replaced({"material.law": scene.material.law}) == scene


def test_a_new_kind_of_force_or_boundary_takes_its_own_defaults():
    scene = Scene.named("press").replaced(
        {"boundaries.1.kind": "sphere", "boundaries.1.radius": 0.3, "forces.0.kind": "wind"}
        | {"forces.0.profile.kind": "sine", "forces.0.profile.frequency": 2}
    )
    assert scene.boundaries[1] == Sphere(radius=0.3)
    assert scene.forces[0] == Wind(profile=Sine(frequency=2))
    assert scene.boundaries[0] == Scene.named("press").boundaries[0]


def test_one_past_the_last_item_is_added():
    scene = Scene.named("press").replaced({"forces.1.kind": "wind", "forces.1.rate": 3})
    assert scene.forces == (*Scene.named("press").forces, Wind(rate=3))


def test_a_part_of_a_named_accuracy_can_be_set():
    scene = Scene.named("press").replaced({"accuracy.cells": 24})
    assert scene.accuracy == PRESETS["standard"].model_copy(update={"cells": 24})
    scene = Scene.named("press").replaced({"accuracy.particles_per_axis": 1, "accuracy": "fine"})
    assert scene.accuracy == PRESETS["fine"].model_copy(update={"particles_per_axis": 1})


@pytest.mark.parametrize("path", ["accuracy.cells.x", "material.E.x", "seed.x.y", "forces.x.kind"])
def test_unknown_paths_cannot_be_set(path):
    with pytest.raises(InputError, match=rf"^{path} = 1: .*'x'"):
        Scene.named("press").replaced({path: 1})


def test_colours_have_names():
    for grey in ("grey", "#808080", [128 / 255] * 3):
        scene = Scene().replaced({"view.background": grey})
        assert scene.view.background == pytest.approx((128 / 255,) * 3)
        assert Scene.from_data(scene.data()) == scene


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    (tmp_path / "s.toml").write_text(Scene().to_toml(), "utf-8-sig")
    assert Scene.from_toml(tmp_path / "s.toml") == Scene()


def test_change_of_law_keeps_requested_values():
    with pytest.raises(InputError, match=r"material.E = 2e4|material.E = 20000"):
        Scene.named("press").replaced({"material.E": 2e4, "material.law": "fluid"})
    made = Scene.named("press").replaced({"material.damping": 3.0, "material.law": "hencky"})
    assert made.material.damping == 3.0
    for law in ("butter", [1], None, {"sand": 1}):
        with pytest.raises(InputError, match="material"):
            Scene.named("press").replaced({"material.law": law})


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("background", "view.background"),
        ("frames", "time.frames"),
        ("size", "object.size or view.size"),
        ("E", "material.E"),
        ("materal", "material"),
        ("view.width", "size"),
        ("object.height", "lift"),
        ("material.youngs_modulus", "E"),
        ("accuracy.grid", "cells or transfer or blend"),
    ],
)
def test_key_without_its_section_or_of_similar_meaning_is_found(key, meant):
    with pytest.raises(
        InputError, match=rf"{key} = 3: there is no such key\. Did you mean {meant}\?"
    ):
        Scene.named("press").replaced({key: 3})


def test_a_key_of_another_kind_is_named_as_such():
    with pytest.raises(InputError, match=r"sand has no such key\. Remove it"):
        Scene.from_data({"material": {"law": "sand", "damping": 3.0}})


def test_values_are_replaced_by_dotted_path():
    scene = Scene.named("press").replaced({"material.E": 2e4, "boundaries.0.friction": 0.1})
    assert scene.material.E == 2e4
    assert scene.boundaries[0].friction == 0.1
    with pytest.raises(InputError, match="there is no item"):
        scene.replaced({"boundaries.9.friction": 1})


def test_an_index_adds_an_item_to_a_list_that_the_scene_leaves_out():
    ball = {"objects.0.name": "ball", "objects.0.shape": "sphere", "objects.0.place": [0, 2]}
    scene = Scene.named("press").replaced({**ball, "pairs.0.friction": 0.2})
    assert scene.objects[0].name == "ball" and scene.pairs[0].friction == 0.2
    with pytest.raises(InputError, match=r"object\.place = \[1\]: it must be two values"):
        scene.replaced({"object.place.0": 1})
    with pytest.raises(InputError, match="there is no item '1'; the list has 0 items"):
        Scene.named("press").replaced({"objects.1.name": "ball"})


def test_named_accuracies_resolve():
    assert Scene(accuracy="draft").resolution == PRESETS["draft"]
    assert Scene(accuracy={"cells": 20}).dx == 1 / 20


def test_accuracy_is_described_with_each_setting_and_choice():
    text = Scene.model_fields["accuracy"].description
    assert all(f"{name} ({each.cells})" in text for name, each in PRESETS.items())
    assert all(name in text for name in Accuracy.model_fields)
    assert "solver (auto, mpm, lattice)" in text and "liquid (compressible, projection)" in text


@pytest.mark.parametrize(
    ("text", "value"),
    [("2e4", 2e4), ("[1, 2]", [1, 2]), ("true", True), ("slip", "slip"), ("1\nx = 2", "1\nx = 2")]
    # A shell removes the quotes of lists and tables.
    + [("[front, orbit]", ["front", "orbit"]), ("[true, a.png]", [True, "a.png"])]
    + [("{kind=sine, frequency=2}", {"kind": "sine", "frequency": 2}), ("[a b]", "[a b]")],
)
def test_values_are_written_as_in_toml(text, value):
    assert parse_value(text) == value


def test_scene_is_summarised_in_a_line():
    part = {"region": {"upper": [0, 0, 0]}, "static": True}
    scene = Scene.named("press").replaced({"material.law": "foam", "parts": [part]})
    said = summarise(scene)
    assert said.startswith("foam (density ")
    assert "viscosity 50 Pa s^n, flow_index 0.7); parts static; gravity; ground, press" in said
    fluid = summarise(Scene().replaced({"material.law": "fluid"}))
    assert "viscosity 0 Pa s)" in fluid, "what changes only the look is left out"
    sand = summarise(Scene().replaced({"material.law": "sand"}))
    assert "repose" not in sand
    assert "damping 100 Pa s)" in summarise(Scene().replaced({"material.damping": 100}))
    assert said.endswith(
        "1 m over 32 cells, 1.5 particles per cell and axis, float32, solver mpm, "
        "Gaussians on a lattice of particles; 22 frames at 24/s"
    )
    assert "each Gaussian a particle;" in summarise(scene.replaced({"binding": "particles"}))
    assert "\n" not in said


@pytest.mark.parametrize(
    ("name", "chosen", "solvers"),
    [
        ("press", "lattice", "lattice"),
        ("press", "auto", "lattice"),
        ("snow", "auto", "mpm"),
        ("water", "auto", "projection"),
        ("land_on_cushion", "lattice", "lattice and mpm"),
    ],
)
def test_the_line_names_the_solvers(name, chosen, solvers):
    scene = Scene.named(name).replaced({"accuracy.cells": 32, "accuracy.solver": chosen})
    if " and " in solvers:
        scene = scene.replaced({"material": {"law": "sand"}})
    assert f", solver {solvers}, " in summarise(scene)


def test_particles_per_axis_follow_from_the_materials():
    elastic = Scene.named("press")
    sand = Scene.named("sand")
    part = {"region": {"upper": [0, 0, 0]}, "material": {"law": "neo_hookean"}}
    assert elastic.particles_per_axis == 2
    assert sand.particles_per_axis == 1.5
    assert sand.replaced({"parts": [part]}).particles_per_axis == 2
    assert sand.replaced({"accuracy": "fine"}).particles_per_axis == 1.5
    assert sand.replaced({"accuracy.particles_per_axis": 1}).particles_per_axis == 1
    assert sand.spacing == sand.dx / 1.5


def test_all_options_are_declared_on_one_base():
    for module in ("bridge.options", "demo.settings", "demo.pictures", "phy124.simulation"):
        importlib.import_module(module)
    packages = ("phy124", "demo", "bridge")
    models = [m for m in BaseModel.__subclasses__() if m.__module__.partition(".")[0] in packages]
    others = {"Level", "Measurement", "MeasureRequest"}  # results, and a request's raw arguments
    assert {model.__name__ for model in models} - others == {"Section"}


def test_each_named_accuracy_has_its_place_in_the_table():
    assert get_args(AccuracyName) == tuple(PRESETS)


def test_a_length_in_seconds_is_so_many_frames():
    press = Scene.named("press")
    made = press.replaced({"time.seconds": 3, "time.fps": 30})
    assert (made.time.frames, made.time.fps, made.time.length) == (90, 30, 3)
    assert Scene.from_data({"time": {"seconds": 0.5}}).time.frames == 12
    assert Timing(seconds=3, fps=30) == made.time and "seconds" not in made.data()["time"]
    assert press.replaced({"time.seconds": 1e-3}).time.frames == 1


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"time.seconds": 3, "time.frames": 4}, "time.frames = 4 sets the length, too"),
        ({"time": {"seconds": 3, "frames": 4}}, "frames and seconds both set the length"),
        ({"time.seconds": 0}, "time.seconds = 0: it must be a number from 0.001"),
        ({"time.seconds": "long"}, "time.seconds = long: it must be a number"),
        ({"time.seconds": 9999}, "time.seconds = 9999.0: with 24 frames per second, it makes"),
        ({"view.speed": 0.5, "view.fps": 12}, "fps and speed both set the playback rate"),
        ({"view.speed": 0}, "view.speed = 0: it must be a number from 0.001"),
    ],
)
def test_lengths_and_speeds_that_cannot_be_are_refused(changes, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)):
        Scene.named("press").replaced(changes)
