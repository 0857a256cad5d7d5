"""The load from other programs, and the range of times that follows from it."""

import pytest

from phy124.accuracy import load
from phy124.accuracy.load import Load, format_span


def test_a_busy_machine_is_less_sure():
    quiet, busy = Load(), Load(2.0, 3.0)
    (low, high), (lower, higher) = quiet.span(10), busy.span(10)
    assert low < 10 < high < 2.5 * low
    assert lower < low < high < higher < 3.5 * lower
    assert Load(20.0, 30.0).span(10) == busy.span(10), "however many there are"
    assert not quiet.busy and busy.busy
    assert Load.measure("cuda:0") == quiet


@pytest.mark.parametrize(
    ("single", "two", "thread", "simulation"),
    [
        (1.0, 0.99, 1.0, 1.0),
        (1.0, 0.7, 1.0, 1.5),  # one other leaves a core to us: there is no second thread
        (0.5, 0.3, 2.0, 3.0),
    ],
)
def test_others_are_seen_by_what_they_leave_of_the_cores(
    monkeypatch, single, two, thread, simulation
):
    monkeypatch.setattr(load, "cores", lambda: 2)
    monkeypatch.setattr(load, "_measure_fraction", {1: single, 2: two}.get)
    assert Load.measure() == Load(thread, simulation)


def test_past_load_of_other_processes_does_not_count(monkeypatch):
    monkeypatch.setattr(load, "_measure_fraction", lambda threads: 1.0)
    monkeypatch.setattr("os.getloadavg", lambda: (8.0, 8.0, 8.0))
    assert not Load.measure().busy


def test_threads_that_spin_do_not_take_the_lock_from_each_other(monkeypatch):
    monkeypatch.setattr(load, "SPIN", 0.02)
    assert all(0 < load._measure_fraction(threads) <= 1.1 for threads in (1, 2))


def test_durations_are_formatted_as_text():
    assert format_span((0.2, 0.9)) == "1 s"
    assert format_span((8.2, 13.7)) == "8 to 14 s"
    assert format_span((60, 120)) == "1.0 to 2.0 min"
    assert format_span((3600, 9000)) == "1.0 to 2.5 h"
