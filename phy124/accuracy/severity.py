"""Properties of a scene that determine its error."""

import math
from typing import Literal

from phy124.boundaries import Press
from phy124.boundaries.base import Movable
from phy124.forces.held import Grab
from phy124.materials import AnyMaterial
from phy124.materials.base import Elastic
from phy124.scene import Scene
from phy124.scene.energies import duration, energy

COMPARED = {"law", "density", "E", "bulk_modulus", "nu", "damping", "viscosity", "yield_stress"}
"""Fields of a material that `violence`, `yielding`, `damping` or `poisson` uses."""
MEASURED = {"repose_angle": (30.0, 36.0), "hardening": (3.0, 10.0), "extension": (0.004, 0.0075)}
"""Further fields of a material, with ranges. If a value is in its range, the errors are the same as
with the default value.
"""
LOOKS = {"tint", "visibility"}


def violence(scene: Scene, thickness: float | None = None) -> float:
    """Return the severity of a scene, 2 e / c^2 + s^2.

    Here e is the energy per mass (`energy` returns 2 e), c the speed of waves in a bar of the
    softest material, and s the deformation by presses and grabs, relative to the object's size.
    `thickness` is the local thickness, relative to the size.
    """
    slowest = min(bar_speed(section) for section in scene.materials)
    return energy(scene, thickness) / max(slowest, 1e-9) ** 2 + _strain(scene) ** 2


def yielding(scene: Scene, thickness: float | None = None) -> float:
    """Return the largest ratio of energy to yield stress, 2 e rho / sigma; 0 if no material yields.

    Here e is the energy per mass (`energy` returns 2 e), rho the density, and sigma the yield
    stress.
    """
    supplied = energy(scene, thickness)
    yields = [getattr(section, "yield_stress", math.inf) for section in scene.materials]
    pairs = zip(scene.materials, yields, strict=True)
    return supplied * max(section.density / max(stress, 1e-9) for section, stress in pairs)


def damping(scene: Scene) -> float:
    """Return the smallest relative damping, eta / (rho c L), of all materials.

    Here eta is damping or viscosity, c the speed of waves in a bar, and L the object's size.
    """
    return min(
        getattr(section, "damping", getattr(section, "viscosity", 0.0))
        / (section.density * max(bar_speed(section), 1e-9) * scene.object.size)
        for section in scene.materials
    )


def poisson(scene: Scene) -> float:
    """Return the largest Poisson's ratio of all materials, or 0."""
    return max(getattr(section, "nu", 0.0) for section in scene.materials)


def bar_speed(section: AnyMaterial) -> float:
    """Return the speed of waves along a bar [m/s], sqrt(E / rho) for elastic materials.

    Unlike the speed of pressure waves, this speed remains finite as Poisson's ratio approaches 0.5.
    """
    if isinstance(section, Elastic):
        return math.sqrt(section.E / section.density)
    return section.wave_speed()


def find_difference(scene: Scene) -> str:
    """Describe a material parameter without measured errors, or return ""."""
    for section in scene.materials:
        for name, field in type(section).model_fields.items():
            usual, value = field.get_default(call_default_factory=True), getattr(section, name)
            if name in COMPARED | LOOKS or value == usual:
                continue
            if name not in MEASURED or not MEASURED[name][0] <= value <= MEASURED[name][1]:
                return f"{section.law} with another {name}"
    return ""


def _strain(scene: Scene) -> float:
    """Return the largest deformation by a press or a grab, relative to the object's size."""
    presses = [wall.depth for wall in scene.boundaries if isinstance(wall, Press)]
    held = any(wall.holds for wall in scene.boundaries)
    hands = [force.target() for force in scene.acting if isinstance(force, Grab) and held]
    drawn = [math.dist(value, hand.keys[0][1]) for hand in hands for _, value in hand.keys]
    return max([*presses, *(distance / scene.object.size for distance in drawn)], default=0.0)


Motion = Literal["squeezed", "landing", "standing", "held", "free"]


def motion_of(scene: Scene) -> Motion:
    """Return the kind of motion of a scene.

    A floor that moves exactly like the clamped foot of the object does not count as a press.
    """
    walls = [b for b in scene.boundaries if not b.holds]
    carried = [b.motion for b in scene.boundaries if b.holds and isinstance(b, Movable)]
    moving = [wall for wall in walls if wall.moves]
    if any(not isinstance(wall, Movable) or wall.motion not in carried for wall in moving):
        return "squeezed"
    if len(walls) < len(scene.boundaries):
        return "held"
    if not walls:
        return "free"
    moves = scene.object.lift > 0 or any(scene.object.velocity)
    return "landing" if moves else "standing"


def length(scene: Scene) -> float:
    """Return the duration in units of sqrt(size / 9.81 m/s^2)."""
    return duration(scene) / unit(scene)


def unit(scene: Scene) -> float:
    """Return sqrt(size / 9.81 m/s^2) of a scene's object [s]."""
    return math.sqrt(scene.object.size / 9.81)
