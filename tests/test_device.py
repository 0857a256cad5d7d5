"""The device that a user names."""

from __future__ import annotations

import pytest

from phy124.errors import InputError
from phy124.runtime import startup
from phy124.runtime.device import pick_device


def test_looking_for_a_device_starts_warp_quietly(monkeypatch):
    started = []
    monkeypatch.setattr(startup, "start", lambda: started.append(True))
    assert pick_device("cpu") == "cpu" and len(started) == 1
    assert pick_device("auto") in ("cpu", "cuda:0") and len(started) == 2


def test_a_device_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(InputError, match=r"no such device.*cpu"):
        pick_device("cuda:17")
