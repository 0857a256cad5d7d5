"""Remedies: what to change in a scene when its run stops or is refused, as fields and values.

Each is a change that helps by itself. `phy124 stress` tries out every one that is given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from phy124.errors import Remedy
from phy124.scene import Scene

SOFTER = 16.0
"""Factor by which E is lowered: the substep becomes four times as long."""


def remedies(causes: Sequence[str], scene: Scene) -> tuple[Remedy, ...]:
    """The changes that help against these causes in this scene; what does not apply is left out."""
    found = (KNOWN[cause](scene) for cause in causes)
    return tuple(remedy for remedy in found if remedy is not None)


def advice(found: Sequence[Remedy]) -> str:
    """The remedies as a sentence, or nothing."""
    words = [remedy.words for remedy in found]
    return f"Use {listed(words)}." if words else ""


def listed(words: Sequence[str]) -> str:
    """A, B or C."""
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def accuracy(scene: Scene, **values: Any) -> Remedy:
    """Other values in the table of the accuracy, which then has no name."""
    changed = scene.resolution.model_copy(update=values).model_dump()
    words = ", ".join(f"accuracy.{name} = {_said(value)}" for name, value in values.items())
    return Remedy(words, {"accuracy": changed})


def plain(field: str, value: Any) -> Remedy:
    """One field, one value."""
    return Remedy(f"{field} = {_said(value)}", {field: value})


def _gentler(scene: Scene) -> Remedy | None:
    """All speeds and forces halved, gravity included."""
    changes: dict[str, Any] = {}
    for name in ("velocity", "spin"):
        value = getattr(scene.object, name)
        if any(value):
            changes[f"object.{name}"] = _half(value)
    for index, force in enumerate(scene.forces):
        changes |= {f"forces.{index}.{name}": value for name, value in force.gentler().items()}
    for index, wall in enumerate(scene.boundaries):
        changes |= {f"boundaries.{index}.{name}": value for name, value in wall.gentler().items()}
    return Remedy("a gentler push (half the speeds and forces)", changes) if changes else None


def _half(value: Any) -> Any:
    return [x / 2 for x in value] if isinstance(value, tuple) else value / 2


def _neo_hookean(scene: Scene) -> Remedy | None:
    material = scene.material
    if material.sounder_law is None or scene.properties is not None:
        return None
    kept = material.model_dump(exclude={"law"})
    law = material.sounder_law
    return Remedy(f"material.law = {law}", {"material": {"law": law, **kept}})


def _shorter(scene: Scene) -> Remedy:
    """A quarter of the substep: a frame that failed has been tried with half of it."""
    return accuracy(scene, cfl=scene.resolution.cfl / 4)


def _double(scene: Scene) -> Remedy | None:
    single = scene.resolution.precision == "float32"
    return accuracy(scene, precision="float64") if single else None


def _coarser(scene: Scene) -> Remedy | None:
    cells = max(4, scene.resolution.cells // 2)
    return accuracy(scene, cells=cells) if cells < scene.resolution.cells else None


def _softer(scene: Scene) -> Remedy | None:
    E = getattr(scene.material, "E", None)
    varies = scene.parts or scene.properties is not None
    return None if E is None or varies else plain("material.E", max(1.0, E / SOFTER))


def hurry(scene: Scene, limiter: str, done: float) -> tuple[Remedy, ...]:
    """What helps a run that has taken twice its time budget.

    The remedies lengthen the substep or shorten the clip. Where the motion gets faster and faster,
    the time taken grows as the square of the clip's length.

    Args:
        scene: The scene.
        limiter: What limits the substep, a key of `SLOW`.
        done: Fraction of the scene's time that has been simulated.
    """
    needed = min(1e8, 4 * scene.time.budget / max(done, 1e-2) ** 2)
    patient = plain("time.budget", float(f"{needed:.2g}"))
    return (*remedies((*SLOW[limiter], "cells"), scene), patient)


SLOW = {
    "elastic": ("softer",),
    "speed": ("push",),
    "gradient": ("push",),
    "viscous": ("friction",),
    "user": ("ceiling",),
}
"""What limits the substep -> what makes it longer."""


def _thinner(scene: Scene) -> Remedy | None:
    if scene.properties is not None:
        return None
    for name in ("damping", "viscosity"):
        if getattr(scene.material, name, 0) > 0:
            return plain(f"material.{name}", getattr(scene.material, name) / 4)
    return None


def _ceiling(scene: Scene) -> Remedy | None:
    longest = scene.time.substep
    return None if longest is None else plain("time.substep", 4 * longest)


KNOWN: dict[str, Callable[[Scene], Remedy | None]] = {
    "law": _neo_hookean,
    "substep": _shorter,
    "precision": _double,
    "push": _gentler,
    "cells": _coarser,
    "softer": _softer,
    "friction": _thinner,
    "ceiling": _ceiling,
}
"""Cause -> the change that helps against it."""


def _said(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
