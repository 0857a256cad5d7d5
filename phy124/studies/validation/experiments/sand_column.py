"""Experiment: collapse of sand columns in a channel (Lube et al. 2005; Lajeunesse et al. 2005)."""

import math
from collections.abc import Sequence

from phy124.boundaries import Ground
from phy124.forces import Gravity
from phy124.materials import Sand
from phy124.studies.validation.accuracy.problems import FLOOR_NODE, GRAVITY
from phy124.studies.validation.bodies import connected_end, make_solver, mirrors, plane, sheet
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values

ASPECTS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Initial height / width of the columns."""
LUBE = (1.2, 1.9, 2.3)
"""Coefficients (l1, l2, a0) of the run-out law for sand, rice and sugar.

The run-out / width of a column with height / width `a` is `l1 a` if `a < a0`, otherwise `l2
a^(2/3)`.
"""
LAJEUNESSE = (1.8, 2.3, 3.0)
"""Coefficients (l1, l2, a0) for glass beads."""
WIDTH = 0.1
"""Width of the column [m]."""
SLOPE = 31.0
"""Angle of friction in the channel, in plane strain [degrees]."""
STIFF = 300.0
"""Young's modulus divided by the pressure at the base. The pressure compresses the sand at the base
by about 0.3 %.
"""
DURATION = 6.0
"""Duration of a run, in units of sqrt(H / g); the collapse takes about 3 units."""


def plane_strain(angle: float) -> float:
    """Convert a Mohr-Coulomb angle in plane strain to `friction_angle` of `sand` [degrees].

    The Drucker-Prager cone touches the Mohr-Coulomb pyramid where two principal stresses are equal.
    In plane strain, the middle principal stress is the mean of the others. Then `sin(angle) = 2
    sqrt(3) s / (3 - s)`, where s is the sine of `friction_angle`.
    """
    sine = math.sin(math.radians(angle))
    return math.degrees(math.asin(3 * sine / (2 * math.sqrt(3) + sine)))


def run_out(aspect: float, law: tuple[float, float, float]) -> float:
    """Return the run-out / width by a law (l1, l2, a0); `aspect` is height / width."""
    linear, power, change = law
    return linear * aspect if aspect < change else power * aspect ** (2 / 3)


def publish() -> tuple[Quantity, ...]:
    """Return the run-out of each column by Lube's law for sand.

    The band extends from 0.9 times this run-out to the run-out by Lajeunesse's law for glass beads.
    """
    ways = [(aspect, run_out(aspect, LUBE), run_out(aspect, LAJEUNESSE)) for aspect in ASPECTS]
    return tuple(Quantity(f"H/L = {a:g}", low, 0.9 * low, high, a) for a, low, high in ways)


def collapse(cells: int, aspect: float, angle: float) -> float:
    """Measure the run-out / width for sand with a `friction_angle`.

    `cells` is the number of cells across a square with the column's area.
    """
    across, height = round(2 * cells / math.sqrt(aspect)), aspect * WIDTH
    dx = 2 * WIDTH / across
    x = sheet((across, round(across * aspect)), dx / 2)
    sand = Sand(friction_angle=angle, E=STIFF * 1600 * GRAVITY * height)
    walls = [Ground(friction=math.tan(math.radians(SLOPE))), *mirrors(0), plane()]
    world = {"origin": (-FLOOR_NODE * dx, 0, -FLOOR_NODE * dx), "forces": [Gravity()]}
    solver = make_solver(x, dx**3 / 4, [sand], dx=dx, boundaries=walls, threads=1, **world)
    solver.advance(DURATION * math.sqrt(height / GRAVITY))
    return connected_end(solver.state.x.numpy()[:, 0], dx) / WIDTH - 1


def measure(cells: int, aspects: Sequence[float], angle: float) -> Values:
    """Measure the run-out / width for the first of `ASPECTS`; the other values are NaN."""
    ways = [collapse(cells, aspect, angle) for aspect in aspects]
    return (*ways, *[math.nan] * (len(ASPECTS) - len(ways)))


EXPERIMENT = Experiment(
    name="sand-column",
    title="Sand columns: run-out in a channel, in both regimes",
    source="Lube et al. 2005 (sand, rice, sugar) and Lajeunesse et al. 2005 (glass beads), as "
    "compared by Lagrée, Staron and Popinet 2011",
    measured="The experiment measures the run-out of the heap divided by the column's width. The "
    "heap ends at the first gap in the sand that is wider than a cell. Let H/L be the ratio of "
    "the column's height to its width. Published run-outs are 1.2 H/L to 1.8 H/L for low columns, "
    "and 1.9 (H/L)^(2/3) to 2.3 (H/L)^(2/3) for high columns.",
    band="from 0.9 times the run-out by Lube's law to the run-out by Lajeunesse's law",
    published=publish,
    run=lambda cells: measure(cells, ASPECTS, plane_strain(SLOPE)),
    control=lambda cells: measure(cells, ASPECTS[:3], 50.0),
    mistake="friction_angle = 50°, too large for sand in a channel",
    grids=(10, 14, 20),
    across="a square of the column's area",
    axis="height / width",
    unit="run-out / width",
    seconds=60,
)
