"""A minute of the hostile hour (tests/abuse/hour.py), which is run by hand."""

from __future__ import annotations

import pytest
from hour import SETTINGS, attack, check

from support.served import serving

SECONDS, VISITORS = 60.0, 10


def test_a_hostile_minute(tmp_path):
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(tmp_path, **SETTINGS) as server:
        record = attack(server, SECONDS, VISITORS)
        check(server, record, SECONDS, VISITORS)
    assert [path.name for path in server.folder.iterdir()] == ["lock"]
