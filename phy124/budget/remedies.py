"""Proposes remedies: changes to a scene whose run was stopped or refused.

Each remedy is sufficient by itself. `phy124 stress` tests the remedies that runs propose.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from phy124.errors import InputError, Remedy
from phy124.forces import SetVelocity
from phy124.scene import Scene

SURE = "solver", "law"
"""Only these `REMEDIES` are proposed if particles can replace lattices.

When undamped bodies were pressed to a fifth of their height, another solver helped in all of 7
stopped runs, and so did another law. Halving the speeds and forces helped in 5 of the 7 runs, and
so did damping. In stopped runs of random scenes, another solver helped in 6 of 6 runs, fewer cells
in 4 of 6, half the speeds in 3 of 6, and damping in 0 of 4.
"""
SOFTER = 16.0
"""Factor by which a remedy divides E; the longest substep is then four times as long."""


def find_remedies(
    causes: Sequence[str], scene: Scene, time: float = math.inf
) -> tuple[Remedy, ...]:
    """Return the remedies for a run that stopped at `time` [s]; remedies that change nothing are
    omitted.

    `causes` are keys of `REMEDIES`, the likeliest first.
    """
    if "push" in causes and (motion := _end_motion(scene, time)):
        return (motion,)  # while the object is moved into the obstacle, no other change helps
    named = ((cause, REMEDIES[cause](scene)) for cause in causes)
    useful = {cause: each for cause, each in named if each and _changes(each, scene)}
    return tuple(each for cause, each in useful.items() if "solver" not in useful or cause in SURE)


def _changes(remedy: Remedy, scene: Scene) -> bool:
    try:
        return scene.replaced(remedy.changes) != scene
    except InputError:
        return False


def advise(remedies: Sequence[Remedy]) -> str:
    """Return a sentence with the remedies, or ""."""
    words = [remedy.words for remedy in remedies]
    return f"Use {join_alternatives(words)}." if words else ""


def join_alternatives(words: Sequence[str]) -> str:
    """Join words as "A, B or C"."""
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def change_accuracy(scene: Scene, **values: Any) -> Remedy:
    """Return the remedy that changes values in `accuracy`; the accuracy then has no name."""
    changed = scene.resolution.model_copy(update=values).model_dump()
    words = ", ".join(f"accuracy.{name} = {_format(value)}" for name, value in values.items())
    return Remedy(words, {"accuracy": changed})


def change_field(field: str, value: Any) -> Remedy:
    """Return the remedy that sets a field of the scene to a value."""
    return Remedy(f"{field} = {_format(value)}", {field: value})


def _halve_push(scene: Scene) -> Remedy | None:
    changes: dict[str, Any] = {}
    others = [(f"objects.{index}", other) for index, other in enumerate(scene.objects)]
    for path, body in (("object", scene.object), *others):
        for name in ("velocity", "spin"):
            value = getattr(body, name)
            if any(value):
                changes[f"{path}.{name}"] = [x / 2 for x in value]
    for path, other in others:
        slower = {} if other.path is None else other.path.gentler()
        changes |= {f"{path}.motion.{name}": value for name, value in slower.items()}
    for index, force in enumerate(scene.forces):
        changes |= {f"forces.{index}.{name}": value for name, value in force.gentler().items()}
    for index, wall in enumerate(scene.boundaries):
        changes |= {f"boundaries.{index}.{name}": value for name, value in wall.gentler().items()}
    return Remedy("a gentler push (half the speeds and forces)", changes) if changes else None


def _end_motion(scene: Scene, time: float) -> Remedy | None:
    """Return the remedy that shortens the prescribed motions at `time`.

    In a test, a ball was moved into the ground until the run stopped. When the motion ended after
    half of this time, the run was completed.
    """
    changes: dict[str, Any] = {}
    for index, force in enumerate(scene.forces):
        lasts = force.start < time < (math.inf if force.end is None else force.end)
        if isinstance(force, SetVelocity) and force.region is None and lasts:
            end = force.start + (time - force.start) / 2
            changes[f"forces.{index}.end"] = float(f"{end:.2g}")
    words = ", ".join(f"{field} = {_format(value)}" for field, value in changes.items())
    return Remedy(words, changes) if changes else None


def _change_solver(scene: Scene) -> Remedy | None:
    """Propose particles instead of lattices. In a liquid, propose lattices instead of particles. In
    a test, a lid held a light ball under water: as particles, the ball vibrated more and more until
    the run stopped; on a lattice, the vibrations decayed.
    """
    if scene.on_lattice:
        return change_accuracy(scene, solver="mpm")
    if not scene.mixes or scene.immerses:
        return None
    remedy = change_accuracy(scene, solver="lattice")
    with suppress(InputError):
        return remedy if scene.replaced(remedy.changes).immerses else None
    return None


def _choose_sounder_law(scene: Scene) -> Remedy | None:
    material = scene.material
    if material.sounder_law is None or scene.properties is not None:
        return None
    parameters = material.model_dump(exclude={"law"})
    law = material.sounder_law
    return Remedy(f"material.law = {law}", {"material": {"law": law, **parameters}})


def _shorten_substep(scene: Scene) -> Remedy | None:
    """Divide the substep by four, because half the substep has failed. On lattices, there is no
    remedy, because a quarter of the substep did not help in three random scenes. Steps of projected
    liquids do not depend on `cfl`.
    """
    if scene.on_lattice or (scene.projects and not scene.has_solids):
        return None
    return change_accuracy(scene, cfl=scene.resolution.cfl / 4)


def _use_double(scene: Scene) -> Remedy | None:
    single = scene.precision == "float32"
    return change_accuracy(scene, precision="float64") if single else None


def _coarsen_grid(scene: Scene) -> Remedy | None:
    cells = max(4, scene.resolution.cells // 2)
    return change_accuracy(scene, cells=cells) if cells < scene.resolution.cells else None


def _soften(scene: Scene) -> Remedy | None:
    E = getattr(scene.material, "E", None)
    varies = scene.parts or scene.properties is not None
    return None if E is None or varies else change_field("material.E", max(1.0, E / SOFTER))


def find_speedups(scene: Scene, limiter: str, done: float) -> tuple[Remedy, ...]:
    """Return remedies for a run that has taken twice its time budget.

    `limiter` is a key of `SLOW`, and `done` the fraction of the clip that is simulated. The
    proposed budget assumes that the time is proportional to the square of the clip's duration, as
    in an accelerated motion.
    """
    needed = min(1e8, 4 * scene.time.budget / max(done, 1e-2) ** 2)
    budget = change_field("time.budget", float(f"{needed:.2g}"))
    return (*find_remedies((*SLOW[limiter], "cells"), scene), budget)


SLOW = {
    "elastic": ("softer",),
    "speed": ("push",),
    "gradient": ("push",),
    "viscous": ("friction",),
    "user": ("ceiling",),
    "retry": ("push",),
    "wave": (),
}
"""For each limit of the substep: keys of the `REMEDIES` that lengthen the substep."""


def _reduce_viscosity(scene: Scene) -> Remedy | None:
    if scene.properties is not None:
        return None
    for name in ("damping", "viscosity"):
        if getattr(scene.material, name, 0) > 0:
            return change_field(f"material.{name}", getattr(scene.material, name) / 4)
    return None


def _raise_ceiling(scene: Scene) -> Remedy | None:
    longest = scene.time.substep
    return None if longest is None else change_field("time.substep", 4 * longest)


REMEDIES: dict[str, Callable[[Scene], Remedy | None]] = {
    "law": _choose_sounder_law,
    "solver": _change_solver,
    "substep": _shorten_substep,
    "precision": _use_double,
    "push": _halve_push,
    "cells": _coarsen_grid,
    "softer": _soften,
    "friction": _reduce_viscosity,
    "ceiling": _raise_ceiling,
}
"""For each cause of a stop: a function that returns the remedy for a scene, or None."""


def _format(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
