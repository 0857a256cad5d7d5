"""Requests of programs: their arguments as models, and their number."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from demo.exports import EXPORTS


def test_extras_leave_out_the_scene_and_compose(gradio):
    from demo.endpoints import GenerateRequest, MeasureRequest

    asked = {"image": "a.png", "preset": "press", "accuracy": "draft", "side": "b.png"}
    extras = MeasureRequest(**asked).extras
    assert extras["side"] == "b.png" and not {"image", "preset", "compose"} & set(extras)
    assert GenerateRequest(**asked, compose=True).extras == {**extras, "compose": True}


def test_requests_with_too_few_values_are_refused_in_a_sentence(gradio):
    from demo.photo import count_values

    blocks = [SimpleNamespace(label=name, skip_api=not name) for name in ("", "first", "second")]
    event = SimpleNamespace(inputs=blocks, api_name="add", api_visibility="public")
    page: Any = SimpleNamespace(validate_inputs=lambda event, inputs: None)
    count_values(page)
    page.validate_inputs(event, [None, 1, 2])
    for values in ([1], [None, 1, 2, 3]):
        sentence = rf"add: .* 2 arguments \(first, second\), but the request has {len(values)}\."
        with pytest.raises(gradio.Error, match=sentence):
            page.validate_inputs(event, values)


def test_formats_that_the_server_cannot_write_are_refused_first(gradio, monkeypatch):
    from demo import endpoints

    monkeypatch.setattr(endpoints, "_admit", lambda *_: "a")
    monkeypatch.setitem(EXPORTS, "ply", replace(EXPORTS["ply"], available=lambda: False))
    asked = endpoints.GenerateRequest(image=None, preset="drop", accuracy="draft", formats=["ply"])
    with pytest.raises(gradio.Error, match=r"formats: There is no ply\. Give html or "):
        next(endpoints._generate(SimpleNamespace())(None, asked))


def test_agents_read_how_a_video_is_sent(gradio):
    from demo import tools

    described = tools._describe("fit", "video", {"video"})
    assert "gradio_api/upload" in described and "data:" not in described
    fit: Any = SimpleNamespace(files={"video"})
    with pytest.raises(gradio.Error, match="Give the path that POST gradio_api/upload"):
        asyncio.run(tools.ToolServer._stored(None, fit, {"video": "data:video/mp4;base64,AA=="}))
