"""The time budget: processor time of the busiest thread, whatever else the machine does."""

import time

import pytest

from phy124.mpm.threads import Team
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare, spent
from phy124.simulation.spent import Spent
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


def run(**changes) -> Simulation:
    quick = {"accuracy": {"cells": 8}, "time.frames": 4, "time.budget": 60.0}
    return Simulation(prepare(ball(100), Scene.named("drop").replaced({**quick, **changes})))


def test_a_busy_machine_does_not_stop_a_run(monkeypatch):
    """A clock on which each look is a minute later than the one before."""
    looks = iter(range(10**9))
    monkeypatch.setattr(time, "perf_counter", lambda: 60.0 * next(looks))
    slow = run()
    slow.run()
    assert slow.stopped is None and slow.count == 4
    assert 0 < slow.spent.earlier < 60


def test_a_run_that_computes_for_too_long_stops(monkeypatch):
    looks = iter(range(10**9))
    monkeypatch.setattr(spent.time, "thread_time", lambda: 50.0 * next(looks))
    long = run()
    long.run()
    assert "twice time.budget" in str(long.stopped)


def test_time_spent_before_a_pause_counts():
    first = run()
    first.step(), first.step()
    second = run()
    second.restore(first.snapshot())
    assert second.spent.earlier == first.spent.earlier > 0


def test_the_busiest_thread_counts():
    work = {1: 2e-3, 2: 2e-2}

    def compute(member: int) -> None:
        begun = time.thread_time()
        while time.thread_time() - begun < work[member]:
            pass

    team = Team(3)
    counted = Spent(team, "cpu")
    for _ in range(2):
        with counted.counting(), team.running():
            for _ in range(3):
                team.put(compute)
            team.join()
    # The last task of a stretch is added when its thread looks for the next one.
    assert counted.earlier >= 2 * 2 * work[2]
    assert team.seconds[2] > team.seconds[1] >= 4 * work[1]


def test_on_a_gpu_the_clock_counts(monkeypatch):
    looks = iter([0.0, 1.0, 4.0, 9.0])
    monkeypatch.setattr(spent.time, "perf_counter", lambda: next(looks))
    counted = Spent(Team(1), "cuda:0")
    assert counted.total() == pytest.approx(1.0)
