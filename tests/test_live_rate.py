"""Live runs in real time: the finest grid that a machine simulates fast enough, and late frames."""

from types import SimpleNamespace

import pytest

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.live import RealTime, choose, engine, held_rate
from phy124.runtime import stopwatch
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from support.lives import scene, thing

pytestmark = pytest.mark.usefixtures("coarse_solids")


def test_the_grid_is_as_fine_as_this_machine_holds(monkeypatch):
    now = [0.0]

    def show(frame):
        now[0] += 1.0

    with monkeypatch.context() as patch:
        for clock in (choose, stopwatch):
            patch.setattr(clock, "time", SimpleNamespace(perf_counter=lambda: now[0]))
        slow = held_rate(thing(), scene(), RunContext(threads=1), show=show)
    assert slow.scene.resolution.cells == 8 and slow.scene.binding == "lattice"
    assert slow.factor == pytest.approx(1 / 24)
    exact = held_rate(thing(), scene(), RunContext(threads=1), max_error=0.15)
    assert exact.promise.error <= 0.15 and "at most" in exact.sentence
    with pytest.raises(InputError, match="rate"):
        held_rate(thing(), scene(), rate=float("nan"))


def test_finest_grid_in_real_time_follows_from_a_trial(monkeypatch):
    tried = []

    def trial(gaussians: Gaussians, on: Scene, *_) -> choose.Cost:
        tried.append(on.resolution.cells)
        return choose.Cost(12, substeps=0.002, others=0.01)

    monkeypatch.setattr(choose, "_trial", trial)
    # A frame may take 0.8 / 24 = 33 ms: 25.4 of 20 cells and 42 of 24 fit and do not.
    held = held_rate(thing(), scene())
    assert held.scene.resolution.cells == 20 and tried == [12]
    assert held.factor == pytest.approx(1 / (24 * (0.01 + 0.002 * (20 / 12) ** 4)))
    assert held_rate(thing(), scene(), rate=0.5).scene.resolution.cells == 24
    assert held_rate(thing(), scene(), rate=4).scene.resolution.cells == 8


def test_late_frames_slow_time_down_and_never_queue_up():
    now, waits = [0.0], []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        now[0] += seconds

    clock = RealTime(10, clock=lambda: now[0], sleep=sleep)
    for _ in range(30):
        now[0] += 0.02
        clock.wait()
    assert clock.factor == pytest.approx(1) and waits[-1] == pytest.approx(0.08)
    now[0] += 5
    clock.wait()
    before = len(waits)
    clock.wait()
    # The five seconds are not caught up: the next frame is due a tenth of a second later.
    assert len(waits) == before + 1 and waits[-1] == pytest.approx(0.1)
    for _ in range(30):
        now[0] += 0.2
        clock.wait()
    assert clock.factor == pytest.approx(0.5)


def test_trial_of_real_time_outlives_a_frame_that_drops_its_hand(monkeypatch):
    monkeypatch.setattr(engine, "SLOWEST", 1.0)
    held = held_rate(thing(), scene(**{"material.E": 2e4}))
    assert held.scene.resolution.cells in choose.CELLS
