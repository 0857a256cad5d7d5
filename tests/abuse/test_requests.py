"""Requests that no page of ours would send, one by one, to a server that nobody else uses."""

from __future__ import annotations

from typing import Any

import pytest
from attacker import Attacker

from phy124.scene import Scene
from support.served import ROOT, serving

DUCK = (ROOT / "demo/examples/duck.png").read_bytes()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(
        tmp_path_factory.mktemp("requests"), gaussians=1000, warm=False, warm_up=False
    ) as running:
        yield running


@pytest.fixture
def attacker(server) -> Attacker:
    return Attacker(server)


SCENE = Scene.named("drop").data()
REFUSED: dict[str, tuple[str, str, list[Any], dict[str, Any]]] = {
    "picture": ("picture", "choose", [], {"upload": "/no"}),
    "nothing": ("picture", "choose", [], {}),
    "strokes": ("picture", "correct", [{}, None], {"strokes": "x"}),
    "view": ("known", "choose", [], {"option": "side", "upload": "/no"}),
    "object": ("others", "choose", [], {"option": "right", "upload": "/no"}),
    "generate": ("go", "click", [None, SCENE, None], {}),
    "measure": ("forecast", "measure", [None, SCENE, None], {}),
    "touch": ("begin-touch", "click", [None, SCENE, None], {}),
    "save": ("touch", "save", [None, None], {}),
    "fit": ("fit", "begin", [None, {}], {"upload": "/no"}),
}
"""Requests that are refused at once: panel, event, inputs, data."""


@pytest.mark.parametrize("kind", REFUSED)
def test_no_two_refusals_are_equal(attacker, kind):
    """Gradio tells a panel of no answer that equals the one before: it would wait for ever."""
    panel, event, inputs, data = REFUSED[kind]
    attacker.uploaded(DUCK)
    first, second = (attacker.press(panel, event, inputs, **data)[0] for _ in range(2))
    assert first.pop("mark") != second.pop("mark")
    for answer in (first, second):
        answer.pop("elapsed", None)
    assert first == second


def test_nothing_is_fetched_for_a_panel_that_was_left_as_it_is(attacker):
    """Gradio makes a new component for this session then."""
    attacker.press("None", "load", [])
    url = "https://example.com/a.png"
    shown = {"picture": {"path": url, "url": url, "meta": {"_type": "gradio.FileData"}}}
    answer = attacker.press("picture", "correct", [shown, None], strokes=[])
    assert "This page downloads nothing" in str(answer["error"])


def test_a_proxy_gives_the_page_no_foreign_name(attacker):
    for header in ("X-Forwarded-Host", "X-Gradio-Server"):
        for path in ("/", "/config"):
            status, text, _ = attacker.get(path, **{header: "evil.example"})
            assert status == 421 and "evil" not in text


ODD: dict[str, dict[str, Any]] = {
    "path": {"changes": {".".join(["a"] * 3000): 1}},
    "frames": {"frames": True},
    "number": {"changes": {"material.E": True}},
    "boolean": {"changes": {"checks.energy": "yes"}},
    "compose": {"compose": "yes"},
    "thickness": {"thickness": True},
}


@pytest.mark.parametrize("kind", ODD)
def test_odd_values_are_refused_in_words_and_not_logged(server, attacker, kind):
    path, before = attacker.uploaded(DUCK), server.log.stat().st_size
    answer = attacker.generate({"path": path}, **ODD[kind])
    assert "error" in answer and "null" not in answer and len(answer) < 600, answer
    assert server.log.stat().st_size == before, server.said()


PANELS = [("picture", "correct"), ("picture", "cut"), ("fit", "begin")]


@pytest.mark.parametrize("value", [5, "x", [], [1]])
@pytest.mark.parametrize(("panel", "event"), PANELS)
def test_a_panel_of_another_form_is_taken_as_empty(server, attacker, panel, event, value):
    before = server.log.stat().st_size
    inputs = [None, value] if panel == "fit" else [value, None]
    assert isinstance(attacker.press(panel, event, inputs), list)
    assert server.log.stat().st_size == before, server.said()
