"""The package itself: its public names are there when asked for, and cost nothing before."""

import ast
import pkgutil
from pathlib import Path

import numpy as np
import pytest

import phy124
from support.shapes import ball


@pytest.mark.parametrize("name", phy124.__all__)
def test_a_public_name_is_there_when_asked_for(name):
    assert getattr(phy124, name).__name__ == name
    assert getattr(phy124, name).__doc__


def test_other_names_are_refused_as_python_does():
    with pytest.raises(AttributeError, match="module 'phy124' has no attribute 'dance'"):
        getattr(phy124, "dance")  # noqa: B009
    assert not hasattr(phy124, "dance")


def test_completion_shows_them():
    assert {*phy124.__all__, "__version__"} <= set(dir(phy124))


def test_type_checkers_see_each_name_where_it_is_imported_from():
    """Type checkers read the imports under TYPE_CHECKING, Python reads the table; both are
    equal."""
    tree = ast.parse(Path(phy124.__file__).read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    options = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert options == {name: f"phy124.{home}" for name, home in phy124._HOMES.items()}
    assert sorted(options) == sorted(phy124.__all__)
    assert (Path(phy124.__file__).parent / "py.typed").is_file()


def test_no_name_is_that_of_a_module():
    """`import phy124.pipeline.capture` would put the module in its place."""
    modules = {module.name for module in pkgutil.iter_modules(phy124.__path__)}
    assert not modules & set(phy124.__all__)


def test_one_image():
    camera = phy124.Camera((3, 0, 0), (0, 0, 0), 32, 24)
    image = phy124.render(ball(300), camera, device="cpu")
    assert image.shape == (24, 32, 3) and image.min() < 0.9
    assert phy124.render(ball(300), camera, alpha=True, device="cpu").shape == (24, 32, 4)
    assert np.array_equal(image, phy124.Renderer(device="cpu")(ball(300), camera))
