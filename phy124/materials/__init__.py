"""Constitutive laws a scene can name, each with its own parameters in SI units and their bounds.

A material is its own section of the scene file; its device functions are in phy124/kernels, its
formulae with their sources in docs/reference/physics.md.
"""

from typing import Annotated

from pydantic import Field

from phy124.materials.base import Elastic, Material
from phy124.materials.elastic import FixedCorotated, Hencky, NeoHookean, Rigid
from phy124.materials.fluid import Fluid
from phy124.materials.granular import Sand, Snow
from phy124.materials.plastic import Foam, Metal, Plasticine

AnyMaterial = Annotated[
    NeoHookean | FixedCorotated | Hencky | Rigid | Metal | Plasticine | Foam | Sand | Snow | Fluid,
    Field(discriminator="law"),
]

__all__ = [
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
