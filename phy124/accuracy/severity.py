"""How hard a scene is on its material, in numbers that can be compared with scenes measured before.

A scene errs more the more its material strains, yields and rings. What no number here tells apart
from the scenes that were measured (`unlike`) is named instead.
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
"""Fields of a law that the numbers here compare; the others are as in the scenes measured."""


def violence(scene: Scene) -> float:
    """Energy of a scene relative to the stiffness that absorbs it: (v^2 + |a| L) / c^2 + e^2.

    v is the largest speed at which it starts, lands or is pressed, a the acceleration by forces, L
    its size, c the speed of waves in a bar of its softest material, and e the part of its height
    by which it is pressed.
    """
    slowest = min(bar_speed(section) for section in scene.materials)
    return energy(scene) / max(slowest, 1e-9) ** 2 + _squeeze(scene) ** 2


def yielding(scene: Scene) -> float:
    """The same energy relative to the least yield stress, rho (v^2 + |a| L) / sigma; 0: none."""
    yields = [getattr(section, "yield_stress", math.inf) for section in scene.materials]
    pairs = zip(scene.materials, yields, strict=True)
    return energy(scene) * max(section.density / max(stress, 1e-9) for section, stress in pairs)


def damping(scene: Scene) -> float:
    """What friction inside takes of a vibration, eta / (rho c L), in the least damped material."""
    return min(
        getattr(section, "damping", 0.0)
        / (section.density * max(bar_speed(section), 1e-9) * scene.object.size)
        for section in scene.materials
    )


def poisson(scene: Scene) -> float:
    """The largest Poisson's ratio; 0 of what has none."""
    return max(getattr(section, "nu", 0.0) for section in scene.materials)


def energy(scene: Scene) -> float:
    """Twice the energy per mass that a scene may put into strain [m^2/s^2]."""
    body = scene.object
    pull = sum(math.hypot(*_vector(force)) for force in scene.forces)
    speed = math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
    plates = sum(_plate_speed(wall, body.size) for wall in scene.boundaries)
    return speed**2 + 2 * pull * body.lift + pull * body.size + plates**2


def bar_speed(section: AnyMaterial) -> float:
    """Speed of waves along a bar [m/s], which resists whatever Poisson's ratio is, sqrt(E / rho).

    That of pressure waves has no bound as Poisson's ratio nears 0.5, and the body stays as soft.
    """
    if isinstance(section, Elastic):
        return math.sqrt(section.E / section.density)
    return section.wave_speed()


def unlike(scene: Scene) -> str:
    """What a scene has that no scene measured had; empty: nothing."""
    for force in scene.acting:
        if force.kind not in MEASURED_FORCES:
            return f"what a force of the kind {force.kind} acts on"
        if force.region is not None:
            return f"what {force.kind} acts on in a region only"
        if force.profile.kind != "constant":
            return f"a force that follows a {force.profile.kind}"
    for wall in scene.boundaries:
        if wall.moves and not isinstance(wall, Press):
            return f"a {wall.kind} that moves"
    for section in scene.materials:
        for name, field in type(section).model_fields.items():
            usual = field.get_default(call_default_factory=True)
            if name not in COMPARED and getattr(section, name) != usual:
                return f"{section.law} of another {name}"
    return ""


def _plate_speed(wall: Any, size: float) -> float:
    """Largest speed of a press on an object of some size [m/s]: it moves like a cosine."""
    if not isinstance(wall, Press):
        return 0.0
    return math.pi / 2 * wall.depth * size / min(wall.down, wall.up)


def _squeeze(scene: Scene) -> float:
    """The part of its height by which an object is pressed."""
    return max((wall.depth for wall in scene.boundaries if isinstance(wall, Press)), default=0.0)


def _vector(force: Any) -> tuple[float, ...]:
    """The acceleration of a force [m/s^2], if it is one; otherwise empty."""
    value = next((getattr(force, name) for name in ("g", "a") if hasattr(force, name)), 0.0)
    return tuple(value) if isinstance(value, tuple) else (float(value),)
