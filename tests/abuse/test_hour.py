"""The beginning of the hostile hour (tests/abuse/hour.py), which is run by hand."""

from __future__ import annotations

import pytest
from hour import SETTINGS, attack, check

from support.served import serving


@pytest.mark.parametrize(
    ("seconds", "visitors"), [(1.0, 6), pytest.param(60.0, 10, marks=pytest.mark.slow)]
)
def test_a_hostile_minute(tmp_path, seconds, visitors):
    """Every attack, while others want a run; the short one is over when all have happened."""
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(tmp_path, **SETTINGS) as server:
        record = attack(server, seconds, visitors)
        check(server, record, seconds, visitors)
    assert [path.name for path in server.folder.iterdir()] == ["lock"]
