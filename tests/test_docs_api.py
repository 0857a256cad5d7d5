"""The API reference is written from the docstrings, without importing what they are in."""

import importlib.util

import pytest

import phy124
from support.pages import ROOT


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, str]:
    """Every page by its name."""
    for needed in ("griffe", "sphinx"):
        pytest.importorskip(needed, reason="the extra docs is not installed")
    spec = importlib.util.spec_from_file_location("docs_api", ROOT / "docs/api.py")
    api = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(api)
    api.PAGES = tmp_path_factory.mktemp("api")
    api.write_pages()
    return {path.stem: path.read_text("utf-8") for path in api.PAGES.iterdir()}


def test_each_room_has_a_page_and_a_line_in_the_contents(pages):
    rooms = {path.stem for path in (ROOT / "phy124").iterdir() if path.suffix == ".py"}
    assert {room for room in rooms if not room.startswith("_")} < set(pages)
    assert {"scene", "mpm", "materials", "io", "rendering", "kernels"} < set(pages)
    assert {"demo", "bridge"} < set(pages)
    assert "commands" not in pages
    for name in set(pages) - {"index"}:
        assert f"({name}.md)" in pages["index"]
    for name in phy124.__all__:
        assert f"[phy124.{name}](" in pages["index"]


def test_api_pages_cover_demo_bridge_and_kernels(pages):
    assert "## demo.work.order" in pages["demo"] and "class Order" in pages["demo"]
    assert "### LiveSink" in pages["bridge"] and "## bridge.sinks.mcap" in pages["bridge"]
    assert "## phy124.kernels.splat.project" in pages["kernels"]
    assert "def drucker_prager(" in pages["kernels"]


def test_signature_arguments_and_refusals_are_on_the_page(pages):
    page = pages["io"][pages["io"].index("### read_ply") :]
    shown = page[: page.index("### write_ply")]
    assert "def read_ply(" in shown and "```python" in shown
    assert "- `dialect`: The program that wrote the file" in shown
    assert "**Raises**" in shown and "- `InputError`: If the file is missing" in shown


def test_markdown_s_own_letters_are_no_markup(pages):
    assert r"\[N,3\]" in pages["gaussians"]
    assert r"\*and\*" in pages["particles"], "a star in a docstring is a star"
    assert "`THINNEST`" in pages["particles"]


def test_private_names_are_left_out(pages):
    assert not any("def _" in page for page in pages.values())
