"""Solids that flow above a yield stress: metal, plasticine, foam."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from phy124.kernels import elastic, hencky, plastic
from phy124.kernels.transfer import Law
from phy124.materials.base import FEW, Elastic, Logarithmic

NORM = math.sqrt(2 / 3)
"""Ratio of the norm of the deviatoric stress to the uniaxial stress."""


class Metal(Logarithmic):
    """Von Mises metal in Hencky strain with linear isotropic hardening.

    The defaults are the density and Poisson's ratio of aluminium with a lower stiffness, with which
    the metal yields at a strain of 1 %, less than a cell resolves. Real values (E 7e10,
    yield_stress 3e7) are allowed, but the number of substeps grows as sqrt(E). An impact at speed v
    leaves a dent if density v^2 is of the order of the yield stress.
    """

    law: Literal["metal"] = "metal"
    shines: ClassVar[bool] = True
    particles_per_axis: ClassVar[float] = FEW
    device_law: ClassVar[Law] = Law(
        name="metal",
        stress=hencky.hencky,
        modulus=hencky.hencky_modulus,
        project=plastic.von_mises,
        energy=hencky.hencky_energy,
        width=5,
    )

    density: float = Field(default=2700.0, ge=1, le=1e5, description="Mass per volume [kg/m^3].")
    E: float = Field(
        default=2e7, ge=1, le=1e13, description="Young's modulus [Pa]: aluminium 7e10, lead 1.6e10."
    )
    nu: float = Field(default=0.33, ge=0, le=0.4999, description="Poisson's ratio.")
    yield_stress: float = Field(
        default=2e5, ge=1e-3, le=1e12, description="Uniaxial yield stress [Pa]."
    )
    hardening: float = Field(
        default=0.0,
        ge=0,
        le=1e12,
        description="Rise of the yield stress per unit of plastic strain [Pa].",
    )

    def theta(self) -> tuple[float, ...]:
        """Return (mu, lambda, limit, slope, smallest limit)."""
        limit = NORM * self.yield_stress
        return *self.lame, limit, 2 / 3 * self.hardening, limit


class Plasticine(Elastic):
    """Clay with fixed corotated elasticity, which yields by von Mises and softens with plastic
    strain.

    As with fixed corotated solids, impacts near the speed of sound may leave the material flat
    unless the material yields.
    """

    law: Literal["plasticine"] = "plasticine"
    may_collapse: ClassVar[bool] = True
    particles_per_axis: ClassVar[float] = FEW
    device_law: ClassVar[Law] = Law(
        name="plasticine",
        stress=elastic.fixed_corotated,
        modulus=elastic.fixed_corotated_modulus,
        project=plastic.von_mises,
        energy=elastic.fixed_corotated_energy,
        width=5,
    )

    E: float = Field(default=2e5, ge=1, le=1e13, description="Young's modulus [Pa].")
    nu: float = Field(default=0.4, ge=0, le=0.4999, description="Poisson's ratio.")
    yield_stress: float = Field(
        default=4e3, ge=1e-3, le=1e12, description="Uniaxial yield stress [Pa]."
    )
    softening: float = Field(
        default=1e3,
        ge=0,
        le=1e12,
        description="Loss of yield stress per unit of plastic strain [Pa].",
    )
    residual: float = Field(
        default=0.3, ge=0.01, le=1, description="Fraction of the yield stress that is never lost."
    )

    @model_validator(mode="after")
    def _returns(self) -> Plasticine:
        mu = self.lame[0]
        if self.softening >= 3 * mu:
            raise ValueError(
                f"softening {self.softening:g} Pa must be below 3 mu = {3 * mu:g} Pa, or yielding "
                "has no unique result; lower it or raise E"
            )
        return self

    def theta(self) -> tuple[float, ...]:
        """Return (mu, lambda, limit, slope, smallest limit)."""
        limit = NORM * self.yield_stress
        return *self.lame, limit, -2 / 3 * self.softening, self.residual * limit


class Foam(Logarithmic):
    """Herschel-Bulkley viscoplastic solid that flows above its yield stress: foam, toothpaste."""

    law: Literal["foam"] = "foam"
    max_stretch: ClassVar[float | None] = 2.0
    rounds: ClassVar[bool] = True
    grains: ClassVar[bool] = True
    particles_per_axis: ClassVar[float] = FEW
    device_law: ClassVar[Law] = Law(
        name="foam",
        stress=hencky.hencky,
        modulus=hencky.hencky_modulus,
        project=plastic.herschel_bulkley,
        energy=hencky.hencky_energy,
        width=5,
    )

    density: float = Field(default=100.0, ge=1, le=1e5, description="Mass per volume [kg/m^3].")
    E: float = Field(default=5e4, ge=1, le=1e13, description="Young's modulus [Pa].")
    yield_stress: float = Field(
        default=200.0,
        ge=0,
        le=1e12,
        description="Uniaxial yield stress [Pa]; with 0 the foam always flows.",
    )
    viscosity: float = Field(
        default=50.0, ge=1e-6, le=1e9, description="Consistency of the flow [Pa s^n]."
    )
    flow_index: float = Field(
        default=0.7, ge=0.2, le=1, description="Exponent n: 1 Bingham, below 1 shear thinning."
    )

    def theta(self) -> tuple[float, ...]:
        """Return (mu, lambda, limit, viscosity, flow index)."""
        return *self.lame, NORM * self.yield_stress, self.viscosity, self.flow_index
