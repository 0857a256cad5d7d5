"""Case 30: runs get further if a user follows the remedies in error messages."""

from collections.abc import Iterator
from typing import Any

from phy124.errors import InputError, Remedy
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball
from phy124.studies.validation.stress.case import Check, Setting, at_least, at_most, equal

SMALL: dict[str, Any] = {
    "accuracy": {"cells": 6, "particles_per_axis": 2.0},
    "time": {"frames": 4, "fps": 24.0},
    "binding": "lattice",
}
LONG: dict[str, Any] = {"frames": 400, "fps": 24.0, "budget": 1e8}
EXCESS = 1.4
"""Estimated time divided by the time budget; every device refuses a scene at this ratio."""
REFUSED: dict[str, dict[str, Any]] = {
    "stiff": {"material": {"law": "neo_hookean", "E": 1e12}, "time": LONG},
    "rubbing": {"material": {"law": "neo_hookean", "damping": 1e7}, "time": LONG},
    "viscous": {"material": {"law": "fluid", "density": 1.0, "viscosity": 1e5}, "time": LONG},
    "ceiling": {"time": {**LONG, "substep": 1e-8}},
    "rigid": {"material": {"law": "rigid", "speed": 1000.0, "strain": 1e-4}, "time": LONG},
}
TOO_LONG = 2.5
"""Multiple of the stable substep at which a run is unstable; users cannot choose such substeps."""


def advice(setting: Setting) -> list[Check]:
    """Check the remedies for refused and stopped runs, one at a time."""
    checks = []
    for name, changes in REFUSED.items():
        scene = _with_short_budget(Scene.from_data({**SMALL, **changes}), setting)
        checks += list(_check_accepted(name, scene, setting))
    checks += list(_check_stop("explodes", _make_exploding(setting), setting))
    checks += list(_check_budget(_make_violent(setting), setting))
    return checks


def _check_accepted(name: str, scene: Scene, setting: Setting) -> Iterator[Check]:
    try:
        _prepare(scene, setting)
    except InputError as refusal:
        yield at_least(f"{name}: remedies given", len(refusal.remedies), 2)
        for remedy in refusal.remedies:
            yield equal(f"{name}: {remedy.words} is accepted", _is_accepted(scene, remedy, setting))
        return
    yield equal(f"{name}: is refused", False)


def _with_short_budget(scene: Scene, setting: Setting) -> Scene:
    context = RunContext(device=setting.device)
    seconds = prepare(surface_of_ball(40), scene, context).estimate.seconds
    return scene.replaced({"time.budget": seconds / EXCESS})


def _is_accepted(scene: Scene, remedy: Remedy, setting: Setting) -> bool:
    try:
        _prepare(scene.replaced(remedy.changes), setting)
    except InputError:
        return False
    return True


def _check_stop(name: str, scene: Scene, setting: Setting) -> Iterator[Check]:
    stopped = _run(scene, setting)
    yield equal(f"{name}: it stops", stopped.stopped is not None)
    yield at_least(f"{name}: remedies given", len(stopped.remedies), 1)
    for remedy in stopped.remedies:
        again = _run(scene.replaced(remedy.changes), setting)
        better = again.stopped is None or again.count > stopped.count
        yield equal(f"{name}: {remedy.words} helps", better)


def _check_budget(scene: Scene, setting: Setting) -> Iterator[Check]:
    name, stopped = "outruns its time budget", _run(scene, setting)
    yield equal(f"{name}: it stops", stopped.stopped is not None)
    yield at_least(f"{name}: remedies given", len(stopped.remedies), 2)
    few = {"time.frames": 3, "time.budget": 1000.0}
    usual = _substeps(scene.replaced(few), setting)
    for remedy in stopped.remedies:
        helped = scene.replaced(remedy.changes)
        if "time.budget" in remedy.changes:
            yield equal(f"{name}: {remedy.words} helps", _run(helped, setting).stopped is None)
        else:
            fraction = _substeps(helped.replaced(few), setting) / usual
            yield at_most(f"{name}: {remedy.words}: fraction of the substeps", fraction, 0.8)


def _substeps(scene: Scene, setting: Setting) -> int:
    return _run(scene, setting).solver.clock.substeps


def _prepare(scene: Scene, setting: Setting) -> Simulation:
    return Simulation(prepare(surface_of_ball(40), scene, RunContext(device=setting.device)))


def _run(scene: Scene, setting: Setting) -> Simulation:
    simulation = _prepare(scene, setting)
    simulation.run()
    return simulation


def _make_exploding(setting: Setting) -> Scene:
    """Return a scene with substeps that are too long, so that the run is unstable. Substeps of the
    particle solver are proportional to `cfl`.
    """
    scene = Scene.from_data({**SMALL, "object": {"spin": [0.0, 0.0, 3.0]}, "forces": []})
    update = {"cfl": TOO_LONG, "precision": setting.precision, "solver": "mpm"}
    wrong = scene.resolution.model_copy(update=update)
    return scene.model_copy(update={"accuracy": wrong})


def _make_violent(setting: Setting) -> Scene:
    """Return a scene in which the object's speed limits the substep. The estimate of the run time
    considers only the stiffness.
    """
    accuracy = {**SMALL["accuracy"], "precision": setting.precision}
    scene = {
        "accuracy": accuracy,
        "time": {"frames": 12, "fps": 24.0, "budget": 0.01},
        "object": {"velocity": [0.0, 500.0, 0.0]},
        "material": {"law": "neo_hookean", "E": 100.0},
    }
    return Scene.from_data({**SMALL, **scene, "forces": [], "boundaries": []})
