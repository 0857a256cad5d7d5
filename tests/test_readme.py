"""The README is short, its program runs, and the files that README and CONTRIBUTING name exist."""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("coarse_solids")

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text("utf-8")


def test_python_example_films_a_duck(tmp_path, monkeypatch, capsys):
    code = re.search(r"```python\n(.*?)```", README, re.S)
    assert code and len([line for line in code[1].splitlines() if line]) <= 8
    (tmp_path / "demo").symlink_to(ROOT / "demo")
    monkeypatch.chdir(tmp_path)
    quick = code[1].replace('{"view', '{"accuracy": {"cells": 8}, "time.frames": 2, "view')
    exec(quick.replace('.png")', '.png", count=500)'), {})
    heights = capsys.readouterr().out.strip("[ ]\n").split()
    assert len(heights) == 2, "a height for each frame, nothing of Warp's"
    assert Path("out/python/front.mp4").is_file()


def test_readme_has_at_most_90_lines():
    assert README.startswith("---\n")
    page = README.split("---\n", 2)[2]
    assert len(page.strip().splitlines()) <= 90


def test_readme_links_the_main_pages():
    for page in ("index", "start/index", "examples/index", "gallery"):
        assert f"](docs/{page}.md" in README
    for page in ("guide/extending", "guide/live", "results/accuracy", "reference/scene"):
        assert f"](docs/{page}.md)" in README


def test_files_in_the_map_of_the_code_exist():
    table = CONTRIBUTING[CONTRIBUTING.index("## Where things are") :]
    names = re.findall(r"`([^`]+/[^`]*|[^`]+\.py)`", table[: table.index("## A release")])
    assert len(names) > 50
    assert [name for name in names if not (ROOT / name).exists()] == []
