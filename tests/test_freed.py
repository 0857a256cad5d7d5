"""A run's arrays are freed with the run, although Python does not search for cycles of references.

A sweep, a fit or a page would otherwise keep several finished runs.
"""

import gc
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import warp as wp

from phy124.live import Live
from phy124.mpm import Solver, Unstable
from phy124.runtime.context import RunContext
from phy124.runtime.weakly import weakly
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.liquids import pool
from support.runs import SCENE, WITH
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SHORT = {"accuracy": {"cells": 6}, "time.frames": 3, "checks.energy": True}
SAND = {
    "checks.energy": False,
    "objects": [
        {
            "name": "sand",
            "shape": "box",
            "size": 0.6,
            "material": {"law": "sand"},
            "place": [0, 1.2],
        }
    ],
}


def preset(name: str, **changes) -> Scene:
    return Scene.named(name).replaced({**SHORT, **changes})


SCENES = {
    "particles": lambda: preset("drop", accuracy={"cells": 6, "solver": "mpm"}, contacts=True),
    "lattice": lambda: preset("drop", accuracy={"cells": 6, "solver": "lattice"}),
    "several lattices": lambda: preset("land_on_cushion"),
    "lattice and particles": lambda: preset("drop", **SAND),
    "liquid": lambda: preset("water", accuracy={"cells": 6, "liquid": "projection"}),
    "lattice in liquid": lambda: pool(time={"frames": 3, "fps": 24}),
    "sand in liquid": lambda: pool(time={"frames": 3, "fps": 24}, material={"law": "sand"}),
    "free solid": lambda: SCENE.replaced({**WITH["free solid"], **SHORT}),
    "contacts": lambda: SCENE.replaced({**WITH["velocities and contacts"], **SHORT}),
}


def simulation(scene: Scene, threads: int = 2) -> Simulation:
    run = Simulation(prepare(ball(400), scene, RunContext(threads=threads)))
    run.step()
    run.restore(run.snapshot())
    run.step()
    return run


def live() -> Live:
    walls = [{"kind": "ground"}, {"kind": "sphere", "centre": [0, 0.8, 0.2], "radius": 0.25}]
    run = Live(ball(400), preset("drop", boundaries=walls), RunContext(threads=1))
    run.step()
    run.grab((0, 0, 0.3))
    run.step()
    run.release()
    run.push((200, 0, 0), seconds=0.1)
    run.move(1, (0, -0.4, 0))
    run.step()
    return run


@contextmanager
def without_collector() -> Iterator[None]:
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def objects() -> dict[int, object]:
    """All arrays on the device, and all objects of phy124's classes, by their address."""
    return {
        id(each): each
        for each in gc.get_objects()
        if type(each) is wp.array or str(type(each).__module__).startswith("phy124.")
    }


def survivors(make: Callable[[], object]) -> list[str]:
    """Return the classes of the objects that are left of a run after its last reference is gone."""
    make()  # Kernels and scenes are kept for the next run.
    with without_collector():
        before = set(objects())
        run = make()
        made = [each for key, each in objects().items() if key not in before]
        names = [type(each).__name__ for each in made]
        assert names.count("array") > 20 and "Model" in names
        references = [weakref.ref(each) for each in made if hasattr(each, "__weakref__")]
        del run, made
        return sorted(type(each()).__name__ for each in references if each() is not None)


MORE = ("several lattices", "sand in liquid", "contacts")
"""The parts of these scenes are in the others, too."""


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[pytest.mark.slow] * (kind in MORE)) for kind in SCENES],
)
def test_a_finished_run_leaves_nothing(kind):
    scene = SCENES[kind]()
    assert survivors(lambda: simulation(scene)) == []


def test_a_live_run_leaves_nothing():
    assert survivors(live) == []


def test_a_run_that_stopped_leaves_nothing(monkeypatch):
    def fail(solver, until, **options):
        raise Unstable("a particle is lost")

    monkeypatch.setattr(Solver, "advance", fail)
    scene = preset("drop", accuracy={"cells": 6, "solver": "mpm"})

    def run() -> Simulation:
        stopped = Simulation(prepare(ball(400), scene))
        stopped.run()
        assert "a particle is lost" in str(stopped.stopped)
        return stopped

    assert survivors(run) == []


def test_a_weak_call_does_not_keep_the_owner():
    class Owner:
        def double(self, value: int) -> int:
            return 2 * value

    owner = Owner()
    call, reference = weakly(owner.double), weakref.ref(owner)
    assert call(3) == 6
    del owner
    assert reference() is None
    with pytest.raises(AssertionError):
        call(3)
