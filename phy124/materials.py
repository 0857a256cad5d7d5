"""Constitutive laws a scene can name, each with its own parameters in SI units and their bounds.

A material is its own section of the scene file; its device functions are in phy124/kernels.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from phy124.kernels import elastic
from phy124.kernels.transfer import Law


class Material(BaseModel):
    """What all materials have: a density, an elastic stiffness, and a law on the device."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    device_law: ClassVar[Law]

    density: float = Field(default=1000.0, ge=1, le=1e5, description="Mass per volume [kg/m^3].")
    E: float = Field(
        default=1e5,
        ge=1,
        le=1e13,
        description="Young's modulus [Pa]: jelly 1e4, rubber 1e6, wood 1e10.",
    )
    nu: float = Field(
        default=0.3, ge=-0.9, le=0.4999, description="Poisson's ratio; 0.5 is incompressible."
    )

    @property
    def lame(self) -> tuple[float, float]:
        """Lame parameters mu, lambda [Pa]."""
        mu = self.E / (2 * (1 + self.nu))
        return mu, self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu))

    def theta(self) -> tuple[float, ...]:
        """Parameters handed to the device law."""
        return self.lame

    def history(self) -> tuple[float, float]:
        """Initial history variables of a particle."""
        return (0.0, 0.0)

    def wave_speed(self) -> float:
        """Speed that limits the substep at rest, sqrt((3 lambda + 2 mu) / rho) [m/s]."""
        mu, lam = self.lame
        return math.sqrt((3 * lam + 2 * mu) / self.density)


class NeoHookean(Material):
    """Compressible neo-Hookean solid with log J: the default, stays sound in hard impacts."""

    law: Literal["neo_hookean"] = "neo_hookean"
    device_law: ClassVar[Law] = Law(
        name="neo_hookean",
        stress=elastic.neo_hookean,
        modulus=elastic.neo_hookean_modulus,
        energy=elastic.neo_hookean_energy,
        width=2,
    )


class FixedCorotated(Material):
    """Fixed corotated solid (PhysGaussian's jelly); collapses silently in hard impacts."""

    law: Literal["fixed_corotated"] = "fixed_corotated"
    device_law: ClassVar[Law] = Law(
        name="fixed_corotated",
        stress=elastic.fixed_corotated,
        modulus=elastic.fixed_corotated_modulus,
        energy=elastic.fixed_corotated_energy,
        width=2,
    )


AnyMaterial = Annotated[NeoHookean | FixedCorotated, Field(discriminator="law")]
