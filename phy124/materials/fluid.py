"""Weakly compressible fluids."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from phy124.kernels import fluid
from phy124.kernels.transfer import Law
from phy124.materials.base import Material, viscous_substep


class Fluid(Material):
    """Weakly compressible fluid: Tait pressure and Newtonian viscosity.

    Real water is 2e9 Pa; a thousandth of a per cent or a few per cent of squeeze look the same,
    so `bulk_modulus` is chosen for the scene: rho g h / K is the squeeze at depth h.
    """

    law: Literal["fluid"] = "fluid"
    device_law: ClassVar[Law] = Law(
        name="fluid",
        stress=fluid.tait,
        modulus=fluid.tait_modulus,
        project=fluid.isotropic,
        energy=fluid.tait_energy,
        width=3,
    )

    bulk_modulus: float = Field(
        default=2e5, ge=1, le=1e12, description="Stiffness against squeezing [Pa]."
    )
    gamma: float = Field(
        default=7.0, ge=1.05, le=10, description="Exponent of the Tait pressure; water 7."
    )
    viscosity: float = Field(
        default=0.0, ge=0, le=1e5, description="Dynamic viscosity [Pa s]: water 1e-3, honey 5."
    )

    def theta(self) -> tuple[float, ...]:
        """(K, gamma, eta)."""
        return self.bulk_modulus, self.gamma, self.viscosity

    def wave_speed(self) -> float:
        """sqrt(3 K / rho) [m/s]."""
        return math.sqrt(3 * self.bulk_modulus / self.density)

    def viscous_limit(self, dx: float) -> float:
        """Longest substep that friction allows [s]."""
        return viscous_substep(self.density, self.viscosity, dx)
