"""Declared options take values of the declared type, and scenes no endless nesting."""

import importlib

import pytest

from demo.settings import Settings
from phy124.errors import InputError
from phy124.generators.extras import OtherViews
from phy124.scene import Scene
from phy124.scene.files import DEEPEST

BOOLEAN, NUMBER = "it must be true or false", "number"


@pytest.mark.parametrize(
    ("field", "value", "limit"),
    [
        ("material.E", True, NUMBER),
        ("time.frames", True, NUMBER),
        ("seed", False, NUMBER),
        ("object.velocity", [True, 0, 0], NUMBER),
        ("forces.0.g", [0, 0, False], NUMBER),
        ("view.size", True, NUMBER),
        ("accuracy", True, "one of draft"),
        ("checks.energy", "yes", BOOLEAN),
        ("checks.energy", "true", BOOLEAN),
        ("checks.energy", 1, BOOLEAN),
        ("view.shine", 0.0, BOOLEAN),
    ],
)
def test_a_value_of_another_type_is_refused(field, value, limit):
    with pytest.raises(InputError, match=limit) as refused:
        Scene.named("drop").replaced({field: value})
    assert refused.value.field == field


@pytest.mark.parametrize("value", [True, False])
def test_booleans_and_whole_numbers_are_taken(value):
    scene = Scene.named("drop").replaced({"checks.energy": value, "time.fps": 24, "material.E": 1})
    assert scene.checks.energy is value and scene.data()["material"]["E"] == 1.0
    assert OtherViews(thickness=1).thickness == 1.0


@pytest.mark.parametrize(("text", "value"), [("yes", True), ("0", False), ("false", False)])
def test_settings_come_as_text(text, value):
    assert Settings.from_environment({"PHY124_WARM_UP": text}).warm_up is value


def _nested(depth: int, kind: type) -> object:
    data: object = 1
    for _ in range(depth):
        data = {"a": data} if kind is dict else [data]
    return data


@pytest.mark.parametrize("kind", [dict, list])
@pytest.mark.parametrize("depth", [DEEPEST + 1, 3000])
def test_deeply_nested_data_is_refused(kind, depth):
    nested = _nested(depth, kind)
    with pytest.raises(InputError, match="nested more than 32 levels deep"):
        Scene.from_data({"material": nested})
    with pytest.raises(InputError, match="nested more than 32 levels deep"):
        Scene.named("drop").replaced({"material": nested})


@pytest.mark.parametrize("name", ["a", "objects", "material"])
def test_path_of_thousands_of_names_is_refused(name):
    with pytest.raises(InputError, match="3,000 names") as refused:
        Scene.named("drop").replaced({".".join([name] * 3000): 1})
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("text", [".".join("a" * 3000) + " = 1", f"a = {'[' * 3000}{']' * 3000}"])
def test_file_of_deeply_nested_data_is_refused(tmp_path, text):
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(InputError, match="nested"):
        Scene.from_toml(tmp_path / "scene.toml")


def test_docstring_below_a_field_describes_it(tmp_path, monkeypatch):
    source = '''# coding: latin-1
from pydantic import Field

from phy124.schema.section import Section


class Lamp(Section):
    """A lamp."""

    kind: str = Field(default="lamp", description="Kind.")
    power: float = 1.0
    """Power [W], café
    light.
    """
    hue: float = 0.0

    def shine(self) -> float:
        """Shine."""
        return self.power


def make(
    hue: float,
) -> Lamp:
    """Make a lamp."""
    return Lamp(hue=hue)
'''
    (tmp_path / "described_lamp.py").write_text(source, "latin-1")
    monkeypatch.syspath_prepend(tmp_path)
    fields = importlib.import_module("described_lamp").Lamp.model_fields
    described = {name: field.description for name, field in fields.items()}
    assert described == {"kind": "Kind.", "power": "Power [W], café light.", "hue": None}
