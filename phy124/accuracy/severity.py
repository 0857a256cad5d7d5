"""Computes the severity of a scene: properties that determine how large the errors of its motion
are.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from phy124.boundaries import Press
from phy124.forces.held import Grab
from phy124.materials import AnyMaterial
from phy124.materials.base import Elastic
from phy124.scene import Scene

COMPARED = {"law", "density", "E", "bulk_modulus", "nu", "damping", "viscosity", "yield_stress"}
"""Fields of a material that may have any value, since `severity`, `yielding`, `damping` or
`poisson` account for it."""
MEASURED = {"repose_angle": (30.0, 36.0), "extension": (0.003, 0.0075)}
"""Other fields of a material -> range of values with the same errors as the default value."""
LOOKS = {"tint", "visibility"}
"""Fields of a material that do not affect the motion."""
FILLED = 0.4
"""Typical value of volume / (size^3 * relative thickness) of an object."""
USUAL_THICKNESS = 0.2
"""Relative thickness of an object whose thickness is unknown."""


def violence(scene: Scene, thickness: float | None = None) -> float:
    """Return the severity of a scene, its energy relative to the stiffness: 2 e / c^2 + s^2.

    2 e is twice the energy per mass (see `energy`). c is the speed of waves in a bar of the
    object's softest material. s is the deformation by walls and hands, relative to the object's
    size.

    Args:
        scene: The scene.
        thickness: Local thickness of the object relative to its size; None: unknown.
    """
    slowest = min(bar_speed(section) for section in scene.materials)
    return energy(scene, thickness) / max(slowest, 1e-9) ** 2 + _strain(scene) ** 2


def yielding(scene: Scene, thickness: float | None = None) -> float:
    """Return the ratio of energy to yield stress, 2 e rho / sigma; 0 if no material yields.

    2 e is twice the energy per mass (see `energy`). The largest ratio of all materials is returned.
    """
    supplied = energy(scene, thickness)
    yields = [getattr(section, "yield_stress", math.inf) for section in scene.materials]
    pairs = zip(scene.materials, yields, strict=True)
    return supplied * max(section.density / max(stress, 1e-9) for section, stress in pairs)


def damping(scene: Scene) -> float:
    """Return the smallest relative damping, eta / (rho c L), of all materials.

    eta is the damping or the viscosity, c the speed of waves in a bar, and L the object's size.
    """
    return min(
        getattr(section, "damping", getattr(section, "viscosity", 0.0))
        / (section.density * max(bar_speed(section), 1e-9) * scene.object.size)
        for section in scene.materials
    )


def poisson(scene: Scene) -> float:
    """Return the largest Poisson's ratio of all materials; 0 for a material without one."""
    return max(getattr(section, "nu", 0.0) for section in scene.materials)


def energy(scene: Scene, thickness: float | None = None) -> float:
    """Return twice the energy per mass that a scene may convert to strain [m^2/s^2].

    It is v^2 + p^2 + 2 a h + sum(min(a L, a^2 t^2)): v is the initial speed (with spin) and the
    speed that impacts give, p the speed of walls and hands, a the acceleration by forces, t the
    time for which a force acts, h the object's lift, and L the object's size.
    """
    bodies, size, end = (scene.object, *scene.objects), scene.object.size, duration(scene)
    mass = _mass(scene, thickness)
    lift = max(getattr(body, "lift", 0.0) for body in bodies)
    speed = max(_speed(body, size) for body in bodies)
    squares, walls = 0.0, sum(_wall_speed(wall, size, end) for wall in scene.boundaries)
    for force in scene.acting:
        if isinstance(force, Grab):
            walls += force.target().fastest(0.0, end)
            continue
        peak = force.track((1.0, 0.0, 0.0)).largest(0.0, end)
        kick, pull = _effect(force, mass, scene)
        lasts = max(0.0, (end if force.end is None else min(force.end, end)) - force.start)
        speed += peak * kick
        squares += min(peak * pull * size, (peak * pull * lasts) ** 2) + 2 * peak * pull * lift
    return speed**2 + walls**2 + squares


def _speed(body: Any, size: float) -> float:
    """Return the initial speed of an object, with its spin [m/s]."""
    spin = math.hypot(*getattr(body, "spin", (0.0,))) * size / 2
    return math.hypot(*getattr(body, "velocity", (0.0,))) + spin


def _effect(force: Any, mass: float, scene: Scene) -> tuple[float, float]:
    """Return the speed [m/s] and the acceleration [m/s^2] that a force gives at full strength."""
    size = scene.object.size
    match force.kind:
        case "impulse":
            return math.hypot(*force.p) / mass, 0.0
        case "set_velocity":
            return _speed(force, size) + math.hypot(*force.v), 0.0
        case "force":
            return 0.0, math.hypot(*force.f) / mass
        case "particle_force":
            spacing = size / scene.resolution.cells / scene.particles_per_axis
            densest = max(section.density for section in scene.materials)
            return 0.0, math.hypot(*force.f) / (densest * spacing**3)
        case "wrench":
            return 0.0, (math.hypot(*force.force) + math.hypot(*force.torque) / size) / mass
        case "wind":
            return 0.0, force.rate * math.hypot(*force.v)
    value = next((getattr(force, name) for name in ("g", "a") if hasattr(force, name)), 0.0)
    return 0.0, math.hypot(*value) if isinstance(value, tuple) else abs(value)


def _mass(scene: Scene, thickness: float | None) -> float:
    """Estimate the mass of the object roughly [kg], from its size and thickness."""
    part = FILLED * (thickness or USUAL_THICKNESS)
    return min(section.density for section in scene.materials) * part * scene.object.size**3


def bar_speed(section: AnyMaterial) -> float:
    """Return the speed of waves along a bar [m/s], sqrt(E / rho) for elastic materials.

    It remains finite as Poisson's ratio approaches 0.5, unlike the speed of pressure waves.
    """
    if isinstance(section, Elastic):
        return math.sqrt(section.E / section.density)
    return section.wave_speed()


def find_difference(scene: Scene) -> str:
    """Describe a value of the materials that does not occur in any measured scene; empty if there
    is none.
    """
    for section in scene.materials:
        for name, field in type(section).model_fields.items():
            usual, value = field.get_default(call_default_factory=True), getattr(section, name)
            if name in COMPARED | LOOKS or value == usual:
                continue
            if name not in MEASURED or not MEASURED[name][0] <= value <= MEASURED[name][1]:
                return f"{section.law} with another {name}"
    return ""


def _wall_speed(wall: Any, size: float, end: float) -> float:
    """Return the largest speed of a wall [m/s]; a press moves as a cosine in time."""
    if isinstance(wall, Press):
        return math.pi / 2 * wall.depth * size / min(wall.down, wall.up)
    motion = getattr(wall, "motion", None)
    return 0.0 if motion is None else motion.track().fastest(0.0, end)


def _strain(scene: Scene) -> float:
    """Return the largest deformation of the object by a press or a hand, as a fraction of its
    size.
    """
    presses = [wall.depth for wall in scene.boundaries if isinstance(wall, Press)]
    held = any(wall.holds for wall in scene.boundaries)
    hands = [force.target() for force in scene.acting if isinstance(force, Grab) and held]
    drawn = [math.dist(value, hand.keys[0][1]) for hand in hands for _, value in hand.keys]
    return max([*presses, *(distance / scene.object.size for distance in drawn)], default=0.0)


Motion = Literal["squeezed", "landing", "standing", "held", "free"]


def motion_of(scene: Scene) -> Motion:
    """Return the kind of motion of a scene, from its walls and the object's initial state."""
    walls = [b for b in scene.boundaries if not b.holds]
    if any(wall.moves for wall in walls):
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
