"""Decides in which scenes elastic objects are simulated on lattices.

`scene` is a `Scene`, which imports this module.
"""

import math
from collections.abc import Sequence
from typing import Any

from phy124.lattice.refusals import is_elastic, reason_for_particles
from phy124.scene.energies import driven, energy

HARDEST = 2.0
"""Largest Mach number of an impact for which `auto` chooses lattices. If a duck hits the ground at
Mach 2, 3 and 4, a lattice needs 5, 9 and more than 13 times as many substeps as MPM.
"""

LIGHTEST = 0.03
"""Smallest density of undamped bodies for which `auto` chooses lattices, relative to the densest
liquid. At a relative density of 0.01, a cube with E = 1 kPa gains energy. At 0.03, or with E = 10
kPa, the cube gains no energy.
"""

FARTHEST_DRIVEN = 0.5
"""Largest prescribed displacement of a held object for which `auto` chooses lattices, relative to
the object's size. Example: the foot of a ball is held, and the ball's upper third is driven into
the foot, by half the ball's size. The run on a lattice then stops early, and the run with MPM does
not.
"""


def find_elastic(scene: Any) -> list[bool]:
    """Return whether each object moves and is elastic everywhere."""
    return [bool(each) and all(map(is_elastic, each)) for each in scene.object_materials]


def reason_for_mpm(scene: Any, device: str = "cpu") -> str:
    """Return the reason why a scene does not use lattices on a device, or an empty text.

    If `accuracy.solver = "auto"`, elastic objects use lattices where lattices were better in
    measurements (docs/lab/solvers.md). On a GPU, a lattice that touches walls takes many times as
    long as particles (docs/lab/cuda.md).
    """
    accuracy = scene.resolution
    if accuracy.solver != "auto":
        return "" if accuracy.solver == "lattice" else f"accuracy.solver is {accuracy.solver}"
    elastic = find_elastic(scene)
    immersed = scene.projects and any(elastic)
    for materials, springs in zip(scene.object_materials, elastic, strict=True):
        if materials and not springs and not immersed:
            return "lattices are for elastic materials"
    needed = _needs_lattice(scene)
    double = immersed and accuracy.precision == "auto"  # In a liquid, `auto` is float64.
    if (accuracy.precision == "float64" or double) and not needed:
        return f"accuracy.precision is {accuracy.precision}, and lattices are slower in float64"
    if scene.properties is not None and not needed:
        return "its materials are in a file"
    reason = reason_for_particles(scene)
    if reason or (device != "cpu" and not needed):
        return reason or "lattices are slower on a GPU"
    sections = [section for section in scene.materials if is_elastic(section)]
    if immersed and (light := _find_too_light(scene, sections)):
        return f"material {light} without damping is so light that it would gain energy in a liquid"
    slowest = min(section.sound_speed() for section in sections)
    mach = math.sqrt(energy(scene)) / slowest
    if mach > HARDEST:
        return f"an object may be hit or squeezed at {mach:.2g} times its speed of sound"
    if any(wall.holds for wall in scene.boundaries) and driven(scene) > FARTHEST_DRIVEN:
        return "prescribed velocities may squeeze the held object flat"
    return ""


def choose_solver(scene: Any, device: str) -> Any:
    """Return the scene with the solver that `auto` selects on a device."""
    if device == "cpu" or scene.resolution.solver != "auto":
        return scene
    return scene if _needs_lattice(scene) and scene.on_lattice else _with_solver(scene, "mpm")


def reason_for_others(scene: Any) -> str:
    """Return the reason why a scene is not simulated on lattices alone, or an empty text."""
    return reason_for_mpm(scene) or ("some objects yield or flow" if scene.couples else "")


def _find_too_light(scene: Any, sections: Sequence[Any]) -> str:
    """Return the law of the first undamped material that is too light for a lattice in a liquid."""
    densest = max(section.density for section in scene.materials if section.law == "fluid")
    light = (
        section.law
        for section in sections
        if section.density < LIGHTEST * densest and not getattr(section, "damping", 0)
    )
    return next(light, "")


def _needs_lattice(scene: Any) -> bool:
    moves = any(wall.moves for wall in scene.boundaries)
    several = (bool(scene.objects) or moves) and not scene.projects
    return bool(scene.checks.energy and (several or scene.stiffness_profile is not None))


def keep_lattice(scene: Any, before: Any) -> Any:
    """Return `scene` with the solver that the scene `before` uses for elastic objects."""
    if scene.solver == before.solver:
        return scene
    return _with_solver(scene, before.solver)


def _with_solver(scene: Any, solver: str) -> Any:
    accuracy = scene.resolution.model_copy(update={"solver": solver})
    return scene.model_copy(update={"accuracy": accuracy})
