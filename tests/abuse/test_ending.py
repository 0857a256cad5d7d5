"""The end of a page: nothing of its visitors stays."""

from __future__ import annotations

import pytest
from attacker import Attacker

from support.served import ROOT, serving

DUCK = (ROOT / "demo/examples/duck.png").read_bytes()


def test_nothing_is_left_when_the_page_has_ended(tmp_path):
    """By SIGTERM; the next start sees to what a kill has left (tests/test_demo_folder.py)."""
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(tmp_path, gaussians=1000, warm=False) as running:
        Attacker(running).uploaded(DUCK)
        assert list(running.folder.rglob("*.png"))
    assert [path.name for path in running.folder.iterdir()] == ["lock"]
