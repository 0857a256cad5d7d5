"""Limits of a hand: what it may do to an object, and what it does unless told otherwise.

A hand is as strong as holds the object twice, so it can lift and throw it but not blow it up; its
spring lets the object sag by a few hundredths of its size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phy124.errors import InputError
from phy124.particles import Particles
from phy124.scene import Scene
from phy124.schema.region import Vector

STANDARD_GRAVITY = 9.81
LIFTS = 3.0
"""How many times the object's weight a hand pulls with unless told otherwise, and ..."""
STRONGEST = 30.0
"""... at most."""
SWAY = 3.0
"""Frequency at which the object swings on a hand's spring [Hz], for an object of 1 m."""
FARTHEST = 5.0
"""How far from the middle of the scene a hand reaches [sizes of the object]."""
FASTEST = 5.0
"""How fast a hand moves a wall [sizes per second]."""
PUSHES = 16
"""Pushes that act at the same time."""


@dataclass(frozen=True)
class Limits:
    """Limits of one object."""

    mass: float
    """[kg]"""
    size: float
    """[m]"""

    @classmethod
    def of(cls, particles: Particles, scene: Scene) -> Limits:
        """Those of an object."""
        return cls(float(particles.mass.sum(dtype=np.float64)), scene.object.size)

    @property
    def weight(self) -> float:
        """In standard gravity [N]."""
        return self.mass * STANDARD_GRAVITY

    @property
    def stiffness(self) -> float:
        """Of a hand's spring [N/m]: the smaller an object, the faster it swings."""
        return self.mass * (2 * math.pi * SWAY) ** 2 / self.size

    @property
    def damping(self) -> float:
        """That lets the object swing on the spring without overshooting [N s/m]."""
        return 2 * math.sqrt(self.stiffness * self.mass)

    @property
    def radius(self) -> float:
        """Of what a hand holds [m]."""
        return 0.2 * self.size

    def force(self, field: str, value: Sequence[float]) -> tuple[Vector, str]:
        """A force [N] of at most the largest size, and a sentence if it had to be made smaller."""
        return bounded(field, value, STRONGEST * self.weight, "N")

    def torque(self, field: str, value: Sequence[float]) -> tuple[Vector, str]:
        """A torque [N m] of at most the largest size, and a sentence if it was larger."""
        return bounded(field, value, STRONGEST * self.weight * self.size, "N m")

    def place(self, field: str, value: Sequence[float]) -> tuple[Vector, str]:
        """A place [m] within reach, and a sentence if it was farther."""
        return bounded(field, value, FARTHEST * max(self.size, 1e-6), "m")


def vector(field: str, value: Sequence[float]) -> Vector:
    """Three finite numbers.

    Raises:
        InputError: They are not.
    """
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.full(1, np.nan)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise InputError(field, value, "it must be three finite numbers.", "Give [x, y, z].")
    x, y, z = found.tolist()
    return x, y, z


def number(field: str, value: float, least: float, most: float) -> float:
    """A finite number within bounds.

    Args:
        field: What it is called.
        value: What was given.
        least: The smallest that can be used.
        most: The largest.

    Raises:
        InputError: It is not.
    """
    limit = f"it must be a number from {least:g} to {most:g}."
    try:
        found = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(field, value, limit, "Give such a number.") from None
    if not least <= found <= most:
        raise InputError(field, value, limit, "Give such a number.")
    return found


def bounded(field: str, value: Sequence[float], most: float, unit: str) -> tuple[Vector, str]:
    """A vector no longer than a limit, and a sentence if it was.

    Args:
        field: What it is called.
        value: What was given.
        most: The largest length.
        unit: In which the sentence has it.

    Raises:
        InputError: It is not three finite numbers.
    """
    found = vector(field, value)
    length = math.hypot(*found)
    if length <= most:
        return found, ""
    # The largest component first: the square of a huge number is infinite.
    largest = max(map(abs, found))
    x, y, z = (component / largest for component in found)
    scale = most / math.hypot(x, y, z)
    said = f"{field} = {length:.3g} {unit} was made {most:.3g} {unit}, the most there is here."
    return (x * scale, y * scale, z * scale), said
