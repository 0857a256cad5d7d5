"""Base classes of all materials."""

import math
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from phy124.kernels.transfer import Law
from phy124.schema.bounds import RGB
from phy124.schema.section import Section

FEW = 1.5
"""Number of particles per cell and axis for metal, foam and granular materials, which cannot tear.
With 2 particles per cell and axis, a run takes 1.7 times as long and its error does not change
(docs/lab/accuracy.md). For plasticine the number is 2, because its surface becomes bumpy with fewer
particles.
"""
COLLAPSE = 0.8
"""J of some materials approaches 0 if an impact is faster than this multiple of the speed of sound.
"""
FLOWING = 4.0
"""Limit on the longest axis of Gaussians in plastic or fluid material, relative to its length at
rest."""


SHADING = 0.3
Tint = Annotated[RGB | None, BeforeValidator(lambda tint: None if tint == "none" else tint)]
"""A colour; if None or "none", the colours of the picture are used."""


class Material(Section):
    """Base class of all materials. A material has a density and a constitutive law."""

    device_law: ClassVar[Law]
    scaled: ClassVar[int] = 0
    """Number of leading parameters in `theta` that are proportional to E; 0 if E cannot vary."""
    particles_per_axis: ClassVar[float] = 2.0
    """Default number of particles per cell and axis; with fewer than 2, elastic material tears."""
    may_collapse: ClassVar[bool] = False
    """Whether the material may stay flat after an impact, because its energy at J = 0 is finite."""

    max_stretch: ClassVar[float | None] = None
    """Limit on a Gaussian's longest axis, relative to the axis at rest. If None, laws with a return
    mapping have the limit `FLOWING`, because F grows without bound; other laws have no limit.
    """
    rounds: ClassVar[bool] = False
    """Whether stretched Gaussians of the material become balls instead of needles."""
    grains: ClassVar[bool] = False
    """Whether the interior must be drawn, because the material separates into grains or drops."""

    disperses: ClassVar[bool] = False
    """Whether the volume of a particle may grow without limit, because grains or drops move apart.
    """

    dents: ClassVar[bool] = False
    """Whether the material is a solid that keeps dents. The motion of such a solid is smoothed
    before Gaussians follow it (phy124/motion/smoothing.py). In videos, the light on a material
    without gloss follows the shape of its dents (phy124/rendering/dents.py).
    """

    crumbles: ClassVar[bool] = False
    """Whether broken material is drawn as fragments (phy124/rendering/fragments.py)."""

    scatters: ClassVar[bool] = False
    """Whether the particles start at random positions in their cells. This hides the rows of a
    regular lattice in material that spreads in thin layers.
    """

    shade: ClassVar[float] = 0.0
    """Standard deviation of the brightness of grains, relative to the mean."""

    rough: ClassVar[float] = 0.0
    """Standard deviation of the random shifts of Gaussians on the surface along each axis, relative
    to a Gaussian's size (`phy124.particles.grains.roughen`).
    """

    shading: ClassVar[float] = SHADING
    """Fraction of the contrast in brightness that Gaussians keep if they are tinted."""

    @property
    def lit(self) -> bool:
        """Whether a lamp lights the material in videos (phy124/rendering/matte.py). If not, the
        material keeps the light of the picture.
        """
        return self.tint is not None and self.grains and not self.shines

    shines: ClassVar[bool] = False
    """Whether videos show the material's gloss (phy124/rendering/shine.py)."""

    @property
    def redrawn(self) -> bool:
        """Whether videos compute the colours or the surface of the material in every frame."""
        return self.shines or self.lit or self.dents or self.crumbles

    sounder_law: ClassVar[str | None] = None
    """A law with the same fields that is stable in harder impacts; None if there is no such law."""

    density: float = Field(default=1000.0, ge=1, le=1e5)
    """Mass per volume [kg/m^3]."""

    tint: Tint = Field(
        default=None,
        examples=["snow"],
        description="Colour of the material: three channels from 0 to 1, or a CSS name. The "
        "picture's "
        f"contrast in brightness is reduced to {SHADING:.0%}, in liquids to zero. none: "
        "the colours of the picture.",
    )

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """Return the largest strain for which the stiffness grows by at most the factor `growth`.

        `stiffness` is A / rho of the stiffest particle [m^2/s^2]. The default is for the fixed
        corotated law, which stiffens most among the elastic laws. The factor of this law is 2 J^2 -
        J, where ln J is at most sqrt(3) times the strain.
        """
        return math.log((1 + math.sqrt(1 + 8 * growth)) / 4) / math.sqrt(3)

    def theta(self) -> tuple[float, ...]:
        """Return the parameters that kernels pass to the stress function of the law."""
        raise NotImplementedError

    def theta_on(self, dx: float, cfl: float) -> tuple[float, ...]:
        """Return the parameters of the law on a grid of spacing `dx` [m].

        `cfl` is the length of the substep, divided by the elastic limit.
        """
        return self.theta()

    @property
    def longest(self) -> float:
        """Limit on a Gaussian's longest axis, relative to the length at rest."""
        if self.max_stretch is not None:
            return self.max_stretch
        return math.inf if self.device_law.project is None else FLOWING

    def history(self) -> tuple[float, float]:
        """Return the initial history variables of a particle."""
        return (0.0, 0.0)

    def histories(self, x: NDArray, low: NDArray, high: NDArray) -> NDArray[np.float64]:
        """Return the initial history variables [P,2] of particles of a body.

        Args:
            x: Positions of those particles that have this material [P,3], m.
            low: Lowest corner of the whole body's bounding box [3], m.
            high: Highest corner [3], m.
        """
        return np.tile(np.array(self.history(), np.float64), (len(x), 1))

    def wave_speed(self) -> float:
        """Return `sqrt(A / rho)` without strain [m/s]; A is the modulus that limits substeps."""
        raise NotImplementedError

    def sound_speed(self) -> float:
        """Return the speed of a pressure wave in unstrained material [m/s]."""
        return self.wave_speed()

    def viscous_limit(self, dx: float) -> float:
        """Return the longest stable substep [s] with viscosity on a grid of spacing `dx` [m]."""
        return math.inf

    def cheaper(self, field: str) -> str:
        """Return a remedy for slow runs; `field` is the path of the material in the scene."""
        return f"a smaller {field}.E"

    def notes(self) -> list[str]:
        """Return notes for the user about how this material is simulated."""
        return []

    def notes_at(self, speed: float) -> list[str]:
        """Return notes for the user about a run in which this material moved at `speed` [m/s]."""
        mach = speed / self.sound_speed() if self.may_collapse else 0.0
        if mach <= COLLAPSE:
            return []
        # A law from outside phy124 may have no name.
        law = getattr(self, "law", self.device_law.name)
        return [
            f"Material of the law {law} moved at {mach:.1f} times its speed of sound. If it "
            f"hits something at more than {COLLAPSE} times this speed, it may stay squeezed flat "
            "without any other sign; neo_hookean does not."
        ]

    @staticmethod
    def notes_on(density: NDArray, history: NDArray) -> list[str]:
        """Return notes for the user about the particles of this law at the end of a run.

        Args:
            density: Densities at rest [P], kg/m^3.
            history: History variables [P,2].
        """
        return []


def viscous_substep(density: float, viscosity: float, dx: float) -> float:
    """Return the substep [s] in which viscosity just stops a particle's strain: rho dx^2 / (8 eta).

    The formula is for an isolated particle; twice the substep would be unstable. If elastic stress
    acts as well, the limit is smaller by the factor `timestep.beside_elastic`.

    Args:
        density: rho [kg/m^3].
        viscosity: eta [Pa s].
        dx: Grid spacing [m].
    """
    return density * dx * dx / (8 * viscosity) if viscosity else math.inf


class Elastic(Material):
    """Base class of materials with E and nu; `theta` begins with the Lame parameters mu, lambda."""

    scaled: ClassVar[int] = 2

    E: float = Field(default=1e5, ge=1, le=1e13)
    """Young's modulus [Pa]; for example jelly 1e4, rubber 1e6, wood 1e10."""
    nu: float = Field(default=0.3, ge=0, le=0.4999)
    """Poisson's ratio; 0.5 would be incompressible."""

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé parameters mu, lambda [Pa]."""
        mu = self.E / (2 * (1 + self.nu))
        return mu, self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu))

    def theta(self) -> tuple[float, ...]:
        """Return the parameters of the device law: (mu, lambda)."""
        return self.lame

    def wave_speed(self) -> float:
        """Return `sqrt((3 lambda + 2 mu) / rho)` of unstrained material [m/s].

        If lambda is negative (nu < 0), shear is the stiffest motion, so lambda is replaced by zero.
        """
        mu, lam = self.lame
        return math.sqrt((3 * max(lam, 0) + 2 * mu) / self.density)

    def sound_speed(self) -> float:
        """Return the speed of pressure waves, `sqrt((lambda + 2 mu) / rho)` [m/s]."""
        mu, lam = self.lame
        return math.sqrt((lam + 2 * mu) / self.density)


class Logarithmic(Elastic):
    """Base class of materials whose stress is linear in the Hencky strain.

    If two principal strains differ by x, the modulus A is at most 2 mu (1 + x) + 3 lambda.
    """

    def calm_strain(self, growth: float, stiffness: float) -> float:
        """Return the largest strain for which the stiffness grows by at most the factor `growth`.

        If the strain changes by e, the difference of two principal strains changes by at most
        sqrt(2) e.
        """
        return (growth - 1) / math.sqrt(2)
