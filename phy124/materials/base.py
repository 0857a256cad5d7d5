"""What all materials have in common."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field

from phy124.kernels.transfer import Law
from phy124.schema.bounds import RGB
from phy124.schema.section import Section

FEW = 1.5
"""Particles per cell and axis of plastic and granular materials, which cannot tear. With 2 a run
takes 1.7 times as long and has the same error (docs/lab/accuracy.md)."""
FLOWING = 4.0
"""Longest axis of a Gaussian of plastic or fluid material, relative to its longest axis at rest."""


SHADING = 0.3
"""Fraction of the contrast in brightness that Gaussians keep under a tint."""
Tint = Annotated[RGB | None, BeforeValidator(lambda tint: None if tint == "none" else tint)]
"""A colour; absent or "none": the picture's colours."""


class Material(Section):
    """Base class of all materials: a density and a law on the device."""

    device_law: ClassVar[Law]
    scaled: ClassVar[int] = 0
    """How many of the first entries of `theta` are proportional to E; 0: it has no E to vary."""
    particles_per_axis: ClassVar[float] = 2.0
    """Particles per cell and axis that a run has by default. Fewer than 2 let elastic material tear
    sooner."""
    may_collapse: ClassVar[bool] = False
    """Whether it may stay flat after an impact, since its energy at J = 0 is finite."""

    max_stretch: ClassVar[float | None] = None
    """Longest axis of a Gaussian, relative to its longest axis at rest. None: `FLOWING` for laws
    with a return mapping, whose F grows without bound, and no limit for others."""
    rounds: ClassVar[bool] = False
    """Whether its Gaussians become balls as they are drawn out, instead of needles."""
    grains: ClassVar[bool] = False
    """Whether it falls apart, so that its inside is shown, too."""

    shade: ClassVar[float] = 0.0
    """How much grains differ in brightness: standard deviation as a fraction."""

    shines: ClassVar[bool] = False
    """Whether pictures show its gloss (phy124/rendering/shine.py)."""

    sounder_law: ClassVar[str | None] = None
    """A law with the same fields that stays sound in harder impacts."""

    density: float = Field(default=1000.0, ge=1, le=1e5, description="Mass per volume [kg/m^3].")

    tint: Tint = Field(
        default=None,
        examples=["snow"],
        description="Colour of the substance, as channels from 0 to 1 or a CSS name: the picture's "
        f"colours keep {SHADING:.0%} of their contrast in brightness. none: the picture's colours.",
    )

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """Largest strain until which no particle becomes stiffer than `growth` times the stiffest.

        Fixed corotated material stiffens most of the elastic laws: 2 J^2 - J times, where ln J is
        up to sqrt(3) times the strain.

        Args:
            growth: Largest ratio of stiffnesses, above 1.
            stiffness: A / rho of the stiffest particle [m^2/s^2].
        """
        del stiffness
        return math.log((1 + math.sqrt(1 + 8 * growth)) / 4) / math.sqrt(3)

    def theta(self) -> tuple[float, ...]:
        """Return the parameters of the device law."""
        raise NotImplementedError

    def theta_on(self, dx: float, cfl: float) -> tuple[float, ...]:
        """Return the parameters on a grid of spacing `dx` [m], with `cfl` of the stable substep."""
        del dx, cfl
        return self.theta()

    @property
    def longest(self) -> float:
        """`max_stretch`, or the default of the law."""
        if self.max_stretch is not None:
            return self.max_stretch
        return math.inf if self.device_law.project is None else FLOWING

    def history(self) -> tuple[float, float]:
        """Initial history variables of a particle."""
        return (0.0, 0.0)

    def wave_speed(self) -> float:
        """Speed that limits the substep at rest, sqrt(A / rho) [m/s]."""
        raise NotImplementedError

    def sound_speed(self) -> float:
        """Speed of a pressure wave at rest [m/s]."""
        return self.wave_speed()

    def viscous_limit(self, dx: float) -> float:
        """Longest substep that viscosity allows on a grid of spacing `dx` [m], s."""
        del dx
        return math.inf

    def cheaper(self, field: str) -> str:
        """Return a remedy for long runs; `field` is the scene's field of this material."""
        return f"a smaller {field}.E"

    def notes(self) -> list[str]:
        """Return notes for the user on how this material is simulated."""
        return []

    def notes_at(self, speed: float) -> list[str]:
        """Return notes for the user on a run in which something has moved at a speed [m/s]."""
        del speed
        return []


def viscous_substep(density: float, viscosity: float, dx: float) -> float:
    """rho dx^2 / (8 eta), the substep [s] in which viscosity stops an isolated particle's strain.

    Twice as long would be unstable. How this limit combines with the elastic one:
    `timestep.beside_elastic`.

    Args:
        density: rho [kg/m^3].
        viscosity: eta [Pa s].
        dx: Grid spacing [m].
    """
    return density * dx * dx / (8 * viscosity) if viscosity else math.inf


class Elastic(Material):
    """Materials with Young's modulus and Poisson's ratio; theta begins with mu and lambda."""

    scaled: ClassVar[int] = 2

    E: float = Field(
        default=1e5,
        ge=1,
        le=1e13,
        description="Young's modulus [Pa]: jelly 1e4, rubber 1e6, wood 1e10.",
    )
    nu: float = Field(
        default=0.3, ge=0, le=0.4999, description="Poisson's ratio; 0.5 is incompressible."
    )

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé parameters mu, lambda [Pa]."""
        mu = self.E / (2 * (1 + self.nu))
        return mu, self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu))

    def theta(self) -> tuple[float, ...]:
        """Parameters handed to the device law: (mu, lambda)."""
        return self.lame

    def wave_speed(self) -> float:
        """Speed that limits the substep at rest, sqrt((3 lambda + 2 mu) / rho) [m/s].

        A negative lambda (nu < 0) does not count: shear is then the stiffest motion.
        """
        mu, lam = self.lame
        return math.sqrt((3 * max(lam, 0) + 2 * mu) / self.density)

    def sound_speed(self) -> float:
        """Speed of a pressure wave at rest, sqrt((lambda + 2 mu) / rho) [m/s]."""
        mu, lam = self.lame
        return math.sqrt((lam + 2 * mu) / self.density)


class Logarithmic(Elastic):
    """Materials whose stress is linear in Hencky strain: A is at most 2 mu (1 + x) + 3 lambda."""

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """A difference x of principal strains changes by sqrt(2) times the strain at most."""
        del stiffness
        return (growth - 1) / math.sqrt(2)
