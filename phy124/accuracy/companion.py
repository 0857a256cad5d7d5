"""Estimates the error of a finished run from a second run on a coarser grid (the companion run).

The estimated error is the RMS distance between the two runs times a factor, and the error bound is
the distance times a larger factor. The factors were measured on many objects
(docs/lab/own-error.md). The decision to make a companion run does not depend on measured times, so
that equal runs have equal reports.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.accuracy.expectation import expect
from phy124.accuracy.probe import min_cells
from phy124.accuracy.promises import SPREAD, format_apart, format_percent, why_broken
from phy124.accuracy.severity import Motion, motion_of
from phy124.budget.cost import USUAL, Rates
from phy124.errors import Cancelled
from phy124.io.clip import Clip
from phy124.motion.deform import Deformer
from phy124.mpm.workers import MIN_PARTICLES
from phy124.runtime.context import RunContext
from phy124.runtime.failures import failure
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped, prepare
from phy124.simulation.setup import Setup

AFFORDABLE = 0.2
"""Largest predicted time of the companion run, relative to the original run's simulation."""
ON_LATTICE = 1.5
"""Factor on `AFFORDABLE` for lattices. On a lattice, the simulation takes at most half of the run's
time.
"""
SAMPLE = 2000
"""Number of Gaussians that are compared."""
MPM, LATTICE = Rates(particle=7e-8), Rates(substep=2.6e-4, particle=3.6e-8)
RATES = {
    "mpm": (MPM, MPM),
    "lattice": (Rates(substep=4.2e-4, particle=2.1e-8), LATTICE),
    "cuda": (USUAL["cuda"], USUAL["cuda"]),
}
"""Times per substep and per particle, for the original run and for the companion run. With
lattices, the checks of each frame take a large part of the run's time.
"""
EFFORT: dict[Motion, float] = {
    "squeezed": 2.2,
    "landing": 1.55,
    "standing": 1.55,
    "held": 0.9,
    "free": 2.4,
}
"""Factors on the predicted time of a substep on a lattice, by kind of motion.

Contact takes additional time; so does the measurement of vibration frequencies of strained objects.
"""
PREPARING = {"mpm": (0.02, 5e-7, 0.0), "lattice": (0.044, 0.0, 1e-5), "cuda": (0.045, 3e-7, 0.0)}
"""Time to prepare a companion run [s]: a constant, per Gaussian, and per particle."""
COARSEST = 6
"""Smallest number of cells across the object in the companion run."""
FEWEST = 3
"""Smallest number of frames for an estimate."""
PARTED = 0.1
"""Largest distance of similar motions on two grids, relative to the object's size."""


class Factors(NamedTuple):
    """Ratios of a run's error to the distance from the companion run."""

    about: float
    """Median of the ratio over the measured objects and scenes."""
    at_most: float
    """95th percentile of the ratio over the measured objects and scenes."""


RATIO = 0.5
"""Cells across the object in the companion run, relative to the original run.

With 5/8, the estimate would be less precise and take twice as long (docs/lab/own-error.md).
"""
FACTORS = {
    "free": Factors(0.27, 0.85),
    "held": Factors(0.4, 1.75),
    "squeezed": Factors(0.5, 1.0),
    "landing": Factors(0.48, 1.4),
    "standing": Factors(0.55, 2.1),
    "plasticine": Factors(0.7, 1.7),
    "sand": Factors(0.85, 1.0),
    "snow": Factors(0.8, 4.5),
    "fluid": Factors(1.3, 2.1),
    "metal": Factors(0.6, 2.6),
    "foam": Factors(0.6, 0.95),
}
"""Factors for each kind of motion, and for each law that was measured; other laws use the factors
of the kind of motion.
"""
USUAL_CELLS = 16
"""Cells of a companion run to which `FACTORS` apply exactly; with more or fewer cells, the factors
are larger.
"""
FLOOR = 2e-4
"""Error that is always added to the bound, relative to the object's size."""
LEAST = 0.6
"""Lower limit of the error bound, as a fraction of the error that was predicted before the run. The
results on two coarse grids may agree by chance.
"""


class OwnError(NamedTuple):
    """The error of a run, estimated from a coarser run."""

    about: float | None = None
    """RMS distance from the exact motion, relative to the object's size."""
    at_most: float | None = None
    """Upper bound of the RMS distance, relative to the object's size."""
    until: float | None = None
    """Time after which the motion depends on the grid [s]; later frames are not part of the
    error.
    """
    cells: int | None = None
    """Cells across the object in the companion run."""
    cost: float | None = None
    """Predicted time of the companion run, relative to the original run's simulation."""
    why_not: str = ""
    """Reason why there is no estimate."""


class Lost(Exception):
    """Raised if a companion run fails."""


def with_own_error(
    run: Simulation, clip: Clip, *, omit: str = "", goal: Mapping[str, Any] | None = None
) -> Clip:
    """Return the clip of a run, with the estimated error in its report.

    Args:
        run: The run.
        clip: The clip of the run.
        omit: Reason to omit the companion run; if empty, a cheap companion run is made.
        goal: The entry `goal` of the report, if `--max-error` already measured the error.

    Raises:
        Cancelled: The context's `progress` cancelled the companion run.
    """
    omit = omit or why_broken(clip.report).rstrip(".")
    if omit:
        result = OwnError(why_not=omit)
    elif goal is not None:
        result = _measured_for(goal)
    else:
        try:
            result = measure_error(run, clip)
        except Lost as lost:  # the results of the original run must not be lost
            result = OwnError(why_not=str(lost))
    effects = dict(clip.report["effects"])
    if result.cells is not None:
        cost = f"{format_percent(result.cost)} of the dynamics" if result.cost else "unknown"
        effects["ran"] = [*effects["ran"], f"own error, from D/{result.cells}: cost {cost}"]
    elif result.about is not None:
        effects["ran"] = [*effects["ran"], "own error, from the grids of --max-error"]
    else:
        row = {"effect": "own error", "why": result.why_not}
        effects["left_out"] = [*effects["left_out"], row]
    return clip.with_report({**clip.report, "error": result._asdict(), "effects": effects})


def _measured_for(goal: Mapping[str, Any]) -> OwnError:
    error = goal["fraction"]
    if error is None:
        return OwnError(why_not=goal["why_not"].rstrip("."))
    return OwnError(error, SPREAD * error)


def measure_error(run: Simulation, clip: Clip) -> OwnError:
    """Estimate the error of a finished run, unless the companion run would take too long.

    Raises:
        Cancelled: The context's `progress` cancelled the companion run.
        Lost: The companion run failed.
    """
    if len(clip) < FEWEST:
        return OwnError(why_not=f"the clip has fewer than {FEWEST} frames")
    indices = _sample(run.setup)
    if not len(indices):
        return OwnError(why_not="no Gaussian of the scene moves")
    scene = coarsen(run.scene)
    if scene.resolution.cells < min_cells(scene):
        return OwnError(why_not="a solid of the scene is too thin for a coarser grid")
    cost = forecast(run, run.solver.clock.substeps)
    most = affordable(run)
    if cost > most:
        took, limit = format_apart(cost, most)
        why = f"a coarser grid would take {took} of the simulation time; the limit is {limit}"
        return OwnError(cost=round(cost, 4), why_not=why)
    with run.setup.context.watch.stage("companion"):
        return _compare(run, clip, scene, indices)


def coarsen(scene: Scene) -> Scene:
    """Return the scene of the companion run."""
    cells = max(round(RATIO * scene.resolution.cells), COARSEST)
    accuracy = scene.resolution.model_copy(update={"cells": cells, "solver": scene.solver})
    return scene.model_copy(update={"accuracy": accuracy, "binding": "lattice"})


def affordable(run: Simulation) -> float:
    """Return the largest predicted time of a companion run, relative to the original run's
    simulation.
    """
    return AFFORDABLE * (ON_LATTICE if run.scene.on_lattice else 1.0)


def forecast(run: Simulation, substeps: int, particles: int | None = None) -> float:
    """Return the time of the companion run, relative to the time of the original run's substeps."""
    kind = run.scene.solver if run.device == "cpu" else "cuda"
    (rates, bare), (once, each, point) = RATES[kind], PREPARING[kind]
    if particles is None:
        particles = count_particles(run.setup)
    taken = max(substeps, 1) * (EFFORT[motion_of(run.scene)] if kind == "lattice" else 1.0)
    dynamics = taken * (rates.substep + rates.particle * len(run.setup.particles))
    companion = RATIO * taken * (bare.substep + bare.particle * particles)
    preparing = once + each * len(run.setup.gaussians) + point * particles
    return (preparing + companion) / dynamics


def count_threads(setup: Setup) -> int:
    """Return the number of threads for a companion run."""
    enough = count_particles(setup) // MIN_PARTICLES
    return max(1, min(enough, setup.threads))


def count_particles(setup: Setup) -> int:
    """Estimate the number of particles in a companion run."""
    return round(len(setup.particles) * RATIO**3)


def factors_of(scene: Scene, cells: int) -> Factors:
    """Return the factors for a scene whose companion run has this number of cells."""
    keys = [
        section.law if section.law in FACTORS else motion_of(scene) for section in scene.materials
    ]
    scale = max((cells / USUAL_CELLS) ** 0.5, (USUAL_CELLS / cells) ** 0.25)
    return Factors(
        *(scale * max(each) for each in zip(*(FACTORS[key] for key in keys), strict=True))
    )


def estimate(
    distances: NDArray, times: NDArray, factors: Factors, expected: float | None = None
) -> tuple[float | None, float | None, float | None]:
    """Estimate a run's error, the error bound, and the time [s] until which they hold.

    Args:
        distances: RMS distance between the two runs in each frame [T], relative to the size.
        times: Times of the frames [T], s.
        factors: Ratios of the error to the distance between the runs.
        expected: Error bound predicted before the run, relative to the object's size; None: no
            prediction.
    """
    together = np.flatnonzero(distances <= PARTED)
    count = int(together[-1]) + 1 if len(together) else 0
    until = None if count == len(distances) else float(times[count])
    if count < FEWEST:
        return None, None, until
    distance = float(np.sqrt((distances[:count] ** 2).mean()))
    at_most = max(factors.at_most * distance + FLOOR, LEAST * (expected or 0.0))
    return factors.about * distance, at_most, until


def _compare(run: Simulation, clip: Clip, scene: Scene, indices: NDArray[np.int64]) -> OwnError:
    cells = scene.resolution.cells
    try:
        companion = _prepare(run.setup, scene)
        cost = forecast(run, run.solver.clock.substeps, len(companion.particles))
        distances = _distances(companion, clip, indices) / run.scene.object.size
    except Cancelled:
        raise
    except Stopped as stop:
        why = str(stop).rstrip(".")
        raise Lost(f"the companion run on D/{cells} stops early: {why}") from stop
    except Exception as error:
        why = failure(error).sentence.rstrip(".")
        raise Lost(f"the companion run on D/{cells} failed: {why}") from error
    expected = expect(run.scene, run.setup.proportions).error
    about, at_most, until = estimate(distances, clip.times, factors_of(scene, cells), expected)
    why_not = "" if about is not None else "even the first frames differ on other grids"
    return OwnError(about, at_most, until, cells, round(cost, 4), why_not)


def _prepare(setup: Setup, scene: Scene) -> Setup:
    progress = setup.context.progress
    threads = count_threads(setup)
    context = RunContext(setup.context.device, threads, lambda *_: progress("companion", 0, 1))
    options: dict[str, Any] = {"keep": False, "shapes": False, "observers": ()}
    return prepare(setup.source, scene, context, crop=setup.crop, placed=setup.placed, **options)


def _sample(setup: Setup) -> NDArray[np.int64]:
    moving = np.flatnonzero(setup.appearance.moves[: len(setup.gaussians)])
    return moving[np.linspace(0, len(moving) - 1, min(SAMPLE, len(moving))).astype(np.int64)]


def _distances(setup: Setup, clip: Clip, indices: NDArray[np.int64]) -> NDArray[np.float64]:
    """Make the companion run; return its RMS distances from a clip [T], m."""
    look = setup.appearance
    chosen = (np.cumsum(look.moves) - 1)[indices]
    limits: dict[str, Any] = {name: values[chosen] for name, values in look.limits().items()}
    deformer = Deformer(
        look.gaussians.select(indices), setup.particles, **limits, device=setup.context.device
    )
    run, distances = Simulation(setup), []
    for frame, (means, _, _) in zip(run, clip.rows_of(indices), strict=True):
        moved = deformer(*run.carrying(), index=frame.index, time=frame.time)
        gaps = means.astype(np.float64) - moved.gaussians.means
        distances.append(math.sqrt((gaps**2).sum(axis=1).mean()))
    return np.array(distances)
