"""The reference of a scene: the page in docs/, the example in it, and the schema for editors."""

import json
from pathlib import Path

import pytest

from phy124.__main__ import main
from phy124.scene import Scene
from phy124.scene.reference import EXAMPLE, format_reference, format_schema
from support.declared import leaves

PAGE = Path(__file__).parents[1] / "docs/reference/scene.md"


def test_page_shows_the_example():
    assert f"```toml\n{EXAMPLE}```" in PAGE.read_text("utf-8")


def test_reference_of_one_section(capsys):
    assert main(["scenes", "material", "--reference"]) == 0
    shown = capsys.readouterr().out
    assert "## `material`: snow\n" in shown and "## `forces`" not in shown
    assert shown in format_reference()
    assert main(["scenes", "materal", "--reference"]) == 2
    assert "Did you mean material?" in capsys.readouterr().err


def test_the_example_is_a_scene(tmp_path):
    (tmp_path / "s.toml").write_text(EXAMPLE)
    scene = Scene.from_toml(tmp_path / "s.toml")
    assert scene.parts and scene.stiffness and scene.forces[1].profile.kind == "sine"
    assert scene.boundaries[1].motion.kind == "path"


@pytest.mark.parametrize("kind", ["gripper", "wind", "snow", "keyframes", "gradient", "swing"])
def test_every_kind_has_a_table(kind):
    assert f": {kind}\n" in format_reference()


def test_sections_without_a_table_name_the_table_of_their_fields():
    shown = format_reference().split("## `boundaries`: container")[1].split("\n## ")[0]
    inside = next(line for line in shown.splitlines() if line.startswith("| `inside`"))
    assert "a table like `forces.region` | `{lower = [-1.0, -1.0, 0.0], upper = " in inside
    assert "## `forces.region`\n" in format_reference()
    # "as below" is a promise that a table of these fields follows.
    for section in format_reference().split("\n## `")[1:]:
        assert " as below " not in section or "view.cameras" in section, section


def test_every_field_says_what_it_is_and_shows_a_value():
    rows = [line.split(" | ") for line in format_reference().splitlines() if line.startswith("| `")]
    assert len(rows) > 200
    for field, wanted, default, about in rows:
        assert len(about) > 5 and wanted, field
        answer = default != "none" or "table" in wanted or wanted.startswith("one of")
        assert answer, f"{field}: give Field(examples=[...])"


def test_editors_get_a_schema_of_everything():
    output = json.loads(format_schema())
    assert output["$schema"].startswith("https://json-schema.org/")
    assert output["properties"]["object"] and "Snow" in output["$defs"]


def test_the_reference_as_json_is_the_schema(capsys):
    for options in (["--reference", "--json"], ["--schema"], ["--schema", "--json"]):
        assert main(["scenes", *options]) == 0
        assert json.loads(capsys.readouterr().out) == json.loads(format_schema())


def test_examples_are_legal():
    """The examples on the page are valid."""
    shown = [(leaf, example) for leaf in leaves({}) for example in leaf.node.get("examples", [])]
    assert len(shown) >= 8
    for leaf, example in shown:
        if "impulse" not in leaf.path and "parts" not in leaf.path:  # a part needs a region
            Scene.from_data(leaf.wrap(example))
