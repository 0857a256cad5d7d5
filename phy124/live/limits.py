"""Limits and defaults for inputs by a hand, with which a user pulls the object.

By default a hand pulls with three times the object's weight. This force can lift and throw the
object. On soft material, a hand pulls with less force, because material that is pulled faster than
sound would be squeezed flat.
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
"""Default strength of a hand on stiff material, as a multiple of the object's weight."""
STRAIN = 0.3
"""Largest strain of the held material under the default strength of a hand. At this strain, the
material reaches about a quarter of the speed of sound before the neighbouring material reacts.
"""
STRONGEST = 30.0
"""Largest strength of a hand, as a multiple of the object's weight."""
TWIST = 0.2
"""Ratio of the largest torque to the largest force [object sizes]. With this ratio, the largest
force and the largest torque give the rim of a ball the same acceleration.
"""
SWAY = 3.0
"""Natural frequency of an object of 1 m that hangs on a hand's spring [Hz]."""
FARTHEST = 5.0
"""Largest distance of a hand from the middle of the scene [object sizes]."""
FASTEST = 5.0
"""Largest speed at which a hand moves a wall [object sizes per second]."""
PUSHES = 32
"""Largest number of simultaneous pushes."""


@dataclass(frozen=True)
class Limits:
    """Limits of the inputs that act on an object with this mass and size."""

    mass: float
    """Mass of the object [kg]."""
    size: float
    """Size of the object [m]."""

    @classmethod
    def of(cls, particles: Particles, scene: Scene) -> Limits:
        """Compute the limits of an object from its particles."""
        return cls(float(particles.mass.sum(dtype=np.float64)), scene.object.size)

    @property
    def weight(self) -> float:
        """Weight in standard gravity [N]."""
        return self.mass * STANDARD_GRAVITY

    @property
    def stiffness(self) -> float:
        """Stiffness of a hand's spring [N/m]; smaller objects oscillate faster."""
        return self.mass * (2 * math.pi * SWAY) ** 2 / self.size

    @property
    def damping(self) -> float:
        """Critical damping coefficient of the spring [N s/m]."""
        return 2 * math.sqrt(self.stiffness * self.mass)

    @property
    def radius(self) -> float:
        """Radius of the material that a hand holds [m]."""
        return 0.2 * self.size

    def check_radius(self, field: str, value: float | None) -> float:
        """Return the radius [m] of the material on which an input acts; None: the default.

        Raises:
            InputError: The radius is not a number within the bounds.
        """
        radius = self.radius if value is None else value
        return check_number(field, radius, 0.01 * self.size, 2 * self.size)

    def strength(self, modulus: float, radius: float) -> float:
        """Return a hand's default strength [N] on material within `radius` [m].

        `modulus` is the modulus of pressure waves in the material [Pa].
        """
        return min(LIFTS * self.weight, STRAIN * modulus * math.pi * radius**2)

    def force(self, field: str, value: Sequence[float]) -> tuple[Vector, str]:
        """Return a force [N], reduced to the limit, and a sentence about the reduction."""
        return shorten(field, value, STRONGEST * self.weight, "N")

    def torque(self, field: str, value: Sequence[float]) -> tuple[Vector, str]:
        """Return a torque [N m], reduced to the limit, and a sentence about the reduction."""
        return shorten(field, value, STRONGEST * self.weight * TWIST * self.size, "N m")

    def place(self, field: str, value: Sequence[float]) -> tuple[Vector, str]:
        """Return a position [m], moved into a hand's reach, and a sentence about the move."""
        return shorten(field, value, FARTHEST * max(self.size, 1e-6), "m")


def check_vector(field: str, value: Sequence[float]) -> Vector:
    """Return a value as a vector of three finite numbers.

    Raises:
        InputError: The value is not three finite numbers.
    """
    try:
        components = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        components = np.full(1, np.nan)
    if components.shape != (3,) or not np.isfinite(components).all():
        raise InputError(field, value, "it must be three finite numbers.", "Enter [x, y, z].")
    x, y, z = components.tolist()
    return x, y, z


def check_number(field: str, value: float, least: float, most: float) -> float:
    """Return a value as a finite number within bounds.

    Args:
        field: Name of the value in error messages.
        value: The value to check.
        least: Smallest allowed number.
        most: Largest allowed number.

    Raises:
        InputError: The value is not a number within the bounds.
    """
    limit = f"it must be a number from {least:g} to {most:g}."
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(field, value, limit, "Choose a number in this range.") from None
    if not least <= result <= most:
        raise InputError(field, value, limit, "Choose a number in this range.")
    return result


def shorten(field: str, value: Sequence[float], most: float, unit: str) -> tuple[Vector, str]:
    """Limit the length of a vector; return the vector and a sentence about the reduction.

    The sentence is empty if the vector was not changed.

    Args:
        field: Name of the vector in the sentence.
        value: The vector.
        most: Largest length.
        unit: Unit in the sentence.

    Raises:
        InputError: The value is not three finite numbers.
    """
    vector = check_vector(field, value)
    length = math.hypot(*vector)
    if length <= most:
        return vector, ""
    # The vector is first divided by its largest component, because the square of a huge number
    # would overflow.
    largest = max(map(abs, vector))
    x, y, z = (component / largest for component in vector)
    scale = most / math.hypot(x, y, z)
    sentence = f"{field} = {length:.3g} {unit} was reduced to the limit of {most:.3g} {unit}."
    return (x * scale, y * scale, z * scale), sentence
