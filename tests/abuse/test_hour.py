"""The beginning of the hostile hour (tests/abuse/hour.py), which is run by hand."""

from __future__ import annotations

import pytest
from hour import SETTINGS, attack, check

from support.served import serving

VISITORS = 10


@pytest.mark.parametrize("seconds", [15.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_hostile_minute(tmp_path, seconds):
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(tmp_path, **SETTINGS) as server:
        record = attack(server, seconds, VISITORS)
        check(server, record, seconds, VISITORS)
    assert [path.name for path in server.folder.iterdir()] == ["lock"]
