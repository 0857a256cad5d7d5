"""Estimates the energy that impacts, forces, walls and grabs may convert to strain in a scene.

`scene` is a `Scene`, which imports this module. Moving walls are included even if they never touch
an object. Forces are included in full even if nothing stops the accelerated object.
"""

import math
from typing import Any

from phy124.boundaries import Press
from phy124.forces.held import Grab

FILLED = 0.4
"""Typical volume / (size^3 * relative thickness) of an object."""
USUAL_THICKNESS = 0.2
"""Relative thickness of an object whose thickness is unknown."""


def energy(scene: Any, thickness: float | None = None) -> float:
    """Return twice the energy per mass that a scene may convert to strain [m^2/s^2].

    The result is `v^2 + p^2 + 2 a h + sum(min(a L, a^2 t^2))`. Here v is the initial speed (with
    spin) plus the speed gained in impacts, and p is the speed of walls and grabs. A force causes
    the acceleration `a` during the time `t`. The object starts at the height h above the ground and
    has the size L. Wind accelerates an object at most to the speed of the wind.
    """
    bodies, size, end = (scene.object, *scene.objects), scene.object.size, duration(scene)
    mass = _mass(scene, thickness)
    lift = max(getattr(body, "lift", 0.0) for body in bodies)
    speed = max(_speed(body, size) for body in bodies)
    squares, walls = (
        0.0,
        sum(wall_speed(wall, size, end) for wall in scene.with_solids().boundaries),
    )
    for force in scene.acting:
        if isinstance(force, Grab):
            walls += force.target().fastest(0.0, end)
            continue
        peak = force.track((1.0, 0.0, 0.0)).largest(0.0, end)
        kick, pull = effect(force, mass, scene)
        lasts = acts_for(force, end)
        speed += peak * kick
        top = peak * math.hypot(*force.v) if force.kind == "wind" else math.inf
        pull *= peak
        squares += min(min(pull * size, (pull * lasts) ** 2) + 2 * pull * lift, top**2)
    return speed**2 + walls**2 + squares


def driven(scene: Any) -> float:
    """Return an upper bound on the displacement that a prescribed velocity causes, relative to the
    object's size.
    """
    end = duration(scene)
    moved = [
        force.track((1.0, 0.0, 0.0)).largest(0.0, end) * math.hypot(*force.v) * acts_for(force, end)
        for force in scene.acting
        if force.kind == "set_velocity"
    ]
    return max(moved, default=0.0) / scene.object.size


def acts_for(force: Any, end: float) -> float:
    """Return the time for which a force acts before the scene ends [s]."""
    return max(0.0, (end if force.end is None else min(force.end, end)) - force.start)


def _speed(body: Any, size: float) -> float:
    spin = math.hypot(*getattr(body, "spin", (0.0,))) * size / 2
    return math.hypot(*getattr(body, "velocity", (0.0,))) + spin


def effect(force: Any, mass: float, scene: Any) -> tuple[float, float]:
    """Return the speed [m/s] and the acceleration [m/s^2] that a force causes at full strength."""
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


def _mass(scene: Any, thickness: float | None) -> float:
    """Estimate the mass of the object roughly [kg]."""
    part = FILLED * (thickness or USUAL_THICKNESS)
    return min(section.density for section in scene.materials) * part * scene.object.size**3


def wall_speed(wall: Any, size: float, end: float) -> float:
    """Return the largest speed of a wall [m/s].

    If a wall that holds points changes its velocity suddenly, the change counts as a speed, because
    the points then move at this speed relative to the wall.
    """
    if isinstance(wall, Press):
        return math.pi / 2 * wall.depth * size / min(wall.down, wall.up)
    fastest = 0.0
    for part in wall.parts():
        if motion := getattr(part, "motion", None):
            track = motion.track()
            jump = 0.0 if part.response() == "separate" else track.largest_jump(end)
            fastest = max(fastest, track.fastest(0.0, end), jump)
    return fastest


def duration(scene: Any) -> float:
    """Return the time of a scene's last frame [s]."""
    return (scene.time.frames - 1) / scene.time.fps
