"""Weakly compressible fluids."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

from pydantic import Field

from phy124.kernels import fluid
from phy124.kernels.transfer import Law
from phy124.materials.base import Material, viscous_substep

RINGING = 0.7
"""Share used of the bulk viscosity that needs no shorter substep."""


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
        width=4,
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
        """(K, gamma, eta, zeta)."""
        return self.bulk_modulus, self.gamma, self.viscosity, 0.0

    def theta_on(self, dx: float, cfl: float) -> tuple[float, ...]:
        """The same with a bulk viscosity zeta that takes ringing away.

        Of zeta = a rho c dx a substep of `cfl` allows (2 cfl)^2 <= 4 - 2 (12 zeta / rho dx^2) dt,
        the rule of `beside_elastic`; at J < 1 substeps are shorter than at rest.
        """
        most = (1 - cfl * cfl) / (2 * math.sqrt(3) * cfl)
        impedance = math.sqrt(self.bulk_modulus * self.density)
        return *self.theta()[:3], RINGING * most * impedance * dx

    def wave_speed(self) -> float:
        """sqrt(3 K / rho) [m/s]."""
        return math.sqrt(3 * self.bulk_modulus / self.density)

    def viscous_limit(self, dx: float) -> float:
        """Longest substep that friction allows [s]."""
        return viscous_substep(self.density, self.viscosity, dx)
