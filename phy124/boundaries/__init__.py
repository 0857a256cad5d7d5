"""Boundaries a scene can name: shapes that change the grid velocities they meet.

A boundary is its own section of the scene file. It becomes one stage of the substep (a container
becomes one per wall, a gripper two), launched over the nodes its shape can reach and no others.
"""

from typing import Annotated

from pydantic import Field, SerializeAsAny

from phy124.boundaries.base import REACH, Boundary, Contact
from phy124.boundaries.held import Foot, Held
from phy124.boundaries.motion import Path, Swing
from phy124.boundaries.planes import Container, Ground, HalfSpace, Press
from phy124.boundaries.solids import Box, Capsule, Gripper, Sphere
from phy124.schema.plugins import Kinds

Kind = Ground | HalfSpace | Press | Container | Box | Sphere | Capsule | Gripper | Held | Foot
"""The one list of phy124's boundaries, from which all others are derived."""
BOUNDARIES = Kinds(Boundary, "kind", "boundaries", Kind)
"""`BOUNDARIES.by_name` maps the name of a boundary to its class."""
AnyBoundary = SerializeAsAny[Annotated[Kind, Field(discriminator="kind"), BOUNDARIES]]
"""A boundary of one of the `BOUNDARIES`, or of a registered kind (phy124/schema/plugins.py)."""

__all__ = [
    "BOUNDARIES",
    "REACH",
    "AnyBoundary",
    "Boundary",
    "Box",
    "Capsule",
    "Contact",
    "Container",
    "Foot",
    "Gripper",
    "Ground",
    "HalfSpace",
    "Held",
    "Path",
    "Press",
    "Sphere",
    "Swing",
]
