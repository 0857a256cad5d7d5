"""The pages of the reference that are written from declarations."""

import importlib.util
import json

import pytest

from phy124.commands import COMMANDS
from phy124.pipeline.report_keys import (
    Balance,
    CutOut,
    Energy,
    Forecast,
    Promise,
    Report,
    Substep,
    Tearing,
)
from phy124.scene import Scene
from support.pages import ROOT

pytestmark = pytest.mark.usefixtures("coarse_solids")

SECTIONS = {
    "balance": Balance,
    "substep": Substep,
    "promise": Promise,
    "energy": Energy,
    "forecast": Forecast,
}


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, str]:
    """Every page by its name."""
    for needed in ("griffe", "sphinx"):
        pytest.importorskip(needed, reason="the extra docs is not installed")
    spec = importlib.util.spec_from_file_location("docs_declared", ROOT / "docs/declared.py")
    declared = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(declared)
    declared.PAGES = tmp_path_factory.mktemp("generated")
    declared.write_pages()
    return {
        str(path.relative_to(declared.PAGES).with_suffix("")): path.read_text("utf-8")
        for path in declared.PAGES.rglob("*.md")
    }


def test_each_section_of_a_scene_has_a_page(pages):
    names = {name.partition("/")[2] for name in pages if name.startswith("scene/")}
    assert {"scene", "material", "forces", "boundaries", "view"} < names
    assert {*names} - {"scene"} < {*Scene.model_fields}
    assert "## `material`: snow" in pages["scene/material"]


def test_each_command_has_a_page_with_its_options(pages):
    for name in COMMANDS:
        assert f"usage: phy124 {name}" in pages[f"commands/phy124-{name}"]
    assert "--max-error" in pages["commands/phy124-generate"]
    assert "usage: phy124-bridge play" in pages["commands/bridge-play"]


def test_each_key_of_a_report_is_on_its_page(pages):
    for key in Report.__annotations__:
        assert f"| `{key}` |" in pages["report"]


def test_report_has_only_declared_keys(tmp_path):
    from phy124.__main__ import main
    from phy124.io.ply import write_ply
    from support.shapes import ball

    write_ply(tmp_path / "ball.ply", ball(300))
    settings = ["accuracy.cells=8", "time.frames=2", "checks.energy=true", "wrenches=true"]
    settings.append("accuracy.solver=mpm")
    options = ["--scene", "drop", "--views", "front", "--size", "32", "--forecast"]
    words = ["simulate", str(tmp_path / "ball.ply"), *options, "--out", str(tmp_path / "out")]
    assert main([*words, "--set", *settings]) == 0
    report = json.loads((tmp_path / "out/report.json").read_text("utf-8"))
    assert {*report} <= {*Report.__annotations__}
    assert {*Report.__required_keys__} <= {*report}
    for section in ("balance", "substep", "promise", "energy", "forecast"):
        always = report[section].keys() - {"tearing"}
        assert always == SECTIONS[section].__required_keys__, section
    assert report["balance"]["tearing"].keys() == Tearing.__annotations__.keys()


def test_cutout_in_the_report_is_declared():
    from phy124.imaging.cutout import cut_out

    cut = cut_out(ROOT / "demo/examples/duck.png")
    assert cut.data().keys() == CutOut.__annotations__.keys()
