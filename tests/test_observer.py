"""Observers: a list that a run loops over, to which anyone may add."""

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
import pytest

from phy124.budget.effects import Effects
from phy124.gaussians import Frame
from phy124.monitor import OBSERVERS, observers_for
from phy124.monitor.contacts import Contacts
from phy124.monitor.dissipation import Dissipation
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.interior import Interior
from phy124.monitor.observer import Effect, Observer, Subject, Violation, find
from phy124.monitor.sleep import Sleep
from phy124.monitor.softening import Softening
from phy124.monitor.tearing import Tearing
from phy124.monitor.watchdog import Watchdog
from phy124.monitor.wrenches import Wrenches
from phy124.mpm import Solver
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped, prepare
from support.runs import resumed
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {
    "accuracy": {"cells": 8, "solver": "mpm"},
    "time.frames": 5,
    "boundaries": [],
    "forces": [],
}


class Height(Observer):
    """An observer as a user writes it: the largest height of a particle in each frame."""

    absent: ClassVar[dict[str, Any]] = {"height": None}
    limit = np.inf

    def __init__(self) -> None:
        self.heights: list[float] = []
        self.calls = {"substeps": 0, "attempts": 0}

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        return Effect("height of the object")

    def bind(self, solver: Solver, observers: Sequence[Observer] = ()) -> None:
        self._state = solver.state

    def before_attempt(self, *, closely: bool) -> None:
        self.calls["attempts"] += 1

    def after_substep(self) -> None:
        self.calls["substeps"] += 1

    def after_attempt(self) -> Violation | None:
        high = self._state.x.numpy()[:, 2].max()
        return Violation("it flies too high", ("push",)) if high > self.limit else None

    def after_frame(self, frame: Frame) -> Frame:
        self.heights.append(float(self._state.x.numpy()[:, 2].max()))
        return frame

    def notes(self) -> list[str]:
        return [f"It reaches {max(self.heights):.2f} m."]

    def report(self, frames: Sequence[Frame]) -> dict[str, Any]:
        return {"height": self.heights}

    def snapshot(self) -> dict[str, Any]:
        return {"heights": list(self.heights)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        self.heights = list(snapshot["heights"])


def throw(observers: Sequence[type[Observer]] = (*OBSERVERS, Height)) -> Simulation:
    scene = Scene.named("drop").replaced({**QUICK, "object.velocity": (0, 0, 2.0)})
    return Simulation(prepare(ball(200), scene, RunContext(threads=1), observers=observers))


def test_an_observer_from_outside_is_asked_and_reported():
    run = throw()
    clip = run.run()
    height = run.find(Height)
    assert height.calls == {"substeps": clip.report["substeps"], "attempts": 4}
    assert clip.report["height"] == height.heights and len(height.heights) == 5
    assert height.heights == sorted(height.heights) and height.heights[4] > height.heights[0] + 0.1
    assert clip.report["notes"][-1] == f"It reaches {height.heights[4]:.2f} m."
    assert "height of the object" in clip.report["effects"]["ran"]
    assert np.array_equal(throw(OBSERVERS).run().means, clip.means)


def test_an_observer_from_outside_ends_a_run(monkeypatch):
    monkeypatch.setattr(Height, "limit", 1.0)
    run = throw()
    with pytest.raises(Stopped, match="it flies too high"):
        list(run)
    assert run.retried == [run.count] and run.find(Height).calls["attempts"] == run.count + 1


def test_an_observer_from_outside_is_resumed(tmp_path):
    whole, run = throw(), throw()
    again = resumed(run, 2, tmp_path / "pause.safetensors", observers=(*OBSERVERS, Height))
    assert again.run().report["height"] == whole.run().report["height"]
    assert "height" not in resume.load(tmp_path / "pause.safetensors").run().report


USUAL = {ExternalWork, Watchdog, Tearing, Interior, Sleep}
PROFILE = {"kind": "sine", "offset": 2.0}


@pytest.mark.parametrize(
    ("changes", "kinds"),
    [
        ({}, USUAL),
        ({"checks.balance": False, "time.sleep": False, "grains": False}, {Watchdog, Tearing}),
        ({"contacts": True}, {*USUAL, Contacts, Wrenches}),
        ({"stiffness_profile": PROFILE}, {*USUAL, Softening}),
        (
            {"material": {"law": "sand"}, "checks.energy": True},
            {ExternalWork, Watchdog, Sleep, Dissipation},
        ),
    ],
)
def test_a_run_has_the_observers_its_scene_calls_for(changes, kinds):
    scene = Scene.named("drop").replaced({**QUICK, **changes})
    run = Simulation(prepare(ball(200), scene, RunContext(threads=1)))
    assert {type(observer) for observer in run.observers} == kinds
    assert run.find(Watchdog) is not None and find([], Watchdog) is None


def test_observers_compile_only_for_scenes_that_call_for_them():
    def modules(**changes: Any) -> Iterator[str]:
        scene = Scene.named("press").replaced(changes)
        subject = Subject(scene, scene.materials)
        for kind in OBSERVERS:
            if kind.called_for(subject):
                yield from (kernel.module.name for kernel in kind.kernels(subject, float))

    plain, asked = list(modules()), list(modules(contacts=True))
    assert len(asked) == len(plain) + 5, "two for each wall, three to share its impulse out"
    assert len(list(modules(**{"checks.balance": False}))) == len(plain) - 2


@pytest.mark.parametrize("solver", ["mpm", "lattice"])
def test_each_observer_has_one_row_of_effects(solver):
    scene = Scene.named("press").replaced({"accuracy.solver": solver})
    rows = Effects.of(scene)
    names = [*rows.ran, *(omission.name for omission in rows.left_out)]
    kinds = observers_for(scene)
    observed = [kind.effect(Subject(scene, scene.materials)) for kind in kinds]
    assert all(names.count(row.name) == 1 for row in observed if row is not None)
