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
    assert "This page fetches nothing" in str(answer["error"])
