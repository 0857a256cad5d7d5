"""Elastic solids, which return to their rest shape after any deformation."""

import math
from typing import Any, ClassVar, Literal

from pydantic import Field

from phy124.kernels import elastic, hencky
from phy124.kernels.transfer import Law
from phy124.materials.base import Elastic, Logarithmic, viscous_substep


class Springy(Elastic):
    """Base class of elastic solids, with optional Kelvin-Voigt viscosity, as in rubber."""

    lossless: ClassVar[Law]
    damped: ClassVar[Any]
    """The law that includes viscosity; eta is the last parameter in theta."""

    damping: float = Field(default=0.0, ge=0, le=1e7)
    """Viscosity [Pa s]. At the angular frequency w [rad/s], the loss tangent is w damping / mu."""

    @property
    def device_law(self) -> Law:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The law with viscosity if `damping` is positive, otherwise the law without viscosity."""
        plain = self.lossless
        if self.damping == 0:
            return plain
        return plain._replace(name=f"{plain.name}_damped", stress=self.damped, width=3)

    def theta(self) -> tuple[float, ...]:
        """Return the law's parameters: mu, lambda and, if positive, `damping`."""
        return (*self.lame, self.damping) if self.damping else self.lame

    def viscous_limit(self, dx: float) -> float:
        """Return the longest stable substep [s] with viscosity on a grid of spacing `dx` [m]."""
        return viscous_substep(self.density, self.damping, dx)


class NeoHookean(Springy):
    """Compressible neo-Hookean solid with log J: the default law, stable in hard impacts."""

    law: Literal["neo_hookean"] = "neo_hookean"
    damped: ClassVar[Any] = staticmethod(elastic.neo_hookean_damped)
    lossless: ClassVar[Law] = Law(
        name="neo_hookean",
        stress=elastic.neo_hookean,
        modulus=elastic.neo_hookean_modulus,
        energy=elastic.neo_hookean_energy,
        width=2,
        barrier=True,
    )

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """Return the largest strain for which the stiffness grows by at most the factor `growth`.

        In `A = 2 mu s^2 + 3 lambda`, a strain e multiplies `s^2` by at most `exp(2 e)`.
        """
        steady = 3 * max(self.lame[1], 0.0) / self.density
        stretched = max(1 - steady / stiffness, 1e-3) if stiffness > 0 else 1.0
        return math.log(1 + (growth - 1) / stretched) / 2


class FixedCorotated(Springy):
    """Fixed corotated solid (PhysGaussian's "jelly"); hard impacts may flatten it unnoticed."""

    law: Literal["fixed_corotated"] = "fixed_corotated"
    may_collapse: ClassVar[bool] = True
    sounder_law: ClassVar[str | None] = "neo_hookean"
    damped: ClassVar[Any] = staticmethod(elastic.fixed_corotated_damped)
    lossless: ClassVar[Law] = Law(
        name="fixed_corotated",
        stress=elastic.fixed_corotated,
        modulus=elastic.fixed_corotated_modulus,
        energy=elastic.fixed_corotated_energy,
        width=2,
    )


class Hencky(Logarithmic, Springy):
    """St. Venant-Kirchhoff solid in Hencky strain: linear in log stretch, softer under tension."""

    law: Literal["hencky"] = "hencky"
    sounder_law: ClassVar[str | None] = "neo_hookean"
    damped: ClassVar[Any] = staticmethod(hencky.hencky_damped)
    lossless: ClassVar[Law] = Law(
        name="hencky",
        stress=hencky.hencky,
        modulus=hencky.hencky_modulus,
        energy=hencky.hencky_energy,
        width=2,
    )


FASTER = 1.5
"""If a rigid body exceeds `Rigid.speed` by more than this factor, the user gets a note."""


class Rigid(Elastic):
    """A hard body, simulated just stiff enough to make its deformation invisible.

    The cost of an explicit simulation grows as sqrt(E). An impact at the speed v causes the strain
    v / c, with c = sqrt(E / rho). Therefore E = rho (v / strain)^2 limits the strain to `strain`.
    """

    law: Literal["rigid"] = "rigid"
    device_law: ClassVar[Law] = NeoHookean.lossless
    scaled: ClassVar[int] = 0

    E: float = Field(default=1e10, ge=1, le=1e13)
    """Young's modulus of the real body [Pa]."""
    speed: float = Field(default=3.0, ge=1e-3, le=1000)
    """Largest expected speed of an impact [m/s]."""
    strain: float = Field(default=0.005, ge=1e-4, le=0.1)
    """Largest strain in an impact at `speed`."""

    def cheaper(self, field: str) -> str:
        """Return a remedy for slow runs: a smaller `speed`, which determines the stiffness."""
        return f"a smaller {field}.speed, if no impact is that fast"

    @property
    def simulated_E(self) -> float:
        """Young's modulus used in the simulation [Pa]."""
        return max(1.0, min(self.E, self.density * (self.speed / self.strain) ** 2))

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé parameters mu, lambda of the simulated stiffness [Pa]."""
        return NeoHookean(E=self.simulated_E, nu=self.nu).lame

    def notes(self) -> list[str]:
        """Return a note if the simulated stiffness is less than the real stiffness."""
        if self.simulated_E == self.E:
            return []
        return [
            f"The rigid body of E = {self.E:g} Pa is simulated with {self.simulated_E:g} Pa: it "
            f"deforms by up to {self.strain:.2%} when it hits something at {self.speed:g} m/s."
        ]

    def notes_at(self, speed: float) -> list[str]:
        """Return a note if the body was faster than the speed for which the stiffness is chosen."""
        if self.simulated_E == self.E or speed <= FASTER * self.speed:
            return []
        strain = speed * math.sqrt(self.density / self.simulated_E)
        return [
            f"The rigid body moved at {speed:.3g} m/s; its stiffness is for impacts at "
            f"{self.speed:g} m/s. At the higher speed, an impact deforms the body by about "
            f"{strain:.1%}; the material's setting speed = {speed:.3g} makes it stiff enough."
        ]
