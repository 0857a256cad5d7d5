"""Granular materials: sand and snow."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.kernels import granular, hencky
from phy124.kernels.transfer import Law
from phy124.materials.base import FEW, Elastic, Logarithmic
from phy124.materials.lumps import lumps

ICE = 917.0
"""Density of ice [kg/m^3]."""
DENSE = 1 / 3
"""The user gets a note if at least this fraction of the snow is denser than ice. In the preset, the
fraction is about 0.2.
"""
PACKING = 2 / 3
"""Largest product xi c of snow's hardening xi and critical compression c.

Under isotropic compression to the stretch 1 - c, snow stores the energy psi = 3/2 (2 mu + 3 lambda)
c^2. Packing by a small strain d releases the energy 3 (2 mu + 3 lambda) c d, but the hardening
increases psi by the fraction 3 xi d. If xi c > 2/3, the increase is larger than the released
energy.
"""
GENTLE, STEEPER = 30.0, 0.3
"""Up to a repose angle of `GENTLE` [degrees], heaps come to rest at the angle at which sand flows.
For each degree above `GENTLE`, the repose angle exceeds the flow angle by another `STEEPER`
degrees, as measured (docs/lab/physics.md).
"""


class Sand(Logarithmic):
    """Drucker-Prager sand without cohesion (Klar et al. 2016)."""

    law: Literal["sand"] = "sand"
    max_stretch: ClassVar[float | None] = 1.0
    rounds: ClassVar[bool] = True
    disperses: ClassVar[bool] = True
    grains: ClassVar[bool] = True
    scatters: ClassVar[bool] = True
    shade: ClassVar[float] = 0.2
    rough: ClassVar[float] = 1.0
    particles_per_axis: ClassVar[float] = FEW
    device_law: ClassVar[Law] = Law(
        name="sand",
        stress=hencky.hencky,
        modulus=hencky.hencky_modulus,
        project=granular.drucker_prager,
        energy=hencky.hencky_energy,
        width=3,
    )

    density: float = Field(default=1600.0, ge=1, le=1e5)
    """Mass per volume [kg/m^3]."""
    E: float = Field(default=1e6, ge=1, le=1e13)
    """Young's modulus of the packed grains [Pa]."""
    nu: float = Field(default=0.2, ge=0, le=0.4999)
    """Poisson's ratio."""
    friction_angle: float = Field(default=35.0, ge=1, le=60)
    """Angle of internal friction in triaxial compression [degrees]. Conical heaps are up to 5
    degrees steeper than this angle. In plane strain, as in channels and on wide slopes, 30 degrees
    correspond to a Mohr-Coulomb angle of 44 degrees, and 35 degrees to 55 degrees. For slopes, set
    repose_angle instead.
    """
    repose_angle: float | None = Field(default=None, ge=1, le=60, examples=[34.0])
    """Slope angle of heaps [degrees]. Default: determined by friction_angle."""

    def theta(self) -> tuple[float, ...]:
        """Return the parameters of the device law: (mu, lambda, alpha).

        The slope of the yield cone is alpha. An infinitely long slope flows at constant volume if
        its shear stress is 3 alpha / sqrt(2) times the pressure. The angle beta of such a slope
        satisfies tan(beta) = 3 alpha / sqrt(2). A slope at rest stays stable up to the angle
        asin(tan(beta)). A steep heap therefore comes to rest at an angle larger than beta, so beta
        is chosen smaller than the repose angle.
        """
        if self.repose_angle is not None:
            flow = self.repose_angle - STEEPER * max(0.0, self.repose_angle - GENTLE)
            return *self.lame, math.sqrt(2) / 3 * math.tan(math.radians(flow))
        sine = math.sin(math.radians(self.friction_angle))
        return *self.lame, math.sqrt(2 / 3) * 2 * sine / (3 - sine)


class Snow(Elastic):
    """Snow, which hardens under compression and fractures under tension (Stomakhin et al. 2013)."""

    law: Literal["snow"] = "snow"
    max_stretch: ClassVar[float | None] = 1.1
    rounds: ClassVar[bool] = True
    disperses: ClassVar[bool] = True
    grains: ClassVar[bool] = True
    crumbles: ClassVar[bool] = True
    shade: ClassVar[float] = 0.04
    particles_per_axis: ClassVar[float] = FEW
    device_law: ClassVar[Law] = Law(
        name="snow",
        stress=granular.snow,
        modulus=granular.snow_modulus,
        project=granular.snow_return,
        energy=granular.snow_energy,
        width=5,
    )

    density: float = Field(default=400.0, ge=1, le=1e5)
    """Mass per volume [kg/m^3]."""
    E: float = Field(default=1.4e5, ge=1, le=1e13)
    """Young's modulus of fresh snow [Pa]."""
    nu: float = Field(default=0.2, ge=0, le=0.4999)
    """Poisson's ratio."""
    compression: float = Field(default=0.025, ge=1e-4, le=0.5)
    """Compression at which snow starts to pack."""
    extension: float = Field(default=0.0075, ge=1e-4, le=0.5)
    """Stretch at which snow starts to break. If this value is below nu x compression, pressed snow
    is pushed apart sideways.
    """
    hardening: float = Field(default=10.0, ge=0, le=20)
    """Rate at which packing increases the stiffness, up to a factor e^4."""
    unevenness: float = Field(default=0.0, ge=0, le=2)
    """Standard deviation of ln(extension) between lumps of a body, which breaks where it is weak.
    With 0, the strength is the same everywhere.
    """

    @model_validator(mode="after")
    def _dissipates(self) -> Snow:
        packing = self.hardening * self.compression
        if packing > PACKING:
            raise ValueError(
                f"hardening x compression = {packing:.3g} must be at most {PACKING:.3g}, otherwise "
                "packing creates energy; lower one of them"
            )
        return self

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """Return the largest strain for which the stiffness grows by at most the factor `growth`.

        Compaction by a strain e stiffens snow by the factor exp(hardening e).
        """
        elastic = super().calm_strain(growth, stiffness)
        return min(elastic, math.log(growth) / max(self.hardening, 1.0))

    def histories(self, x: NDArray, low: NDArray, high: NDArray) -> NDArray[np.float64]:
        """Return the initial history variables [P,2] of particles of a body.

        The variables are Jp - 1, which is zero, and the relative deviation of `extension`.

        Args:
            x: Positions of those particles that have this material [P,3], m.
            low: Lowest corner of the whole body's bounding box [3], m.
            high: Highest corner [3], m.
        """
        rows = super().histories(x, low, high)
        if self.unevenness:
            rows[:, 1] = np.expm1(self.unevenness * lumps(x, low, high))
        return rows

    @staticmethod
    def notes_on(density: NDArray, history: NDArray) -> list[str]:
        """Return a note if much of the snow is packed beyond the density of ice.

        Snow that is denser than ice at rest is not packed.

        Args:
            density: Densities at rest [P], kg/m^3.
            history: History variables [P,2].
        """
        packed = (density <= ICE) & (density > ICE * (1 + history[:, 0]))
        share = float(packed.mean())
        if share < DENSE:
            return []
        return [
            f"{share:.0%} of the snow is packed to more than the density of ice ({ICE:g} kg/m^3). "
            "A larger material.E, a larger material.hardening or a slower impact avoids this."
        ]

    def theta(self) -> tuple[float, ...]:
        """Return the law's parameters: mu, lambda, smallest and largest stretch, hardening."""
        return *self.lame, 1 - self.compression, 1 + self.extension, self.hardening
