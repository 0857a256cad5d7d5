"""Measures times for a forecast: substeps, deformation of the Gaussians, and compilation."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.accuracy.stages import Growth, Stages, average_stages, predict_substep, timings_of
from phy124.boundaries.base import THINNEST
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.kernels.arguments import types
from phy124.monitor.softening import Softening
from phy124.monitor.watchdog import Watchdog
from phy124.motion.deform import Deformer
from phy124.mpm import Clock, Solver, Unstable
from phy124.mpm.workers import HOST
from phy124.runtime.compiling import is_compiled
from phy124.runtime.context import RunContext
from phy124.runtime.cores import cores
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.solver import kernels

if TYPE_CHECKING:
    from phy124.lattice.solver import LatticeSolver
    from phy124.liquid import AnySolver
    from phy124.simulation.bodies import Placed

PROBE = 20
"""Largest number of substeps in a trial run."""
MIN_PROBE = 6
"""Smallest number of substeps in a trial run."""
LONGEST_PROBE = 0.6
"""Longest duration of all trial runs [s]."""
ROUNDS = 5
"""Largest number of trial runs, whose median is used."""
GRAPH_PROBE = (20, 120)
"""Numbers of substeps in two trial runs on a GPU.

A fixed cost of each frame would dominate a single run; the difference of two runs does not contain
this cost.
"""
TRIES = 2
"""Number of repeated measurements; the shortest time counts."""
SHORT_STEP = 1e-3
"""Substep [s] that is assumed if the stable substep at rest is longer than `LONG_STEP`."""
LONG_STEP = 0.1
"""Longest substep in trial runs [s]. The stable substep of a viscous liquid at rest may be minutes
long.
"""
NODE_STAGES = ("clear", "grid")
"""Stages whose time is proportional to the number of nodes, in addition to the boundaries."""


@dataclass(frozen=True)
class SubstepCost:
    """Time of a substep on this machine, per particle and per node."""

    particle: float
    """Time per particle and substep [s]."""
    node: float
    """Time per node and substep [s]."""


def probe(simulation: Simulation, pilot: Pilot | None = None) -> tuple[SubstepCost, int, float]:
    """Measure the time of a substep, the number of nodes, and the time of the checks per frame [s].

    The simulation is then reset to its initial state. With a pilot run, the time of a substep and
    the number of nodes are means over the motion.
    """
    solver, watchdog = simulation.solver, simulation.find(Watchdog)
    after = None if watchdog is None else watchdog.after_substep
    solver.repair.begin(solver.clock)
    simulation.before_attempt()
    start = simulation.checkpoint()
    rounds: list[tuple[float, float, int]] = []
    spent = 0.0
    try:
        while len(rounds) < ROUNDS and spent < LONGEST_PROBE:
            spent += measure_time(
                lambda: rounds.append(_seconds_per_substep(simulation, after, pilot))
            )
            simulation.roll_back(start)
        checks = min(measure_time(lambda: _run_empty_frame(simulation)) for _ in range(TRIES))
    finally:
        simulation.roll_back(start)
        _clear_timings(solver)
    seconds, fraction, nodes = sorted(rounds)[len(rounds) // 2]
    if pilot is not None:
        nodes = round(nodes * pilot.growth)
    particle = seconds * (1 - fraction) / len(solver.model)
    return SubstepCost(particle, seconds * fraction / max(nodes, 1)), nodes, checks


def _seconds_per_substep(
    simulation: Simulation, after: Callable[[], None] | None, pilot: Pilot | None
) -> tuple[float, float, int]:
    """Return the time of a substep [s], the fraction of the time that is proportional to the number
    of nodes, and the number of nodes.
    """
    solver = simulation.solver
    if _on_device(solver):
        return _seconds_in_graph(solver, after), 0.0, solver.grid.count
    each, stages = _time_substeps(simulation, after)
    if pilot is not None and pilot.stages:
        growth = pilot.growth_to(simulation.scene.resolution.cells, pilot.dx / solver.model.dx)
        each = predict_substep(pilot.stages, pilot.resting, stages, growth)
    return each, _node_fraction(solver), solver.grid.count


def _time_substeps(
    simulation: Simulation, after: Callable[[], None] | None = None
) -> tuple[float, Stages]:
    """Return the mean time of the next substeps [s], and the times of their stages."""
    solver = simulation.solver
    each = min(measure_time(lambda: _advance(solver, 2, after)) / 2 for _ in range(2))
    _clear_timings(solver)
    before, count = solver.clock.substeps, int(np.clip(LONGEST_PROBE / each, MIN_PROBE, PROBE))
    if _is_liquid(solver):
        count = MIN_PROBE  # a liquid's whole motion may take 20 steps
    seconds = measure_time(lambda: _advance(solver, count, after))
    taken = solver.clock.substeps - before
    return seconds / taken, average_stages(timings_of(solver), taken, seconds)


def _seconds_in_graph(solver: AnySolver, after: Callable[[], None] | None) -> float:
    """Return the time of a substep in a CUDA graph [s], without the fixed cost of a frame."""
    few, more = GRAPH_PROBE
    _advance(solver, few, after)  # captures the CUDA graph
    taken, seconds = [], []
    for count in (few, more):
        before = solver.clock.substeps
        seconds.append(measure_time(lambda count=count: _advance(solver, count, after)))
        taken.append(solver.clock.substeps - before)
    difference = (seconds[1] - seconds[0]) / max(taken[1] - taken[0], 1)
    return max(difference, 0.1 * seconds[1] / taken[1])


def _run_empty_frame(simulation: Simulation) -> None:
    solver = simulation.solver
    solver.repair.begin(solver.clock)
    simulation.before_attempt()
    simulation.checkpoint()
    solver.advance(solver.clock.time)
    simulation.after_attempt()
    solver.repair.end()


def _clear_timings(solver: AnySolver) -> None:
    """Clear the times of a solver, and of the solvers that it contains."""
    for part in _list_solvers(solver, "lattice", "liquid"):
        for worker in getattr(part, "workers", ()):
            worker.timings.clear()


def measure_time(work: Callable[[], Any]) -> float:
    """Return the duration of a function call [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _advance(solver: AnySolver, substeps: int, after: Callable[[], None] | None) -> None:
    limit = solver.clock.stable() if solver.clock.extremes.stiffness > 0 else None
    if limit is None:
        solver.step(0.0, 0.0)
        limit = solver.clock.stable()
    if limit.dt > LONG_STEP:  # a liquid at rest does not limit the substep until forces act
        solver.advance(solver.clock.time + SHORT_STEP)
        limit = solver.clock.stable()
    dt = limit.dt if limit.dt <= LONG_STEP else SHORT_STEP
    solver.advance(solver.clock.time + substeps * dt, after=after)


def _node_fraction(solver: AnySolver) -> float:
    walls = {stage.name for stage in solver.boundaries}
    total = nodes = 0.0
    for worker in solver.workers:
        for name, (seconds, _) in worker.timings.items():
            if name != "wait" and name not in HOST:
                total += seconds
                nodes += seconds if name in NODE_STAGES or name in walls else 0.0
    return nodes / total if total else 0.0


def time_shapes(simulation: Simulation) -> tuple[float, float]:
    """Return the times [s] to bind Gaussians and to deform them in a frame, for random strains."""
    solver, particles = simulation.solver, simulation.setup.particles
    rng = np.random.default_rng(0)
    strained = np.eye(3) + 0.05 * rng.standard_normal((len(particles), 3, 3))
    real = solver.model.real
    F: Any = wp.array(strained, dtype=types(real).mat33, device=simulation.device)
    options: dict[str, Any] = {"device": simulation.device, "threads": len(solver.workers)}
    start = time.perf_counter()
    deform = Deformer(simulation.setup.scenery.moving, particles, **options)
    once = time.perf_counter() - start
    x, v = solver.state.x, solver.state.v if simulation.scene.velocities else None
    deform(x, F, index=0, time=0.0, velocities=v)
    return once, measure_time(lambda: deform(x, F, index=1, time=0.0, velocities=v))


def seconds_to_compile(scene: Scene, device: str = "cpu") -> float:
    """Predict the time to compile a scene's missing kernels on all cores [s]; 0 on a GPU.

    Only one thread may call this function at a time, and no solver may be built at the same time.
    """
    if device != "cpu" or wp.config.kernel_cache_dir is None:
        return 0.0
    needed = {kernel.module.name: kernel for kernel in kernels(scene)}
    seconds = [kernel.seconds for kernel in needed.values() if not is_compiled(kernel)]
    return max(sum(seconds) / cores(), max(seconds, default=0.0))


SPLASH = 1.2
"""Exponent of the cells in the number of steps of a liquid, whose splashes are faster on finer
grids.
"""
CELLS = 16
"""Cells across the object in the pilot run."""
EXCESS = 0.8
"""The difference between the numbers of substeps in motion and at rest is proportional to cells^(1
+ EXCESS).
"""
ON_LATTICE = 1.2
"""Value of `EXCESS` for lattices."""
LIMITERS = ("elastic", "speed", "gradient", "viscous", "user", "wave")


@dataclass(frozen=True)
class Pilot:
    """Numbers of substeps in a short run on a coarse grid."""

    cells: int
    counts: dict[str, NDArray[np.float64]]
    """Substeps that each stability limit requires in each frame [T], not rounded."""
    rest: float
    """Substeps per frame in the initial state."""
    growth: float
    """Mean number of nodes, relative to the initial number."""
    stopped: bool
    """Whether the pilot run became unstable."""
    viscous: float = 0.0
    """Substeps per frame that viscosity alone requires."""
    factors: NDArray[np.float64] | float = 1.0
    """Factor on Young's modulus in each frame [T]."""
    excess: float = EXCESS
    """See `EXCESS`."""
    hastens: float = 1.0
    """Exponent of the cells in the number of substeps that speed limits."""
    dx: float = 1.0
    """Side of a cell [m]."""
    resting: Stages = field(default_factory=dict)
    """Stages of a substep at rest; empty if a graph on a GPU takes the substeps."""
    stages: Stages = field(default_factory=dict)
    """Stages of a substep in the whole motion; empty as `resting`."""
    on_lattice: bool = False
    """Whether all objects are on lattices."""
    seconds: float = 0.0
    """Duration with preparation, but without the trial at rest [s]."""
    steps: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Steps of a liquid among other bodies, in the form of `counts`."""

    def substeps(self, cells: int, rest: float | None = None) -> tuple[int, dict[str, float]]:
        """Predict the number of substeps on another grid, and the fraction that each limit
        determines.
        """
        scale = cells / self.cells
        more = scale if rest is None else rest / self.rest
        at_rest = np.minimum(self.counts["elastic"], self.rest * np.sqrt(self.factors))
        excess = self.counts["elastic"] - at_rest
        counts = {
            **self.counts,
            "elastic": more * (at_rest + excess * scale**self.excess),
            "speed": self.counts["speed"] * scale**self.hastens,
            "wave": self.counts.get("wave", np.zeros_like(at_rest)) * scale**SPLASH,
        }
        others = np.sum([n for name, n in counts.items() if name != "viscous"], axis=0)
        is_viscous = others < self.viscous * scale**2
        counts = {name: np.where(is_viscous, 0.0, n) for name, n in counts.items()}
        counts["viscous"] = np.where(is_viscous, self.viscous * scale**2, 0.0)
        total = np.sum(list(counts.values()), axis=0)
        whole = float(total.sum()) or 1.0
        fractions = {name: float(n.sum()) / whole for name, n in counts.items() if n.any()}
        return int(np.ceil(total - 1e-9).sum()), fractions

    def growth_to(self, cells: int, finer: float) -> Growth:
        """Return the ratios of a run with `finer` times smaller cells to the pilot run."""
        substeps = self.substeps(cells)[0] / max(self.substeps(self.cells)[0], 1)
        of_liquid = [
            np.ceil(sum(n * scale**SPLASH for n in self.steps.values()) - 1e-9)
            for scale in (1.0, cells / self.cells)
        ]
        before, after = (float(np.sum(steps)) for steps in of_liquid)
        return Growth(finer, substeps, after / before if self.steps else substeps)


def coarsen(scene: Scene, cells: int = CELLS) -> Scene:
    """Return the scene of the pilot run on a grid with this number of cells."""
    # Solids that the grid of the scene resolves must not be too thin for the coarse grid.
    cells = min(max(cells, min_cells(scene)), scene.resolution.cells)
    changes = {"cells": cells, "precision": "float32", "solver": scene.solver}
    accuracy = scene.resolution.model_copy(update=changes)
    return scene.model_copy(update={"accuracy": accuracy, "binding": "lattice"})


def min_cells(scene: Scene) -> int:
    """Return the smallest number of cells across the object that resolves all solids."""
    thicknesses = [wall.thickness() for wall in scene.with_solids().boundaries]
    thicknesses += [float(body.half.min()) for body in scene.objects if body.free]
    cells = THINNEST * scene.object.size / min(thicknesses, default=math.inf)
    return math.ceil(cells * (1 - 1e-9))


def run_pilot(
    gaussians: Gaussians,
    scene: Scene,
    context: RunContext | None = None,
    *,
    crop: Crop = WHOLE,
    placed: Placed | None = None,
) -> Pilot:
    """Simulate a scene on a coarse grid, and count the substeps that the motion needs.

    Args:
        gaussians: The object.
        scene: The scene.
        context: Only the device is used.
        crop: Position of the object in the picture with the masks of parts.
        placed: The object in its position, if a setup has already placed the same Gaussians.

    Raises:
        InputError: The scene can be simulated neither on the coarse grid nor on its own grid.
    """
    context = RunContext(device=(context or RunContext()).device)
    start, finest = time.perf_counter(), scene.resolution.cells
    options: dict[str, Any] = {"crop": crop, "placed": placed}
    try:
        simulation = Simulation(prepare(gaussians, coarsen(scene), context, **options))
    except InputError:  # on a coarse grid, a small region may contain no particle
        if coarsen(scene).resolution.cells == finest:
            raise
        simulation = Simulation(prepare(gaussians, coarsen(scene, finest), context, **options))
    cells = simulation.scene.resolution.cells
    solver, timing = simulation.solver, scene.time
    softening = simulation.find(Softening)
    counts = {name: np.zeros(timing.frames - 1) for name in LIMITERS}
    parts = _list_solvers(solver)
    tallies: list[dict[str, NDArray[np.float64]]] = [counts, {}]
    factors = scene.softnesses(np.arange(timing.frames - 1) / timing.fps)
    nodes, rest, trial, spent = [], 0.0, 0.0, 0.0
    stopped, resting, stages = False, {}, {}
    try:
        if not _on_device(solver):
            trial = measure_time(lambda: resting.update(_stages_at_rest(simulation)))
        solver.step(0.0, 0.0)
        rest = substeps_at_rest(solver) / timing.fps
        _clear_timings(solver)  # Removes the limits of the first substep, which has no duration.
        for frame in range(timing.frames - 1):
            before = [dict(part.clock.needed) for part in parts]
            if softening is not None:
                softening.follow(float(factors[frame]))
            spent += measure_time(lambda frame=frame: solver.advance((frame + 1) / timing.fps))
            for part, tally, earlier in zip(parts, tallies, before, strict=False):
                _count_needed(part.clock, earlier, tally, frame, timing.frames)
            nodes.append(solver.grid.count)
    except Unstable:
        stopped = True
    growth = float(np.mean(nodes) / nodes[0]) if nodes else 1.0
    if resting and solver.clock.substeps > 1:
        stages = average_stages(timings_of(solver), solver.clock.substeps - 1, spent)
    made = Pilot(
        cells,
        counts,
        rest,
        growth,
        stopped,
        factors=factors,
        dx=solver.model.dx,
        resting=resting,
        stages=stages,
        on_lattice=_on_lattice(solver),
        seconds=time.perf_counter() - start - trial,
        steps=tallies[1],
        hastens=SPLASH if _is_liquid(solver) else 1.0,
    )
    if made.on_lattice:
        return replace(made, excess=ON_LATTICE)
    return replace(made, viscous=1 / (solver.clock.viscous * timing.fps))


def _count_needed(
    clock: Clock,
    before: dict[str, float],
    counts: dict[str, NDArray[np.float64]],
    frame: int,
    frames: int,
) -> None:
    """Store the substeps that each limit required in a frame."""
    for name, needed in clock.needed.items():
        counts.setdefault(name, np.zeros(frames - 1))[frame] = needed - before.get(name, 0.0)


def _stages_at_rest(simulation: Simulation) -> Stages:
    start = simulation.checkpoint()
    _, stages = _time_substeps(simulation)
    simulation.roll_back(start)
    return stages


def substeps_at_rest(solver: AnySolver) -> float:
    """Return the substeps per second in the initial state [1/s].

    If the solver uses particles, it must already have measured its limits.
    """
    if _on_lattice(solver):
        return 1 / solver.limits.substep_at_rest
    lattices: LatticeSolver | None = getattr(solver, "lattice", None)
    of_lattices = 0.0 if lattices is None else 1 / lattices.limits.substep_at_rest
    clock = solver.clock
    elastic = clock.cfl * clock.elastic_limit * solver.model.dx
    return max(of_lattices, math.sqrt(clock.extremes.stiffness) / elastic)


def _list_solvers(solver: AnySolver, *names: str) -> list[Any]:
    """Return a solver and the named solvers inside it; by default, the solver of its liquid."""
    parts = (getattr(solver, name, None) for name in names or ("liquid",))
    return [solver, *(part for part in parts if part is not None)]


def _is_liquid(solver: AnySolver) -> bool:
    """Return whether all material is a projected liquid."""
    return solver.projects and not hasattr(solver, "liquid")


def _on_device(solver: AnySolver) -> bool:
    return isinstance(solver, Solver) and solver.on_device


def _on_lattice(solver: AnySolver) -> TypeGuard[LatticeSolver]:
    from phy124.lattice.solver import LatticeSolver

    return isinstance(solver, LatticeSolver)
