"""Experiments with projected liquids: sloshing, a viscous channel, a spreading heap."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Boundary, Container, HalfSpace
from phy124.forces import Gravity
from phy124.liquid.solver import LiquidSolver
from phy124.materials import Fluid
from phy124.mpm import Model, State
from phy124.schema.region import Region
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import find_zeros, host, lattice, record
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values

DEPTH, WAVE, PERIODS = 0.5, 0.05, 5
"""Depth of the tank and amplitude of the wave, relative to the length; number of periods."""
SAMPLES = 60
"""Samples per period."""
GAP, NU, PULL, FALL = 0.5, 0.1, 2.0, 0.5
"""Distance of the plates [m], kinematic viscosity [m^2/s], gravity [m/s^2], duration [s]."""
RADIUS, THICK, LONGER = 6.0, 0.45, 4.0
"""Radius of the heap [m], its kinematic viscosity [m^2/s], and ratio of the last time to the first.

The heap is initially 1 m high, and gravity is 1 m/s^2. Inertia then changes the flow by 3 %.
"""
SIMILARITY = (1024 / (81 * np.pi**3)) ** 0.125
"""Prefactor of the radius of a spreading heap, 0.894 (Huppert 1982, eq. 2.31)."""


def fill(size: tuple[float, float, float], cells: int) -> NDArray[Any]:
    """Return positions [P,3], m, of eight particles per cell in a box from the origin to `size`."""
    step = 0.5 / cells
    return lattice([round(side / step) for side in size], step)


def solver_of(
    x: NDArray, v: NDArray, cells: int, walls: list[Boundary], g: float, viscosity: float = 0.0
) -> LiquidSolver:
    """Create a solver for a liquid with the density 1000 kg/m^3.

    Args:
        x: Positions of the particles [P,3], m.
        v: Velocities of the particles [P,3], m/s.
        cells: Cells per metre.
        walls: The walls.
        g: Acceleration downwards [m/s^2].
        viscosity: Dynamic viscosity [Pa s].
    """
    volume, water = np.full(len(x), 0.125 / cells**3), Fluid(density=1000, viscosity=viscosity)
    model = Model.of(x, volume, [water], dx=1 / cells, origin=(0, 0, 0))
    named = [(f"wall_{index}", wall) for index, wall in enumerate(walls)]
    forces = [Gravity(g=(0, 0, -g))]
    return LiquidSolver(model, State.of(model, v), forces=forces, boundaries=named, threads=1)


def frequency() -> float:
    """Return the first mode's frequency [Hz]: `omega^2 = g k tanh(k h)` with `k = pi / L`."""
    return float(np.sqrt(GRAVITY * np.pi * np.tanh(np.pi * DEPTH)) / (2 * np.pi))


def slosh(cells: int, depth: float) -> Values:
    """Excite the first mode of water in a tank 1 m long; `depth` is the depth of the water [m].

    Return the frequency [Hz], and the final height of the centre of mass / depth.
    """
    width = 4 / cells
    x = fill((1, width, depth), cells)
    k, period = np.pi, 1 / frequency()
    speed = WAVE * 2 * np.pi / period / np.sinh(k * DEPTH)
    v = np.zeros_like(x)
    v[:, 0] = -speed * np.sin(k * x[:, 0]) * np.cosh(k * x[:, 2])
    v[:, 2] = speed * np.cos(k * x[:, 0]) * np.sinh(k * x[:, 2])
    tank = Container(inside=Region(lower=(0, 0, 0), upper=(1, width, 9)), contact="slip")
    solver = solver_of(x, v, cells, [tank], GRAVITY)
    ends = np.arange(1, PERIODS * SAMPLES + 2) * period / SAMPLES
    times, places = record(
        solver, ends, lambda: (solver.clock.time, host(solver.state.x)[:, 0].mean() - 0.5)
    ).T
    crossings = find_zeros(times, places)
    rate = (len(crossings) - 1) / 2 / (crossings[-1] - crossings[0])
    return float(rate), float(host(solver.state.x)[:, 2].mean() / depth)


def fall(cells: int, viscosity: float) -> Values:
    """Let a liquid slab fall between no-slip plates, with `cells` cells across the gap.

    Return the speeds in the middle and across the gap [m/s]. The viscosity is dynamic [Pa s].
    """
    fine, width = round(cells / GAP), 4 * GAP / cells
    plates = [
        HalfSpace(point=(0, y, 0), normal=(0, sign, 0), contact="sticky")
        for y, sign in ((0.0, 1), (GAP, -1))
    ]
    sides = Container(inside=Region(lower=(0, -9, -9), upper=(width, 9, 9)), contact="slip")
    x = fill((width, GAP, 1.5), fine)
    solver = solver_of(x, np.zeros_like(x), fine, [*plates, sides], PULL, viscosity)
    solver.advance(FALL)
    x, v = host(solver.state.x), host(solver.state.v)
    level = np.abs(x[:, 2] - x[:, 2].mean()) < 0.2
    middle = level & (np.abs(x[:, 1] / GAP - 0.5) < 0.1)
    return float(-v[middle, 2].mean()), float(-v[level, 2].mean())


def started_flow() -> tuple[float, float]:
    """Return the exact speed in the middle fifth of the gap, and the mean speed [m/s]."""
    k = np.arange(1, 60, 2)
    waves = 4 * PULL * GAP**2 / (np.pi**3 * NU) / k**3
    waves *= 1 - np.exp(-((k * np.pi / GAP) ** 2) * NU * FALL)
    y = np.linspace(0.4, 0.6, 41)
    middle = float((waves @ np.sin(np.pi * np.outer(k, y))).mean())
    return middle, float(waves @ (2 / (np.pi * k)))


def spread(cells: int, viscosity: float, longer: float = LONGER) -> Values:
    """Let a heap spread on a no-slip floor; return the prefactor and the exponent of its radius.

    The heap starts at time t0 with the height `(1 - r^2 / R^2)^(1/3)` of the similarity solution,
    and spreads until `longer` times t0. The radius is sqrt(7/3) times the RMS distance from the
    axis, which is exact for the similarity solution. One quarter is simulated, with `cells` cells
    across the initial height. The viscosity is kinematic [m^2/s].
    """
    x = fill((RADIUS, RADIUS, 1.0), cells)
    x = x[x[:, 2] ** 3 < 1 - (x[:, 0] ** 2 + x[:, 1] ** 2) / RADIUS**2]
    scale = (4 * 0.125 * len(x) / cells**3) ** 3 / (3 * THICK)
    start = (RADIUS / SIMILARITY) ** 8 / scale
    sides = Container(inside=Region(lower=(0, 0, -9), upper=(99, 99, 99)), contact="slip")
    floor = HalfSpace(point=(0, 0, 0), normal=(0, 0, 1), contact="sticky")
    solver = solver_of(x, np.zeros_like(x), cells, [sides, floor], 1.0, 1000 * viscosity)
    times = start * np.geomspace(math.sqrt(longer), longer, 5)
    places = record(solver, times - start, lambda: host(solver.state.x)[:, :2])
    radii = np.sqrt(7 / 3 * (places**2).sum(axis=2).mean(axis=1))
    prefactor = np.mean(radii / (scale * times) ** 0.125)
    return float(prefactor), float(np.polyfit(np.log(times), np.log(radii), 1)[0])


SLOSHING = Experiment(
    name="sloshing",
    title="Sloshing in a tank",
    source="Linear theory of waves (Lamb 1932, § 228): ω² = g k tanh(k h), k = π / L",
    measured="The water in a smooth tank is half as deep as the tank is long. The water "
    "oscillates in its first mode with an initial amplitude of 5 % of the length. The experiment "
    "measures the frequency over 5 periods [Hz], and the final height of the centre of mass "
    "divided by the depth.",
    band="±1 %; a wave of this height is about 0.3 % slower than a small wave",
    published=lambda: (
        Quantity.within("frequency", frequency(), 0.01),
        Quantity.within("height of the centre / depth", 0.5, 0.01),
    ),
    run=lambda cells: slosh(cells, DEPTH),
    control=lambda cells: slosh(cells, 0.8 * DEPTH),
    mistake="the tank is filled to four fifths only",
    grids=(24, 32, 48),
    across="the tank's length",
    quick=True,
    seconds=15,
)
CHANNEL = Experiment(
    name="channel",
    title="Viscous liquid that falls between two plates",
    source=(
        "the speed g y (H - y) / (2 ν), minus a series, in a flow between plates that starts from "
        "rest (Batchelor 1967, § 4.3)"
    ),
    measured="A liquid slab with a viscosity of 0.1 m²/s falls between no-slip plates that are "
    "0.5 m apart. Gravity is 2 m/s². The experiment measures two mean speeds of the slab after "
    "0.5 s [m/s]: in the middle fifth of the gap, and across the whole gap.",
    band="±5 %, since the theory assumes an infinitely long slab",
    published=lambda: tuple(
        Quantity.within(name, speed, 0.05)
        for name, speed in zip(("speed in the middle", "mean speed"), started_flow(), strict=True)
    ),
    run=lambda cells: fall(cells, NU * 1000),
    control=lambda cells: fall(cells, 0.5 * NU * 1000),
    mistake="half the viscosity",
    grids=(12, 16, 24),
    across="the gap",
    quick=True,
    seconds=15,
)
SPREADING = Experiment(
    name="spreading",
    title="Spreading of a viscous heap",
    source="Huppert 1982: r = 0.894 (g V³ / 3ν)^(1/8) t^(1/8), which his experiments confirm",
    measured="A heap six times as wide as it is high spreads on a no-slip floor. At the time t₀, "
    "the similarity solution has the height of this heap. The heap starts with the shape of the "
    "solution at t₀, and spreads until 4 t₀. The experiment measures the prefactor and the "
    "exponent of the heap's radius from 2 t₀ to 4 t₀.",
    band="prefactor: ±2 %, exponent: ±5 %; the theory neglects inertia and the slope of the "
    "surface, which change the rate of spreading by about 3 %",
    published=lambda: (
        Quantity.within("prefactor", SIMILARITY, 0.02),
        Quantity.within("exponent", 0.125, 0.05),
    ),
    run=lambda cells: spread(cells, THICK),
    control=lambda cells: spread(cells, 0.25 * THICK),
    mistake="a quarter of the viscosity",
    grids=(4, 5, 7),
    across="the heap's height",
    seconds=25,
)
