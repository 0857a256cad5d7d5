"""Every value of a scene, at its bounds and beyond: taken and run, or refused in words."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.declared import Leaf, beyond, leaves, legal
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

TINY = {
    "accuracy": {"cells": 4, "particles_per_axis": 1},
    "time": {"frames": 2, "fps": 240, "budget": 0.1},
}
FOREIGN = re.compile(r"Input should|validation|pydantic|literal\[|Value error|type=|Traceback")
"""Phrases that only pydantic or Python uses."""
OBJECT = ball(30)


@pytest.fixture(scope="module")
def declared(tmp_path_factory) -> list[Leaf]:
    """All values of a scene; where a file must be named there is one."""
    folder: Path = tmp_path_factory.mktemp("files")
    Image.new("L", (8, 8), 128).save(folder / "grey.png")
    return leaves({"picture": str(folder / "grey.png")})


def with_value(leaf: Leaf, value: Any) -> Scene | InputError:
    """A tiny scene with one value, or why there is none."""
    data = leaf.wrap(value)
    if isinstance(data, dict):
        inner = {key: {**TINY[key], **data.get(key, {})} for key in TINY if _is_table(data, key)}
        data = {**TINY, **data, **inner}
    try:
        return Scene.from_data(data)
    except InputError as refusal:
        return refusal


def _is_table(data: dict, key: str) -> bool:
    return isinstance(data.get(key, {}), dict)


def test_the_walk_finds_every_section(declared):
    paths = "\n".join(leaf.path for leaf in declared)
    for item in (
        ".material[snow].hardening",
        ".forces.0[wind].profile[sine].phase",
        ".seed",
        ".boundaries.0[gripper].rise",
        ".boundaries.0[box].motion[path].points.0.2",
        ".parts.0.material[sand].E",
        ".object.velocity.0",
        ".stiffness[picture].file",
        ".view.background.1",
        ".accuracy.cells",
    ):
        assert item in paths, item
    assert len(declared) > 500


@pytest.mark.parametrize("everywhere", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_refusals_of_bounds_have_messages(declared, everywhere):
    """One sentence in our own language, whose remedy is legal.

    A section that occurs in many places is tried with all values in its first place. In the other
    places, every ninth value is tried.
    """
    known: set[str] = set()
    for leaf in declared:
        section = f"{leaf.path[leaf.path.rfind('[') :]} {leaf.node}"
        values = [*legal(leaf.node), *beyond(leaf.node)]
        for value in values if everywhere or section not in known else values[1::9]:
            refusal = with_value(leaf, value)
            if isinstance(refusal, InputError):
                check_words(refusal)
                check_remedy(leaf, refusal)
        known.add(section)


def check_words(refusal: InputError) -> None:
    """Short, whole, and nobody else's words."""
    said = str(refusal)
    assert not FOREIGN.search(said), said
    assert len(said) < 480 and said.endswith((".", "?")), said


def check_remedy(leaf: Leaf, refusal: InputError) -> None:
    """A number that is recommended is taken, unless nothing would be there."""
    tried = re.match(r"Try (\[.*?\]|\S+)\. ", refusal.remedy)
    default = leaf.node.get("default")
    if tried and default is not None and not isinstance(with_value(leaf, default), InputError):
        result = with_value(leaf, eval(tried[1]))
        if refusal.field.count(".") == re.sub(r"\[\w+\]", "", leaf.path).count(".") - 1:
            assert isinstance(result, Scene), (refusal, result)


def accepted(declared: list[Leaf], *, odd: bool) -> Iterator[tuple[str, Scene]]:
    """Legal values that make a scene, and if wanted odd ones that happen to."""
    for leaf in declared:
        if not leaf.path.startswith(".view"):
            for value in [*legal(leaf.node), *(beyond(leaf.node) if odd else [])]:
                scene = with_value(leaf, value)
                if isinstance(scene, Scene):
                    yield f"{leaf.path} = {value!r}", scene


def run(name: str, scene: Scene) -> None:
    """Two frames without a NaN, or a sentence that says why not."""
    try:
        clip = Simulation(prepare(OBJECT, scene, RunContext(threads=1))).run()
    except InputError as refusal:
        assert len(str(refusal)) > 40, name
        assert not FOREIGN.search(str(refusal)), name
        return
    for values in (clip.means, clip.quats, clip.scales):
        assert np.isfinite(values).all(), name
    assert clip.report["complete"] or len(clip.report["stopped"]) > 40, name


def test_some_of_what_is_taken_runs(declared):
    for name, scene in [*accepted(declared, odd=False)][::120]:
        run(name, scene)


@pytest.mark.slow
def test_all_of_what_is_taken_runs(declared):
    for name, scene in accepted(declared, odd=True):
        run(name, scene)
