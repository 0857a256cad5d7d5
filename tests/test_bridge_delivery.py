"""Frames wait for acknowledgements, but nobody who hangs holds them up for long."""

import pytest

from bridge import delivery
from bridge.delivery import Delivery


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(delivery, "LONGEST_WAIT", 0.01)
    monkeypatch.setattr(delivery, "FAREWELL", 0.01)
    monkeypatch.setattr(delivery, "IN_BUFFERS", 0)


def test_nothing_is_lost_where_all_is_acknowledged():
    made = Delivery(lambda seconds: True, 2, lambda: pytest.fail("it waits"))
    for _ in range(10):
        made.before_frame(1)
    made.farewell()
    assert made.lost == 0


def test_a_subscriber_that_hangs_holds_up_one_frame_only(caplog):
    waits, ticks = [], []

    def never(seconds):
        waits.append(seconds)
        return False

    made = Delivery(never, 2, lambda: ticks.append(1))
    for _ in range(2):
        made.before_frame(1)
    assert not any(waits) and made.lost == 0, "the writer keeps two"
    made.before_frame(1)
    assert any(waits) and ticks and made.lost == 1
    waits.clear()
    made.before_frame(1)
    assert not any(waits) and made.lost == 2, "it does not wait again"
    made.farewell()
    assert made.lost == 4 and "it may have missed 2 of them" in caplog.text


def test_one_that_comes_back_is_waited_for_again():
    answers = iter([False, False, True])
    made = Delivery(lambda seconds: next(answers, True), 1, lambda: None)
    made.before_frame(1)
    made.before_frame(1)
    made.farewell()
    assert made.lost <= 1


def test_small_frames_are_not_held_back(monkeypatch):
    monkeypatch.setattr(delivery, "IN_BUFFERS", 1000)
    waits = []
    made = Delivery(lambda seconds: bool(waits.append(seconds)), 1, lambda: None)
    for _ in range(10):
        made.before_frame(100)
    assert not any(waits) and made.lost == 0
    made.before_frame(100)
    assert any(waits) and made.lost == 1
    made.farewell()
    assert made.lost == 11, "none of them was acknowledged"


def test_impatient_delivery_never_waits_but_counts():
    waits = []
    made = Delivery(lambda seconds: bool(waits.append(seconds)), 2, lambda: None, patient=False)
    for _ in range(5):
        made.before_frame(1)
    assert not any(waits) and made.lost == 3
