"""The programs of docs/examples run as they stand, and print or make what their page says."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import phy124
from phy124.generators import GENERATORS
from support.pages import ROOT

pytestmark = pytest.mark.usefixtures("coarse_solids")

FOLDER = ROOT / "docs/examples"
PROGRAMS = sorted(FOLDER.glob("[0-9]*.py"))
LONGEST = 40
"""Lines of a program, without empty ones."""
LONG = ("cost", "error", "fit", "sweep")
"""Programs that take long with smaller settings, too: many runs, or probes on fine grids."""
SMALLER = (
    (r'"accuracy": "draft"', '"accuracy": {"cells": 6}, "time.frames": 3, "view.size": 32'),
    (r'"time\.frames": \d+', '"time.frames": 3'),
    (r'make_gaussians\((".*?")\)', r"make_gaussians(\1, count=800)"),
    (r'generate\((.*"out/\w+")\)', r"generate(\1, count=800)"),
    (r"frames\(24\)", "frames(2)"),
)
"""Patterns in a program, and what stands there in a quick test."""


def run(program: Path) -> dict:
    """Run a program as `python PROGRAM` does; returns its names."""
    return runpy.run_path(str(program), run_name="__main__")


def smaller(text: str) -> str:
    """A program with a coarse grid, few frames and few Gaussians."""
    for pattern, replacement in SMALLER:
        text = re.sub(pattern, replacement, text)
    return text


@pytest.fixture
def folder(tmp_path, monkeypatch, domain):
    """A folder with the example pictures, as the root of the repository has them."""
    (tmp_path / "demo").symlink_to(ROOT / "demo")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setitem(GENERATORS, "ball", None)  # so that it is removed after the test
    return tmp_path


def name_of(program: Path) -> str:
    return program.stem.partition("_")[2]


@pytest.mark.parametrize("program", PROGRAMS, ids=name_of)
def test_program_is_short_and_on_the_page(program):
    text = program.read_text("utf-8")
    page = (FOLDER / "index.md").read_text("utf-8")
    assert len([line for line in text.splitlines() if line]) <= LONGEST
    assert (text.startswith('"""') and "demo/examples" in text) or "ball()" in text
    assert f"```{{literalinclude}} {program.name}\n" in page
    assert f"]({program.stem}.webp)" in page and program.with_suffix(".webp").is_file()


PACKAGES = {
    "matplotlib": "plots", "save_picture": "plots", "rosbags": "' rosbags", "McapSink": "bridge",
    "open_sink": "dds", "phy124.studies.fit": "fit", "phy124.studies.sweep": "sweep",
}  # fmt: skip
"""Name in a program -> the extra, or the package, that it needs."""


@pytest.mark.parametrize("program", PROGRAMS, ids=name_of)
def test_last_line_of_docstring_installs_extras(program):
    text = program.read_text("utf-8")
    needed = [extra for name, extra in PACKAGES.items() if name in text]
    line = text.split('"""')[1].strip().splitlines()[-1]
    assert all(extra in line for extra in needed)
    assert ("pip install" in line) == bool(needed)


def test_programs_are_numbered_and_small_pictures():
    assert [path.name[:2] for path in PROGRAMS] == [f"{i:02}" for i in range(1, len(PROGRAMS) + 1)]
    pictures = [path.with_suffix(".webp") for path in PROGRAMS]
    assert sum(path.stat().st_size for path in pictures) < 500_000


ALIKE = ("heights", "softer", "camera", "material", "effects", "objects", "file", "swirl")
"""Programs that call the same functions as others do; the slow tests run them as they stand."""
QUICK = [
    pytest.param(program, marks=[pytest.mark.slow] * (name_of(program) in ALIKE))
    for program in PROGRAMS
    if name_of(program) not in LONG
]


@pytest.mark.parametrize("program", QUICK, ids=name_of)
def test_program_runs_with_smaller_settings(program, folder):
    quick = folder / program.name
    quick.write_text(smaller(program.read_text("utf-8")), "utf-8")
    assert quick.read_text("utf-8") != program.read_text("utf-8")
    run(quick)
    assert any((folder / "out").rglob("*.*"))


def height(clip) -> float:
    """Height of the object in the last frame [m]."""
    return float(np.ptp(clip.means[-1, :, 2]))


def bounced(heights: list[float]) -> bool:
    """Whether something fell, and rose again."""
    lowest = int(np.argmin(heights))
    return 0 < lowest < len(heights) - 1 and heights[-1] > heights[lowest] + 0.02


CHECKS = {
    "hello": lambda names: names["result"].report["complete"],
    "heights": lambda names: bounced(names["heights"]),
    "file": lambda names: np.isfinite(names["clip"].means).all(),
    "softer": lambda names: height(names["clip"]) > 0.7,
    "camera": lambda names: Path("out/camera/portrait/front.mp4").is_file(),
    "material": lambda names: names["scene"].material.lame[0] > 1e5,
    "uniform_force": lambda names: np.ptp(names["clip"].means[:, :, 1].max(axis=1)) > 0.1,
    "swirl": lambda names: spin(phy124.Clip.load("out/swirl/clip.safetensors")) > 60,
    "cost": lambda names: names["stops"]["draft"].seconds < names["stops"]["fine"].seconds,
    "error": lambda names: 0 < names["report"].rows[2].error < names["report"].rows[0].error < 0.03,
    "effects": lambda names: "double precision" in names["saved"] or len(names["saved"]) == 8,
    "live": lambda names: names["live"].contacts()["ground"].force[2] < 0,
    "photograph": lambda names: names["match"]["psnr"] > 30,
    "objects": lambda names: names["clip"].objects == ("duck", "cushion", "ball"),
    "fit": lambda names: 4e4 < names["fitted"].report["found"]["material.E"]["value"] < 9e4,
    "sweep": lambda names: len(list(Path("out/sweep-example").rglob("clip.safetensors"))) == 6,
    "publish": lambda names: names["run"].count == 22,
    "bag": lambda names: bounced(names["heights"]) and names["cloud"].width > 40_000,
    "export": lambda names: len({path.suffix for path in Path("out/export").iterdir()}) == 5,
    "generator": lambda names: Path("out/generator/front.mp4").is_file(),
}
"""A figure or a file of each program."""


def spin(clip) -> float:
    """Degrees by which the object has turned about the vertical axis."""
    flat = (clip.means - clip.means.mean(axis=1, keepdims=True))[..., :2] @ [1, 1j]
    steps = np.angle((flat[1:] * flat[:-1].conj()).sum(axis=1))
    return float(np.degrees(steps.sum()))


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS, ids=name_of)
def test_program_gives_the_right_figure(program, folder):
    assert CHECKS[name_of(program)](run(program))
