"""The pages of the documentation: no wall of text, and the code on them runs."""

import re
import textwrap
from pathlib import Path

import pytest

from phy124.scene import Scene
from support.pages import PAGES, ROOT, blocks, paragraphs

TALLEST = 8
"""Lines of 110 letters in a paragraph."""
RUN = {
    "README.md": "test_readme.py",
    "bridge.md": "test_bridge_layout.py",
    "extending.md": "test_plug_and_play.py",
    "filming.md": "test_scene_cameras.py",
    "fitting.md": "test_fit.py",
    "formats.md": "test_formats.py",
    "live.md": "test_live.py",
    "objects.md": "test_scene_objects.py",
    "pictures.md": "test_docs_pages.py",
    "plugins.md": "test_docs_pages.py",
    "scene.md": "test_scene_reference.py",
    "sweeps.md": "test_sweep.py",
    "web.md": "test_demo_server.py",
}
"""Which test runs the Python and TOML of a page; test_docs_commands.py has the commands."""


def code(page: str, language: str) -> str:
    """All blocks of a language on a page."""
    return "\n".join(b.text for b in blocks() if b.page.name == page and b.words[0] == language)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_paragraph_is_a_wall(page):
    for paragraph in paragraphs(page.read_text("utf-8")):
        lines = textwrap.wrap(paragraph, 110)
        assert len(lines) <= TALLEST, f"{len(lines)} lines: split {lines[0]}"


def test_paragraphs_are_told_from_lists_tables_and_code():
    page = "one\nline\n- first\n  goes on\n- second\n\n| a | b |\n\n```sh\nls\n```\nlast\n"
    assert list(paragraphs(page)) == ["one line", "- first goes on", "- second", "last"]


def test_all_code_is_run():
    shown = {block.page.name for block in blocks() if block.words[0] in ("python", "toml")}
    assert shown == set(RUN), "name the test that runs it"
    for page, test in RUN.items():
        assert page in (ROOT / "tests" / test).read_text("utf-8")


def test_a_picture_is_cut_out_from_python(tmp_path, monkeypatch, capsys):
    (tmp_path / "demo").symlink_to(ROOT / "demo")
    monkeypatch.chdir(tmp_path)
    exec(code("pictures.md", "python"), {})
    assert capsys.readouterr().out.startswith("alpha 0.")
    assert Path("out.png").is_file()


def test_a_region_may_be_in_the_units_of_the_file(tmp_path):
    (tmp_path / "scene.toml").write_text(code("plugins.md", "toml"))
    (part,) = Scene.from_toml(tmp_path / "scene.toml").parts
    assert part.region.units == "file"


def test_the_objects_of_the_gallery_are_credited(real_objects):
    """Each with the author and the licence that stand beside the files."""
    about = (real_objects / "README.md").read_text("utf-8")
    rows = [line.split(" | ") for line in about.splitlines()]
    told = {row[0].strip("| "): row[1:3] for row in rows if ".splat" in row[0]}
    page = (ROOT / "docs/gallery.md").read_text("utf-8")
    assert len(told) == 15
    for file, (licence, author) in told.items():
        (line,) = re.findall(rf"^\| {Path(file).stem} \| .*$", page, re.M)
        assert author in line and licence.lower() in line.lower()
