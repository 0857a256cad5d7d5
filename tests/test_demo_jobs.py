"""Behind the buttons: cut-outs that hang stop nobody else and are told by /health."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from demo.jobs import Studio
from demo.settings import Settings
from demo.visitors import Visitors
from phy124 import cutout, isolated
from phy124.errors import Cancelled, InputError

DUCK = str(Path(__file__).parents[1] / "demo/examples/duck.png")


@pytest.fixture
def studio(tmp_path) -> Studio:
    return Studio(Settings(), Visitors(tmp_path))


@pytest.fixture
def stuck(monkeypatch) -> threading.Event:
    """The next picture's search never ends, those after it are as usual; set once it has begun."""
    begun = threading.Event()
    usual = cutout.METHODS["alpha"]
    first = iter([True])

    def find(picture: Any, deadline: isolated.Deadline) -> Any:
        if next(first, False):
            begun.set()
            return isolated.run(time.sleep, 600, deadline=deadline)
        return usual.find(picture, deadline)

    monkeypatch.setitem(cutout.METHODS, "alpha", cutout.Method(lambda _: True, find))
    return begun


def _until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


class _Attempt(threading.Thread):
    """A cut-out in a thread, as the page makes it, and what came of it."""

    def __init__(self, studio: Studio, session: str) -> None:
        super().__init__()
        self.studio, self.session, self.came = studio, session, None
        self.start()

    def run(self) -> None:
        try:
            self.came = self.studio.cut(self.session, DUCK)
        except (InputError, Cancelled) as error:
            self.came = error


@pytest.mark.parametrize("ending", ["leave", "stop"])
def test_a_search_that_hangs_stops_nobody_else_and_ends_with_its_visitor(studio, stuck, ending):
    assert not studio.busy
    hung = _Attempt(studio, "a")
    assert stuck.wait(60) and studio.busy
    assert Path(studio.cut("b", DUCK).path).exists()
    assert studio.busy and studio.visitors.get("a").busy and not studio.visitors.get("b").busy
    getattr(studio.visitors, ending)("a")
    hung.join(60)
    assert isinstance(hung.came, Cancelled)
    assert not studio.busy


def test_a_search_that_hangs_is_refused_when_its_time_is_up(tmp_path, stuck):
    studio = Studio(Settings(max_cut_seconds=0.5), Visitors(tmp_path))
    with pytest.raises(InputError, match=r"did not finish within 0\.5 s"):
        studio.cut("a", DUCK)
    assert not studio.busy and list(tmp_path.glob("*/cutouts/*")) == []


def test_waiting_for_a_turn_ends_with_its_visitor(studio):
    with studio.cutting.turn(lambda: None), studio.cutting.turn(lambda: None):
        waiting = _Attempt(studio, "a")
        _until(lambda: studio.visitors.get("a").busy)
        studio.visitors.leave("a")
        waiting.join(60)
    assert isinstance(waiting.came, Cancelled)


def test_a_doubtful_cut_out_is_told_once_and_not_after_a_correction(studio, tmp_path, monkeypatch):
    table = np.zeros((60, 80), np.uint8)
    table[20:] = 255
    way = cutout.Method(lambda _: True, lambda *_: table)
    monkeypatch.setitem(cutout.METHODS, "grabcut", way)
    monkeypatch.setattr(cutout.u2net, "weights_file", lambda: None)
    picture = str(tmp_path / "a.png")
    Image.fromarray(np.dstack([table] * 3)).save(picture)
    (doubt,) = studio.cut("a", picture).doubts
    assert "touches 3 edges of the picture (left, right, bottom)" in doubt
    assert studio.cut("a", picture).doubts == ()
    strokes = Image.new("RGBA", (80, 60), (0, 255, 0, 255))
    strokes.paste((255, 0, 0, 255), (0, 0, 80, 30))
    assert studio.cut("a", picture, strokes).doubts == ()
