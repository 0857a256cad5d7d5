"""Numbers for the severity of a scene, which are compared with those of the measured scenes.

The error of a scene grows with the strain, yielding and vibration of its material. Features that
these numbers do not cover are named by `find_difference`.
"""

from __future__ import annotations

import math
from typing import Any

from phy124.boundaries import Press
from phy124.materials import AnyMaterial
from phy124.materials.base import Elastic
from phy124.scene import Scene

MEASURED_FORCES = ("gravity", "acceleration")
"""Kinds of forces in the scenes that were measured, on the whole object and constant."""
COMPARED = {"law", "density", "E", "bulk_modulus", "nu", "damping", "yield_stress"}
"""Fields of a law that these numbers cover; others must be as in the measured scenes."""


def violence(scene: Scene) -> float:
    """Return the energy relative to the stiffness that absorbs it: (v^2 + |a| L) / c^2 + e^2.

    v is the largest speed at which the object starts, lands or is pressed, a the acceleration by
    forces, L its size, c the speed of waves in a bar of its softest material, and e the fraction of
    its height by which it is pressed.
    """
    slowest = min(bar_speed(section) for section in scene.materials)
    return energy(scene) / max(slowest, 1e-9) ** 2 + _squeeze(scene) ** 2


def yielding(scene: Scene) -> float:
    """Return the energy relative to the smallest yield stress, rho (v^2 + |a| L) / sigma.

    It is 0 if no material yields.
    """
    yields = [getattr(section, "yield_stress", math.inf) for section in scene.materials]
    pairs = zip(scene.materials, yields, strict=True)
    return energy(scene) * max(section.density / max(stress, 1e-9) for section, stress in pairs)


def damping(scene: Scene) -> float:
    """Return the damping of vibrations, eta / (rho c L), of the least damped material."""
    return min(
        getattr(section, "damping", 0.0)
        / (section.density * max(bar_speed(section), 1e-9) * scene.object.size)
        for section in scene.materials
    )


def poisson(scene: Scene) -> float:
    """Return the largest Poisson's ratio; 0 for materials without one."""
    return max(getattr(section, "nu", 0.0) for section in scene.materials)


def energy(scene: Scene) -> float:
    """Return twice the energy per mass that a scene may convert to strain [m^2/s^2]."""
    body = scene.object
    pull = sum(math.hypot(*_vector(force)) for force in scene.forces)
    speed = math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
    plates = sum(_plate_speed(wall, body.size) for wall in scene.boundaries)
    return speed**2 + 2 * pull * body.lift + pull * body.size + plates**2


def bar_speed(section: AnyMaterial) -> float:
    """Return the speed of waves along a bar [m/s], sqrt(E / rho) for elastic materials.

    Unlike that of pressure waves it remains finite as Poisson's ratio approaches 0.5.
    """
    if isinstance(section, Elastic):
        return math.sqrt(section.E / section.density)
    return section.wave_speed()


def find_difference(scene: Scene) -> str:
    """Return a feature that no measured scene had; empty if there is none."""
    for force in scene.acting:
        if force.kind not in MEASURED_FORCES:
            return f"a force of the kind {force.kind}"
        if force.region is not None:
            return f"{force.kind} on a region"
        if force.profile.kind != "constant":
            return f"a force that follows a {force.profile.kind}"
    for wall in scene.boundaries:
        if wall.moves and not isinstance(wall, Press):
            return f"a {wall.kind} that moves"
    for section in scene.materials:
        for name, field in type(section).model_fields.items():
            usual = field.get_default(call_default_factory=True)
            if name not in COMPARED and getattr(section, name) != usual:
                return f"{section.law} with another {name}"
    return ""


def _plate_speed(wall: Any, size: float) -> float:
    """Return the largest speed of a press on an object of this size [m/s]; it moves as a cosine."""
    if not isinstance(wall, Press):
        return 0.0
    return math.pi / 2 * wall.depth * size / min(wall.down, wall.up)


def _squeeze(scene: Scene) -> float:
    """Return the fraction of its height by which an object is pressed."""
    return max((wall.depth for wall in scene.boundaries if isinstance(wall, Press)), default=0.0)


def _vector(force: Any) -> tuple[float, ...]:
    """Return the acceleration of a force [m/s^2]; zero for other forces."""
    value = next((getattr(force, name) for name in ("g", "a") if hasattr(force, name)), 0.0)
    return tuple(value) if isinstance(value, tuple) else (float(value),)
