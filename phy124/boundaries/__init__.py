"""Boundaries of a scene: shapes that change the velocities of grid nodes inside or near the shapes.

Each boundary is a section of the scene file. A boundary adds one stage to the substep; a container
adds one stage per wall, and a gripper adds two. The kernel of a stage runs only over the nodes that
the shape can reach.
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
"""The list of all boundaries in phy124, from which all other lists of boundaries are derived."""
BOUNDARIES = Kinds(Boundary, "kind", "boundaries", Kind)
"""`BOUNDARIES.by_name` maps the name of a boundary to its class."""
AnyBoundary = SerializeAsAny[Annotated[Kind, Field(discriminator="kind"), BOUNDARIES]]
"""A boundary of one of the `BOUNDARIES` or of a registered class (schema/plugins.py)."""

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
