"""The pages of the documentation: no wall of text, and the code on them runs."""

import re
import textwrap
from pathlib import Path

import pytest

from phy124.scene import Scene
from support.pages import BLOCK, PAGES, ROOT, blocks, count_words, paragraphs

TALLEST = 8
"""Lines of 110 letters in a paragraph."""
RUN = {
    "README.md": "test_readme.py",
    "ros2-messages.md": "test_bridge_layout.py",
    "cameras.md": "test_scene_cameras.py",
    "captures.md": "test_docs_pages.py",
    "extending-files.md": "test_plugins.py",
    "extending.md": "test_plugins.py",
    "fitting.md": "test_fit.py",
    "formats.md": "test_formats.py",
    "moved-objects.md": "test_scene_objects.py",
    "objects-in-files.md": "test_scene_objects.py",
    "objects.md": "test_scene_objects.py",
    "pictures.md": "test_docs_pages.py",
    "shape.md": "test_docs_pages.py",
    "scene.md": "test_scene_reference.py",
    "sweeps.md": "test_sweep.py",
    "web-programs.md": "test_demo_server.py",
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


LINK = re.compile(r"\]\(([^)\s#]*)(?:#([^)\s]*))?\)")
WRITTEN_LATER = ("reference/api/", "reference/generated/")
"""Pages that Sphinx writes."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_heading(page):
    for path, anchor in LINK.findall(BLOCK.sub("", page.read_text("utf-8"))):
        if ":" in path or any(folder in path for folder in WRITTEN_LATER):
            continue
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), path
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target.read_text("utf-8")), f"{path}#{anchor}"


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings."""
    heads = re.findall(r"^#+ (.*)$", BLOCK.sub("", text), re.M)
    plain = (re.sub(r"\[(.*?)\]\(.*?\)", r"\1", head).lower() for head in heads)
    return {re.sub(r"[^\w\- ]", "", head).strip().replace(" ", "-") for head in plain}


@pytest.mark.parametrize(
    ("folder", "limit"), [("guide", 900), ("results", 700), ("start", 900), ("examples", 900)]
)
def test_pages_are_short(folder, limit):
    for page in (ROOT / "docs" / folder).glob("*.md"):
        words = count_words(page.read_text("utf-8"))
        assert words <= limit, f"{page.name} has {words} words: split it"


def test_every_page_is_in_the_contents():
    contents = (ROOT / "docs/index.md").read_text("utf-8")
    for folder in ("guide", "results", "lab", "design"):
        for page in (ROOT / "docs" / folder).glob("*.md"):
            assert f"\n{folder}/{page.stem}\n" in contents, page.name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_numbered_lists_count_up(page):
    last = 0
    for number in re.findall(r"^(\d+)\. ", BLOCK.sub("", page.read_text("utf-8")), re.M):
        assert int(number) in (1, last + 1), f"{number} after {last}"
        last = int(number)


def test_paragraphs_are_distinguished_from_lists_and_code():
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
    exec(code("shape.md", "python"), {})
    exec(code("pictures.md", "python"), {})
    assert capsys.readouterr().out.startswith("alpha 0.")
    assert Path("out.png").is_file()


def test_a_region_may_be_in_the_units_of_the_file(tmp_path):
    (tmp_path / "scene.toml").write_text(code("captures.md", "toml"))
    (part,) = Scene.from_toml(tmp_path / "scene.toml").parts
    assert part.region.units == "file"


def test_the_objects_of_the_gallery_are_credited(real_objects):
    """Each with the author and the licence that stand beside the files."""
    about = (real_objects / "README.md").read_text("utf-8")
    rows = [line.split(" | ") for line in about.splitlines()]
    options = {row[0].strip("| "): row[1:3] for row in rows if ".splat" in row[0]}
    page = (ROOT / "docs/gallery.md").read_text("utf-8")
    assert len(options) == 15
    for file, (licence, author) in options.items():
        (line,) = re.findall(rf"^\| {Path(file).stem} \| .*$", page, re.M)
        assert author in line and licence.lower() in line.lower()
