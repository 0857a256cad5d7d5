"""Gradio's sessions are small, few per address, and removed when their visitor has left."""

from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import pytest

from demo.visitors import Visitors


@pytest.fixture
def visitors(tmp_path) -> Visitors:
    return Visitors(tmp_path)


@pytest.fixture
def page(gradio) -> Any:
    """The parts of a page that sessions need; a real page opens event loops."""
    from gradio.blocks import BlocksConfig

    root: Any = SimpleNamespace(renderables=[])
    config = BlocksConfig(root)
    config.blocks = {1: gradio.State(None, render=False), 2: gradio.HTML("", render=False)}
    return SimpleNamespace(default_config=config, blocks=config.blocks, state_session_capacity=9)


@pytest.fixture
def sessions(gradio) -> Any:
    """The module, which imports gradio."""
    from demo import sessions

    return sessions


@pytest.fixture
def kept(sessions, page, visitors) -> Any:
    return sessions.Sessions(page, visitors)


def _ask(kept: Any, name: str, visitor: str | None = None, address: str = "10.0.0.1") -> Any:
    from demo.sessions import ASKER

    ASKER.set((visitor, address))
    return kept[name]


def test_a_session_keeps_states_and_describes_nothing(page, kept):
    state, html = page.blocks
    session = _ask(kept, "a")
    session[state] = "a picture"
    session._update_value_in_config(html, "x" * 10**6)
    assert _ask(kept, "a") is session and session[state] == "a picture"
    assert session[html] is page.blocks[html] and "x" not in str(session.config_values)
    assert list(session.components) == []


def test_an_address_has_few_sessions_and_its_visitor_stays(sessions, kept, visitors):
    most = sessions.ADDRESS
    visitors.get("here")
    _ask(kept, "first", "here")
    _ask(kept, "elsewhere", "other", "10.0.0.2")
    for number in range(3 * most):
        _ask(kept, f"new {number}", f"cookie {number}")
    assert len(kept.session_data) == most + 1 == len(kept._origins)
    assert "first" in kept and "elsewhere" in kept and f"new {3 * most - 1}" in kept
    visitors.get("many")
    for number in range(3 * most):
        _ask(kept, f"more {number}", "many")
    assert "first" in kept and len(kept.session_data) == most + 1


def test_a_session_goes_with_its_visitor(sessions, kept, visitors, monkeypatch):
    visitors.get("a")
    visitors.get("session program")
    for name, visitor in (("one", "a"), ("two", "b"), ("program", None)):
        _ask(kept, name, visitor)
    kept.sweep()
    assert len(kept.session_data) == 3, "new"
    monkeypatch.setattr(sessions, "UNCLAIMED", 0.0)
    kept.sweep()
    assert set(kept.session_data) == {"one", "program"}
    visitors.remove("a")
    kept.sweep()
    assert set(kept.session_data) == {"program"} == set(kept._origins)


def test_a_lost_connection_does_not_make_a_page_forget(page, kept):
    state, _ = page.blocks
    session = _ask(kept, "a")
    session[state] = "a picture"
    session.is_closed = True  # as Gradio does when the stream of the page ends
    lifetime, at = session._state_ttl[state]
    session._state_ttl[state] = lifetime, at - timedelta(days=1)
    kept.delete_all_expired_state()
    assert session[state] == "a picture"
