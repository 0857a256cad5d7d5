"""Severity of a scene: properties that determine how large the errors of its motion are."""

from __future__ import annotations

import math
from typing import Any, Literal

from phy124.boundaries import Press
from phy124.materials import AnyMaterial
from phy124.materials.base import Elastic
from phy124.scene import Scene

MEASURED_FORCES = ("gravity", "acceleration")
"""Kinds of forces in the measured scenes; the forces are constant and act on the whole object."""
COMPARED = {"law", "density", "E", "bulk_modulus", "nu", "damping", "yield_stress"}
"""Fields of a material that may differ from their defaults; these fields affect the severity,
`yielding`, `damping` or `poisson`."""
LOOKS = {"tint", "visibility"}
"""Fields of a material that do not affect the motion."""


def violence(scene: Scene) -> float:
    """Return the severity of a scene, its energy relative to the stiffness: 2 e / c^2 + s^2.

    2 e is twice the energy per mass (see `energy`). c is the speed of waves in a bar of the
    object's softest material. s is the fraction of its height by which the object is pressed.
    """
    slowest = min(bar_speed(section) for section in scene.materials)
    return energy(scene) / max(slowest, 1e-9) ** 2 + _squeeze(scene) ** 2


def yielding(scene: Scene) -> float:
    """Return the energy relative to the yield stress, 2 e rho / sigma; 0 if no material yields.

    2 e is twice the energy per mass (see `energy`). The largest ratio of all materials is returned.
    """
    yields = [getattr(section, "yield_stress", math.inf) for section in scene.materials]
    pairs = zip(scene.materials, yields, strict=True)
    return energy(scene) * max(section.density / max(stress, 1e-9) for section, stress in pairs)


def damping(scene: Scene) -> float:
    """Return the smallest relative damping, eta / (rho c L), of all materials.

    c is the speed of waves in a bar, and L the object's size.
    """
    return min(
        getattr(section, "damping", 0.0)
        / (section.density * max(bar_speed(section), 1e-9) * scene.object.size)
        for section in scene.materials
    )


def poisson(scene: Scene) -> float:
    """Return the largest Poisson's ratio of all materials; 0 for a material without one."""
    return max(getattr(section, "nu", 0.0) for section in scene.materials)


def energy(scene: Scene) -> float:
    """Return twice the energy per mass that a scene may convert to strain [m^2/s^2].

    It is v^2 + 2 a h + a L + p^2: v is the initial speed (with spin), a the acceleration by forces,
    h the object's lift, L the object's size, and p the speed of presses.
    """
    body = scene.object
    pull = sum(math.hypot(*_vector(force)) for force in scene.forces)
    speed = math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
    plates = sum(_plate_speed(wall, body.size) for wall in scene.boundaries)
    return speed**2 + 2 * pull * body.lift + pull * body.size + plates**2


def bar_speed(section: AnyMaterial) -> float:
    """Return the speed of waves along a bar [m/s], sqrt(E / rho) for elastic materials.

    It remains finite as Poisson's ratio approaches 0.5, unlike the speed of pressure waves.
    """
    if isinstance(section, Elastic):
        return math.sqrt(section.E / section.density)
    return section.wave_speed()


def find_difference(scene: Scene) -> str:
    """Describe a feature of the forces, walls or materials that no measured scene has.

    The result is empty if there is no such feature.
    """
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
            if name not in COMPARED | LOOKS and getattr(section, name) != usual:
                return f"{section.law} with another {name}"
    return ""


def _plate_speed(wall: Any, size: float) -> float:
    """Return the largest speed of a press on an object of this size [m/s]; 0 for other walls.

    The position of the press follows a cosine in time.
    """
    if not isinstance(wall, Press):
        return 0.0
    return math.pi / 2 * wall.depth * size / min(wall.down, wall.up)


def _squeeze(scene: Scene) -> float:
    """Return the largest distance by which a press compresses the object, in object heights."""
    return max((wall.depth for wall in scene.boundaries if isinstance(wall, Press)), default=0.0)


def _vector(force: Any) -> tuple[float, ...]:
    """Return the acceleration by a force [m/s^2]; zero for a force without one."""
    value = next((getattr(force, name) for name in ("g", "a") if hasattr(force, name)), 0.0)
    return tuple(value) if isinstance(value, tuple) else (float(value),)


Motion = Literal["squeezed", "landing", "standing", "held", "free"]


def motion_of(scene: Scene) -> Motion:
    """Return the kind of motion of a scene, from its walls and the object's initial state."""
    walls = [b for b in scene.boundaries if not b.holds]
    if any(b.moves for b in scene.boundaries):
        return "squeezed"
    if len(walls) < len(scene.boundaries):
        return "held"
    if not walls:
        return "free"
    moves = scene.object.lift > 0 or any(scene.object.velocity)
    return "landing" if moves else "standing"


def length(scene: Scene) -> float:
    """Return the duration of a scene in units of sqrt(size / 9.81 m/s^2)."""
    return duration(scene) / unit(scene)


def duration(scene: Scene) -> float:
    """Return the time of a scene's last frame [s]."""
    return (scene.time.frames - 1) / scene.time.fps


def unit(scene: Scene) -> float:
    """Return the unit of a scene's duration [s]."""
    return math.sqrt(scene.object.size / 9.81)
