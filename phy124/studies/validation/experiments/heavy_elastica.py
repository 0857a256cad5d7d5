"""A cantilever bent far by its own weight: the heavy elastica."""

from __future__ import annotations

from phy124.forces import Force, Gravity
from phy124.mpm.tracks import Keyframes
from phy124.schema.region import Region
from phy124.studies.validation.experiments import beam
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.roots import root

LOADS = (2.0, 8.0, 20.0)
"""rho g A L^3 / E I."""


def exact(load: float) -> float:
    """Drop of the tip over the length, from theta'' = -load (1 - s) cos theta by shooting.

    Args:
        load: rho g A L^3 / E I.
    """
    import numpy as np
    from scipy.integrate import solve_ivp

    def shape(bend: float) -> list[float]:
        def slope(s: float, y: list[float]) -> list[float]:
            return [y[1], -load * (1 - s) * np.cos(y[0]), np.sin(y[0])]

        ends = solve_ivp(slope, (0, 1), [0.0, bend, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
        return ends.tolist()

    bend = root(lambda first: shape(first)[1], 0.0, load / 2)
    return float(shape(bend)[2])


def published() -> tuple[Quantity, ...]:
    """The drops by numerical integration."""
    return beam.band(LOADS, [exact(load) for load in LOADS], "ρgAL³/EI")


def gravity(width: float, profile: Keyframes, end: Region) -> Force:
    """Gravity on all of the beam; its factor is rho g A L^3 / E I."""
    del width, end
    unit = beam.STIFFNESS / (beam.DENSITY * beam.THICKNESS * beam.LENGTH**3)
    return Gravity(g=(0, 0, -unit), profile=profile)


def run(cells: int) -> Values:
    """Drop of the tip at each load."""
    return beam.drops(cells, LOADS, gravity)


def control(cells: int) -> Values:
    """The same of a beam 1.4 times as stiff."""
    return beam.drops(cells, LOADS, gravity, stiffer=1.4)


EXPERIMENT = Experiment(
    name="heavy-elastica",
    title="Heavy elastica: a cantilever under its own weight",
    source="θ'' = −β (1 − s) cos θ, integrated numerically",
    measured="Drop of the tip over the length, at rest, for three strengths of gravity.",
    band="from a slender beam to one with twice the shear of this one, 12 times as long as thick",
    published=published,
    run=run,
    control=control,
    mistake="E is 40 % too large",
    grids=(2, 3, 4),
    across="the thickness",
    axis="ρ g A L³ / E I",
    unit="drop / length",
    seconds=50,
    reason=beam.TOO_SOFT,
)
