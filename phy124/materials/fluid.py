"""Weakly compressible fluids."""

import math
from typing import ClassVar, Literal

from pydantic import Field

from phy124.kernels import fluid
from phy124.kernels.transfer import Law
from phy124.materials.base import Material, viscous_substep

RINGING = 0.7
"""Bulk viscosity relative to the largest value that does not shorten the substep."""
SUDDEN = 0.3
"""Ratio K' / K: relative increase of the stiffness for changes faster than the relaxation time."""
RELAXATION = 10.0
"""Relaxation time relative to the time in which sound crosses a cell.

In a body that is some tens of cells deep, a sound wave takes about this time to travel down and up.
"""


class Fluid(Material):
    """Weakly compressible fluid: Tait pressure and Newtonian viscosity.

    Real water has a bulk modulus of 2e9 Pa. A much lower value, with a compression of a few per
    cent, gives the same visible motion. `bulk_modulus` (K) is therefore chosen for the scene; at
    the depth h, the compression is rho g h / K.
    """

    law: Literal["fluid"] = "fluid"
    max_stretch: ClassVar[float | None] = 1.5
    rounds: ClassVar[bool] = True
    disperses: ClassVar[bool] = True
    grains: ClassVar[bool] = True
    shading: ClassVar[float] = (
        0.0  # Otherwise, the picture's light and shade would flow with the liquid like a dye.
    )
    shines: ClassVar[bool] = True
    device_law: ClassVar[Law] = Law(
        name="fluid",
        stress=fluid.tait,
        modulus=fluid.tait_modulus,
        project=fluid.isotropic,
        energy=fluid.tait_energy,
        width=6,
    )

    bulk_modulus: float = Field(default=2e5, ge=1, le=1e12)
    """Stiffness against compression [Pa]."""
    gamma: float = Field(default=7.0, ge=1.05, le=10)
    """Exponent of the Tait pressure; for water 7."""
    viscosity: float = Field(default=0.0, ge=0, le=1e5)
    """Dynamic viscosity [Pa s]; for example water 1e-3, honey 5."""
    visibility: float | None = Field(default=None, ge=1e-6, le=1e6, examples=[0.1])
    """Distance in which the liquid attenuates light to 1/e [m], for rendering only. Default:
    opaque.
    """

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """Return the largest strain for which the stiffness grows by at most the factor `growth`.

        The stiffness varies as J^-(1 + gamma), and ln J is at most sqrt(3) times the strain.
        """
        return math.log(growth) / (math.sqrt(3) * (1 + self.gamma))

    def theta(self) -> tuple[float, ...]:
        """Return the law's parameters (K, gamma, eta, 0, 0, 0).

        The zeros are the bulk viscosity, K' and the relaxation.
        """
        return self.bulk_modulus, self.gamma, self.viscosity, 0.0, 0.0, 0.0

    def history(self) -> tuple[float, float]:
        """Return the initial history variables: the previous J, which is 1, and an unused 0."""
        return 1.0, 0.0

    @property
    def _sound(self) -> float:
        """Speed of sound sqrt(K / rho) [m/s]."""
        return math.sqrt(self.bulk_modulus / self.density)

    def theta_on(self, dx: float, cfl: float) -> tuple[float, ...]:
        """Return the law's parameters, with a bulk viscosity zeta and a relaxation that damp sound.

        The relaxation damps slow changes of volume, and zeta damps fast changes. The value of zeta
        is proportional to rho c dx. A substep of the fraction `cfl` is stable if (2 cfl)^2 <= 4 - 2
        (12 zeta / rho dx^2) dt, as in `beside_elastic`. In regions with J < 1, substeps are shorter
        than at rest.
        """
        most = (1 - cfl * cfl) / (2 * math.sqrt(3) * cfl)
        zeta = RINGING * most * math.sqrt(1 + SUDDEN) * self._sound * self.density * dx
        relaxation = SUDDEN * self.bulk_modulus, self._sound / (RELAXATION * dx)
        return *self.theta()[:3], zeta, *relaxation

    def wave_speed(self) -> float:
        """Return sqrt(3 (K + K') / rho) [m/s], which limits the substeps of the fluid."""
        return math.sqrt(3 * (1 + SUDDEN)) * self._sound

    def cheaper(self, field: str) -> str:
        """Return a remedy for slow runs: a smaller `bulk_modulus`."""
        return f"a smaller {field}.bulk_modulus"

    def viscous_limit(self, dx: float) -> float:
        """Return the longest stable substep [s] with viscosity on a grid of spacing `dx` [m]."""
        return viscous_substep(self.density, self.viscosity, dx)
