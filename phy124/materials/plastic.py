"""Solids that flow above a yield stress, such as metal, plasticine and foam."""

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

    The default density and Poisson's ratio are those of aluminium; the default stiffness is lower.
    With the defaults, the metal yields at a strain of 1 %, which is less than a cell resolves. Real
    values (E 7e10, yield_stress 3e7) are allowed, but the number of substeps grows as sqrt(E). An
    impact at speed v leaves a dent if `density v^2` is of the order of the yield stress.
    """

    law: Literal["metal"] = "metal"
    shines: ClassVar[bool] = True
    dents: ClassVar[bool] = True
    particles_per_axis: ClassVar[float] = FEW
    device_law: ClassVar[Law] = Law(
        name="metal",
        stress=hencky.hencky,
        modulus=hencky.hencky_modulus,
        project=plastic.von_mises,
        energy=hencky.hencky_energy,
        width=5,
    )

    density: float = Field(default=2700.0, ge=1, le=1e5)
    """Mass per volume [kg/m^3]."""
    E: float = Field(default=2e7, ge=1, le=1e13)
    """Young's modulus [Pa]; for example aluminium 7e10, lead 1.6e10."""
    nu: float = Field(default=0.33, ge=0, le=0.4999)
    """Poisson's ratio."""
    yield_stress: float = Field(default=2e5, ge=1e-3, le=1e12)
    """Uniaxial yield stress [Pa]."""
    hardening: float = Field(default=0.0, ge=0, le=1e12)
    """Increase of the yield stress per unit of plastic strain [Pa]."""

    def theta(self) -> tuple[float, ...]:
        """Return the parameters of the device law: (mu, lambda, limit, slope, smallest limit)."""
        limit = NORM * self.yield_stress
        return *self.lame, limit, 2 / 3 * self.hardening, limit


class Plasticine(Elastic):
    """Clay: fixed corotated elasticity, von Mises yield, and softening with plastic strain.

    As in fixed corotated solids, an impact near the speed of sound may leave the material flat if
    the material does not yield.
    """

    law: Literal["plasticine"] = "plasticine"
    may_collapse: ClassVar[bool] = True
    dents: ClassVar[bool] = True
    device_law: ClassVar[Law] = Law(
        name="plasticine",
        stress=elastic.fixed_corotated,
        modulus=elastic.fixed_corotated_modulus,
        project=plastic.von_mises,
        energy=elastic.fixed_corotated_energy,
        width=5,
    )

    E: float = Field(default=2e5, ge=1, le=1e13)
    """Young's modulus [Pa]."""
    nu: float = Field(default=0.4, ge=0, le=0.4999)
    """Poisson's ratio."""
    yield_stress: float = Field(default=4e3, ge=1e-3, le=1e12)
    """Uniaxial yield stress [Pa]."""
    softening: float = Field(default=1e3, ge=0, le=1e12)
    """Decrease of the yield stress per unit of plastic strain [Pa]."""
    residual: float = Field(default=0.3, ge=0.01, le=1)
    """Smallest yield stress after softening, as a fraction of the initial yield stress."""

    @model_validator(mode="after")
    def _returns(self) -> Plasticine:
        mu = self.lame[0]
        if self.softening >= 3 * mu:
            raise ValueError(
                f"softening {self.softening:g} Pa must be below 3 mu = {3 * mu:g} Pa, or yielding "
                "has no unique result; lower the softening or raise E"
            )
        return self

    def theta(self) -> tuple[float, ...]:
        """Return the parameters of the device law: (mu, lambda, limit, slope, smallest limit)."""
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

    density: float = Field(default=100.0, ge=1, le=1e5)
    """Mass per volume [kg/m^3]."""
    E: float = Field(default=5e4, ge=1, le=1e13)
    """Young's modulus [Pa]."""
    yield_stress: float = Field(default=200.0, ge=0, le=1e12)
    """Uniaxial yield stress [Pa]; if it is 0, the foam always flows."""
    viscosity: float = Field(default=50.0, ge=1e-6, le=1e9)
    """Consistency of the flow [Pa s^n]. In shear at the rate r, the stress exceeds that of slow
    flow by 2^(-(1 + n)/2) viscosity r^n. For n = 1, this is the stress of a fluid of half the
    viscosity.
    """
    flow_index: float = Field(default=0.7, ge=0.2, le=1)
    """Flow index n: 1 for a Bingham fluid, less than 1 for shear thinning."""

    def theta(self) -> tuple[float, ...]:
        """Return the parameters of the device law: (mu, lambda, limit, viscosity, flow index)."""
        return *self.lame, NORM * self.yield_stress, self.viscosity, self.flow_index
