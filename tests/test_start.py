"""The page docs/start: its pictures are there, and its script for Blender makes ellipsoids."""

import re
import runpy
import sys

import numpy as np
import pytest

from phy124.io.ply import write_ply
from support.pages import ROOT
from support.shapes import ball

START = ROOT / "docs/start"
PAGE = (START / "index.md").read_text("utf-8")


def test_each_section_with_commands_has_a_picture():
    for section in re.split(r"^## ", PAGE, flags=re.M)[1:]:
        pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", section)
        assert pictures or "```" not in section, section.splitlines()[0]
        assert all((START / picture).is_file() for picture in pictures)


def test_pictures_are_small_and_used():
    pictures = list(START.glob("*.webp"))
    assert {path.name for path in pictures} == set(re.findall(r"\((\w[\w-]*\.webp)\)", PAGE))
    assert sum(path.stat().st_size for path in pictures) < 1_500_000


@pytest.mark.slow
def test_blender_shows_an_ellipsoid_for_each_gaussian(tmp_path, monkeypatch):
    bpy = pytest.importorskip("bpy", reason="Blender is not installed as a module")
    gaussians = ball(50)
    for frame in (1, 2):
        write_ply(tmp_path / f"clip_{frame:04}.ply", gaussians)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    monkeypatch.setattr(sys, "argv", ["blender", "--", str(tmp_path)])
    runpy.run_path(str(START / "blender.py"), run_name="__main__")
    bpy.context.scene.frame_set(2)
    graph = bpy.context.evaluated_depsgraph_get()
    result = [np.array(o.matrix_world)[:3, 3] for o in graph.object_instances if o.is_instance]
    x, y, z = np.array(result).T
    assert np.allclose(np.stack([-y, x, z], axis=1), gaussians.means, atol=1e-4)
