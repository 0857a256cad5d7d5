"""Constitutive laws a scene can name, each with its own parameters in SI units and their bounds.

A material is its own section of the scene file; its device functions are in phy124/kernels, its
formulae with their sources in docs/physics.md.
"""

from typing import Annotated, Any, get_args

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


def forget_others(section: dict[str, Any]) -> None:
    """Leave in a material's section only what its law has; all if there is no such law."""
    union, _ = get_args(AnyMaterial)
    known = {kind.model_fields["law"].default: kind.model_fields for kind in get_args(union)}
    fields = known.get(str(section.get("law")), section)
    for key in [key for key in section if key not in fields]:
        del section[key]


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
    "forget_others",
]
