import pytest
from pydantic import ValidationError

from phy124.errors import InputError
from phy124.scene import PRESETS, Scene, parse_value, preset_names

EXPECTED = {
    "bounce", "drop", "press", "push_away", "push_right", "push_right_harder", "spin", "sway",
}  # fmt: skip


@pytest.mark.parametrize("name", preset_names())
def test_presets_survive_toml(name, tmp_path):
    scene = Scene.named(name)
    assert scene.description.endswith(".")
    (tmp_path / "s.toml").write_text(scene.to_toml())
    assert Scene.from_toml(tmp_path / "s.toml") == scene


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
            r"material.E = -5: Input should be greater than or equal to 1. It is: Young's modulus",
        ),
        ({"material": {"law": "jello"}}, "'jello' found .* expected tags: 'neo_hookean'"),
        (
            {"forces": [{"kind": "wind", "profile": {"kind": "sine", "freq": 2}}]},
            "forces.0.profile.freq = 2: there is no such key. Did you mean frequency",
        ),
        ({"object": {"size": "1 m"}}, r"object.size = 1 m: .* valid number.* Longest side \[m\]"),
        ({"time": {"frames": 0}}, "time.frames = 0: Input should be greater than or equal to 1"),
        ({"time": {"frames": 2.5}}, "time.frames = 2.5: .* valid integer"),
        ({"accuracy": {"cells": 2}}, "accuracy.cells = 2: .* greater than or equal to 4"),
        ({"view": {"views": ["top"]}}, "view.views.0 = top: Input should be 'front'"),
        ({"view": {"views": []}}, "views must name at least one view"),
        ({"view": {"background": [0, 2, 0]}}, "background .* has a channel outside 0..1"),
        ({"object": {"size": float("nan")}}, "object.size = nan: Input should be a finite number"),
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
    with pytest.raises(InputError, match="it cannot be read"):
        Scene.from_toml(path)
    path.write_text("size = = 3")
    with pytest.raises(InputError, match="it is not valid TOML"):
        Scene.from_toml(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="it cannot be read"):
        Scene.from_toml(path)


def test_an_unknown_preset_names_the_nearest():
    with pytest.raises(InputError, match="Did you mean press"):
        Scene.named("pres")


@pytest.mark.parametrize("law", ["sand", "rigid", "fluid", "snow", "metal", "foam", "hencky"])
def test_every_preset_takes_every_law(law):
    """What the former law alone had is forgotten: a fluid has no Young's modulus."""
    for name in preset_names():
        assert Scene.named(name).replaced({"material.law": law}).material.law == law


def test_what_was_asked_for_is_never_forgotten():
    with pytest.raises(InputError, match=r"material.E = 2e4|material.E = 20000"):
        Scene.named("press").replaced({"material.E": 2e4, "material.law": "fluid"})
    made = Scene.named("press").replaced({"material.damping": 3.0, "material.law": "hencky"})
    assert made.material.damping == 3.0
    for law in ("butter", [1], None, {"sand": 1}):
        with pytest.raises(InputError, match="material"):
            Scene.named("press").replaced({"material.law": law})


def test_a_key_of_another_kind_is_named_as_such():
    with pytest.raises(InputError, match="this kind has no such key"):
        Scene.from_data({"material": {"law": "sand", "damping": 3.0}})


def test_values_are_replaced_by_dotted_path():
    scene = Scene.named("press").replaced({"material.E": 2e4, "boundaries.0.friction": 0.1})
    assert scene.material.E == 2e4
    assert scene.boundaries[0].friction == 0.1
    with pytest.raises(InputError, match="there is no item"):
        scene.replaced({"boundaries.9.friction": 1})


def test_named_accuracies_resolve():
    assert Scene(accuracy="draft").resolution == PRESETS["draft"]
    assert Scene(accuracy={"cells": 20}).dx == 1 / 20


@pytest.mark.parametrize(
    ("text", "value"), [("2e4", 2e4), ("[1, 2]", [1, 2]), ("true", True), ("slip", "slip")]
)
def test_values_are_written_as_in_toml(text, value):
    assert parse_value(text) == value
