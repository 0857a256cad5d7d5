"""A cantilever bent far by a dead weight at its end: the elastica of Euler."""

from __future__ import annotations

from phy124.forces import Force, TotalForce
from phy124.mpm.tracks import Keyframes
from phy124.schema.region import Region
from phy124.studies.validation.experiments import beam
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.roots import root

LOADS = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""P L^2 / E I."""


def exact(load: float) -> float:
    """Drop of the tip over the length, by elliptic integrals (Bisshopp and Drucker 1945).

    Args:
        load: P L^2 / E I.
    """
    import numpy as np
    from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

    def start(m: float) -> float:
        return float(np.arcsin(1 / np.sqrt(2 * m)))

    def missing(m: float) -> float:
        return float(ellipk(m) - ellipkinc(start(m), m) - np.sqrt(load))

    m = root(missing, 0.5, 1 - 1e-12)
    return float(1 - 2 / np.sqrt(load) * (ellipe(m) - ellipeinc(start(m), m)))


def published() -> tuple[Quantity, ...]:
    """The exact drops."""
    return beam.band(LOADS, [exact(load) for load in LOADS], "PL²/EI")


def weight(width: float, profile: Keyframes, end: Region) -> Force:
    """A dead weight on the beam's end; its factor is P L^2 / E I."""
    unit = beam.STIFFNESS * width / beam.LENGTH**2
    return TotalForce(f=(0, 0, -unit), region=end, profile=profile)


def run(cells: int) -> Values:
    """Drop of the tip at each load."""
    return beam.drops(cells, LOADS, weight)


def control(cells: int) -> Values:
    """The same of a beam 1.2 times as stiff."""
    return beam.drops(cells, LOADS, weight, stiffer=1.2)


EXPERIMENT = Experiment(
    name="elastica",
    title="Elastica: a dead weight on the end of a cantilever",
    source="Euler's elastica by elliptic integrals, as tabulated by Bisshopp and Drucker 1945",
    measured="Drop of the tip over the length, at rest, for seven weights. "
    "Theory for small bending is wrong by 11 % at PL²/EI = 1 and by 311 % at 10.",
    band="from a slender beam to one with twice the shear of this one, 12 times as long as thick",
    published=published,
    run=run,
    control=control,
    mistake="E is 20 % too large",
    grids=(2, 3, 4),
    across="the thickness",
    axis="P L² / E I",
    unit="drop / length",
    seconds=110,
    reason=beam.TOO_SOFT,
)
