"""Marks on the answers to the page's panels, so that no two of them are equal.

Gradio does not tell a panel of a value that equals the one before: after a second, equal refusal a
panel would wait for its answer for ever.
"""

from __future__ import annotations

import secrets
from functools import wraps
from typing import Any

import gradio as gr

from .handlers import Handler

MARK = "mark"
"""Key of the mark in a value."""


def mark_answers(page: Any) -> None:
    """Mark what all handlers of a `gr.Blocks` answer to its panels; they do not see the marks."""
    for event in page.fns.values():
        panels = [isinstance(block, gr.HTML) for block in event.outputs]
        if event.fn is not None and any(panels):
            event.fn = _marking(event.fn, panels)


def _marking(handle: Handler, panels: list[bool]) -> Handler:
    # Not by the components: Gradio makes new ones, of the class that it knows, for each session.
    @wraps(handle)
    def marking(*arguments: Any) -> Any:
        answer = handle(*map(_unmarked, arguments))
        if len(panels) == 1:
            return _marked(answer)
        return [
            _marked(value) if is_panel else value
            for value, is_panel in zip(answer, panels, strict=True)
        ]

    return marking


def _marked(value: Any) -> Any:
    if not isinstance(value, dict) or value == gr.skip():
        return value
    return {**value, MARK: secrets.token_hex(4)}


def _unmarked(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: part for key, part in value.items() if key != MARK}
