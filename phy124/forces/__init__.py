"""Forces of a scene, which act on some particles or on the whole body.

Each force is a section of the scene file. `attach` adds a force to a run: its strength over time (a
track) and, if it acts on chosen particles only, one stage of the substep.
"""

from typing import Annotated

from pydantic import Field, SerializeAsAny

from phy124.forces.base import Force
from phy124.forces.body import Acceleration, Gravity, Impulse, TotalForce
from phy124.forces.held import Grab, WrenchForce
from phy124.forces.particle import Attraction, ParticleForce, SetVelocity, Wind, ZoneForce
from phy124.schema.plugins import Kinds

Kind = (
    Gravity
    | Acceleration
    | TotalForce
    | Impulse
    | ParticleForce
    | ZoneForce
    | Wind
    | Attraction
    | SetVelocity
    | Grab
    | WrenchForce
)
"""The list of all forces in phy124, from which all other lists of forces are derived."""
FORCES = Kinds(Force, "kind", "forces", Kind)
"""`FORCES.by_name` maps the name of a force to its class."""
AnyForce = SerializeAsAny[Annotated[Kind, Field(discriminator="kind"), FORCES]]
"""A force whose class is one of the `FORCES` or a registered class (phy124/schema/plugins.py)."""

__all__ = [
    "FORCES",
    "Acceleration",
    "AnyForce",
    "Attraction",
    "Force",
    "Grab",
    "Gravity",
    "Impulse",
    "ParticleForce",
    "SetVelocity",
    "TotalForce",
    "Wind",
    "WrenchForce",
    "ZoneForce",
]
