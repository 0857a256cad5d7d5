"""Answers to panels: no two are equal, and no handler notices."""

from types import SimpleNamespace
from typing import Any


def _asked(gradio: Any, answer: Any, value: Any) -> tuple[list[Any], list[Any]]:
    """Return the answers to two equal requests, for a panel and for a number, and the handler's
    inputs."""
    from demo.panels import mark_answers

    got = []

    def handle(inputs: Any) -> tuple[Any, int]:
        got.append(inputs)
        return answer, 3

    event = SimpleNamespace(fn=handle, outputs=[gradio.HTML(render=False), object()])
    mark_answers(SimpleNamespace(fns={0: event}))
    return [event.fn(value) for _ in range(2)], got


def test_equal_answers_differ_and_come_back_as_they_were(gradio):
    refusal = {"message": "It is no picture."}
    (first, second), _ = _asked(gradio, refusal, None)
    assert first[0] != second[0] and first[0]["message"] == second[0]["message"]
    assert first[1] == second[1] == 3
    assert _asked(gradio, refusal, first[0])[1] == [refusal, refusal]


def test_values_outside_panels_are_kept(gradio):
    for answer in ("<p>text</p>", None, gradio.skip()):
        (first, _), got = _asked(gradio, answer, {"job": "a"})
        assert first[0] == answer and got == [{"job": "a"}] * 2
