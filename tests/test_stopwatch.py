"""The stopwatch: every second belongs to a stage, and nothing stays open."""

import pytest

from phy124.runtime import stopwatch
from phy124.runtime.stopwatch import Stopwatch


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    """A clock that stands still unless it is set."""
    now = [100.0]
    monkeypatch.setattr(stopwatch.time, "perf_counter", lambda: now[0])
    return now


def test_stages_add_up_when_they_are_entered_again(clock):
    watch = Stopwatch()
    for seconds in (2.0, 3.0):
        with watch.stage("render"):
            clock[0] += seconds
    clock[0] += 1.0
    assert watch.seconds == {"render": 5.0} and watch.total == 6.0


def test_inner_stage_does_not_count_for_the_outer_one(clock):
    watch = Stopwatch()
    with watch.stage("encode"):
        clock[0] += 1.0
        for _ in range(2):
            with watch.stage("render"):
                clock[0] += 2.0
                with watch.stage("deform"):
                    clock[0] += 4.0
    assert watch.seconds == {"encode": 1.0, "render": 4.0, "deform": 8.0}


def test_a_stage_that_breaks_is_counted(clock):
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch.stage("simulate"):
        clock[0] += 2.0
        raise ZeroDivisionError
    assert watch.seconds == {"simulate": 2.0}


def test_stopwatch_counts_only_next_and_closes_iterators(clock):
    closed = []

    def frames():
        try:
            for index in range(9):
                clock[0] += 1.0
                yield index
        finally:
            closed.append(True)

    watch, source = Stopwatch(), frames()
    each = watch.each("simulate", source)
    for _ in range(3):
        next(each)
        clock[0] += 10.0
    each.close()
    assert watch.seconds == {"simulate": 3.0} and closed


def test_a_run_that_goes_on_keeps_what_it_had_spent(clock):
    watch = Stopwatch()
    with watch.stage("render"):
        clock[0] += 1.0
    watch.add({"render": 4.0, "save": 0.5}, total=10.0)
    watch.launches["render"] = 7
    assert watch.total == 11.0
    assert watch.data() == [
        {"name": "render", "seconds": 5.0, "launches": 7},
        {"name": "save", "seconds": 0.5, "launches": None},
    ]
