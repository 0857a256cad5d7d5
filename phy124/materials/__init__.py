"""Constitutive laws of a scene; each law declares its parameters in SI units with bounds.

Each material is a section of the scene file. The device functions of the laws are in
phy124/kernels. docs/design/laws.md has the formulae with their sources.
"""

from typing import Annotated

from pydantic import Field, SerializeAsAny

from phy124.materials.base import Elastic, Material
from phy124.materials.elastic import FixedCorotated, Hencky, NeoHookean, Rigid
from phy124.materials.fluid import Fluid
from phy124.materials.granular import Sand, Snow
from phy124.materials.plastic import Foam, Metal, Plasticine
from phy124.schema.plugins import Kinds

Law = NeoHookean | FixedCorotated | Hencky | Rigid | Metal | Plasticine | Foam | Sand | Snow | Fluid
"""The list of all constitutive laws in phy124, from which all other lists of laws are derived."""
LAWS = Kinds(Material, "law", "materials", Law)
"""`LAWS.by_name` maps the name of a law to its class."""
AnyMaterial = SerializeAsAny[Annotated[Law, Field(discriminator="law"), LAWS]]
"""A material whose law is one of the `LAWS` or a registered law (phy124/schema/plugins.py)."""

__all__ = [
    "LAWS",
    "AnyMaterial",
    "Elastic",
    "FixedCorotated",
    "Fluid",
    "Foam",
    "Hencky",
    "Material",
    "Metal",
    "NeoHookean",
    "Plasticine",
    "Rigid",
    "Sand",
    "Snow",
]
