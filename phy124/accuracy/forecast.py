"""Forecasts the time of a run before it starts.

The time [s] is substeps * (a * particles + b * nodes) + frames * (c + views * d). Here c is the
time to deform the Gaussians in a frame, and d the time to render and encode a picture. All four are
measured in trial runs. The number of substeps comes from a pilot run on a coarse grid
(`phy124.accuracy.probe`). The forecast is less reliable if the particles' speed limits the substep.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import numpy as np

from phy124.accuracy import companion
from phy124.accuracy.filming import time_film
from phy124.accuracy.load import QUIET, Load, LoadMeter, format_span
from phy124.accuracy.probe import (
    Pilot,
    SubstepCost,
    coarsen,
    probe,
    run_pilot,
    substeps_at_rest,
    time_shapes,
)
from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.particles.thickness import Proportions
from phy124.rendering.nearest import ROOM
from phy124.runtime.context import RunContext
from phy124.scene import AccuracyName, Scene
from phy124.scene.lattices import choose_solver
from phy124.simulation import Setup, Simulation, prepare

SPEED_UP = 0.72
"""Increase of the speed-up with each additional thread."""
GROWTH = 2.5
"""Exponent of the cells in the time of a companion run."""
UNSURE = 0.1
"""A forecast is reliable if speed limits at most this fraction of the substeps."""
GUESS = 1.14
"""Factor on the range of an unreliable forecast."""
ON_DEVICE = ("simulate", "deform", "render")
"""Stages that run on the GPU, if there is one."""
REMEMBERED = 32
"""Largest number of stored forecasts and measurements."""


@dataclass(frozen=True)
class Forecast:
    """The predicted time of each stage of a run."""

    stages: dict[str, float]
    """Predicted time of each stage [s], by the names in the report."""
    measured: tuple[str, ...]
    """Finished stages, whose times were measured."""
    particles: int
    nodes: int
    substeps: int
    limiters: dict[str, float]
    """Fraction of the substeps that each stability limit determines."""
    rates: SubstepCost
    memory: float = 0.0
    """Estimated memory of the run [bytes]."""
    caveat: str | None = None
    """Reason why the predicted time is not reliable, or None."""
    load: Load = QUIET
    proportions: Proportions | None = None
    """Proportions of the objects, or None if unknown."""
    device: str = "cpu"

    @property
    def span(self) -> tuple[float, float]:
        """Expected shortest and longest total time [s]."""
        done = sum(self.stages[name] for name in self.measured if name in self.stages)
        low, high = self.load.span(self.seconds - done, unsure=GUESS if self.caveat else 1.0)
        return done + low, done + high

    @property
    def seconds(self) -> float:
        """Predicted time of all stages [s]."""
        return sum(self.stages.values())

    def with_measured(self, name: str, seconds: float) -> Forecast:
        """Return the forecast with the measured time [s] of a finished stage."""
        return replace(self, stages={name: seconds, **self.stages}, measured=(*self.measured, name))

    def with_predicted(self, name: str, seconds: float, caveat: str) -> Forecast:
        """Return the forecast with a new first stage; `caveat` says why its time [s] is
        unreliable.
        """
        caveats = " ".join(filter(None, (self.caveat, caveat)))
        return replace(self, stages={name: seconds, **self.stages}, caveat=caveats)

    def lines(self) -> list[str]:
        """Return a line of text for each stage, and a summary."""
        made = [
            f"  {name:<12}{seconds:8.2f} s{'  (measured)' if name in self.measured else ''}"
            for name, seconds in self.stages.items()
        ]
        limited = ", ".join(f"{name} {fraction:.0%}" for name, fraction in self.limiters.items())
        busy = " while this machine is busy" if self.load.busy else ""
        total = f"  {'total':<12}{self.seconds:8.2f} s, likely {format_span(self.span)}{busy}"
        about = (
            f"{self.particles} particles, {self.nodes} nodes, about {self.substeps} substeps "
            f"(limited by: {limited}), {1e9 * self.rates.particle:.0f} ns per particle and substep"
            f", about {self.memory / 1e9:.1f} GB"
        )
        notes = [self._note_other_stages(), self.caveat]
        return [*made, total, about, *filter(None, notes)]

    def _note_other_stages(self) -> str | None:
        """Return a note if a run on a GPU spends most of its time on the CPU."""
        others = {n: s for n, s in self.stages.items() if n not in ON_DEVICE}
        if self.device == "cpu" or 2 * sum(others.values()) < self.seconds:
            return None
        longest = sorted(others, key=lambda name: -others[name])[:2]
        names = " and ".join(f"{name} ({others[name]:.1f} s)" for name in longest)
        fraction = sum(others.values()) / self.seconds
        return (
            f"{fraction:.0%} of this time is spent on the CPU, most of it on {names}. Starting the "
            "program and importing its packages takes a few seconds more."
        )

    def data(self) -> dict[str, Any]:
        """Return plain data for scripts."""
        return {**asdict(self), "seconds": self.seconds, "span": self.span}

    def compare(self, spent: Mapping[str, float]) -> dict[str, Any]:
        """Compare the predicted times with the measured times `spent` [s], by stage and in
        total.
        """
        predicted = {n: s for n, s in self.stages.items() if n not in self.measured and n in spent}
        rows = {
            name: {
                "predicted": seconds,
                "spent": spent[name],
                "ratio": _ratio(spent[name], seconds),
            }
            for name, seconds in predicted.items()
        }
        total, used = sum(predicted.values()), sum(spent[name] for name in predicted)
        return {
            "predicted": total,
            "spent": used,
            "ratio": _ratio(used, total),
            "stages": rows,
            "substeps": self.substeps,
            "limiters": self.limiters,
            "caveat": self.caveat,
            "span": self.span,
        }


@dataclass(frozen=True)
class Stop:
    """Predicted time and error for one position of the accuracy slider."""

    name: str
    seconds: float
    """Predicted time from the Gaussians to the finished files [s]."""
    promise: Promise
    pixels: float | None
    """Error bound in the video [pixels], or None."""
    caveat: str | None = None
    """Reason why the predicted time is not reliable, or None."""
    forecast: Forecast | None = None
    """Forecast of the time; None without trial runs."""

    @classmethod
    def of(
        cls, scene: Scene, seconds: float, promise: Promise, forecast: Forecast | None = None
    ) -> Stop:
        """Return the position of the slider for a scene with a named accuracy.

        Args:
            scene: The scene.
            seconds: Predicted time [s].
            promise: Error bound.
            forecast: Forecast of the time; None if there is no forecast.
        """
        pixels = None if promise.error is None else promise.error * pixels_per_size(scene)
        caveat = forecast.caveat if forecast else None
        return cls(str(scene.accuracy), seconds, promise, pixels, caveat, forecast)

    @property
    def error(self) -> float | None:
        """Error bound relative to the object's size, or None."""
        return self.promise.error


@dataclass
class Forecaster:
    """Forecasts the times of runs on a device, and stores measurements."""

    context: RunContext = field(default_factory=RunContext)
    """Only device and threads are used."""
    error: bool = True
    """Whether the forecasts include the estimate of the error."""
    _known: dict[Any, Any] = field(default_factory=dict, repr=False)
    _meter: LoadMeter = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._meter = LoadMeter(self.context.device)

    def forecast(self, gaussians: Gaussians, scene: Scene, *, crop: Crop = WHOLE) -> Forecast:
        """Forecast the time of a run.

        Raises:
            InputError: A simulation of the scene cannot be prepared; see `Simulation`.
        """
        context = self.context.aside()
        simulation = Simulation(prepare(gaussians, scene, context, crop=crop))
        made = self.of(simulation)
        return made.with_measured("particles", context.watch.seconds["particles"])

    def of(
        self,
        simulation: Simulation,
        *,
        filming: bool = True,
        error: bool = True,
        load: Load | None = None,
    ) -> Forecast:
        """Forecast the time of a simulation that has not started, without changing its state.

        Args:
            simulation: The simulation.
            filming: Whether the clip will be rendered to videos.
            error: Whether this run will estimate its error; the forecaster's `error` must also be
                set.
            load: Load by other programs; None: measured now.
        """
        scene = simulation.scene
        pilot = self._pilot(simulation)
        rates, nodes, each_frame = probe(simulation, pilot)
        rest = substeps_at_rest(simulation.solver) / scene.time.fps if pilot.on_lattice else None
        substeps, limiters = pilot.substeps(scene.resolution.cells, rest)
        particles = len(simulation.setup.particles)
        per_substep = rates.particle * particles + rates.node * nodes
        once, each_shape = time_shapes(simulation)
        stages = {
            "simulate": substeps * per_substep + scene.time.frames * each_frame,
            "deform": once + scene.time.frames * each_shape,
            **(self._filming(simulation.setup) if filming else {}),
        }
        cost = companion.forecast(simulation, substeps)
        wanted = error and self.error and scene.time.frames >= companion.FEWEST
        if wanted and cost <= companion.affordable(simulation):
            faster = speed_up(simulation.setup.threads) / speed_up(
                companion.count_threads(simulation.setup)
            )
            stages["companion"] = cost * faster * stages["simulate"]
            if pilot.on_lattice:  # a companion run takes as long as a pilot run
                ratio = companion.coarsen(scene).resolution.cells / pilot.cells
                stages["companion"] = pilot.seconds * ratio**GROWTH
        return Forecast(
            stages,
            measured=(),
            particles=particles,
            nodes=nodes,
            substeps=substeps,
            limiters=limiters,
            rates=rates,
            memory=simulation.setup.estimate.memory,
            caveat=_caveat(pilot, limiters),
            load=load or self._meter.load(),
            proportions=self._proportions(simulation),
            device=simulation.device,
        )

    def stops(self, gaussians: Gaussians, scene: Scene) -> dict[str, Stop]:
        """Return time and error bound for the named accuracies."""
        return {name: self._stop(name, gaussians, scene) for name in get_args(AccuracyName)}

    def _stop(self, name: AccuracyName, gaussians: Gaussians, scene: Scene) -> Stop:
        chosen = scene.model_copy(update={"accuracy": name})
        key = (id(gaussians), _physics(chosen))
        made: Forecast = self._remember(key, lambda: self.forecast(gaussians, chosen), gaussians)
        promised = promise(choose_solver(chosen, self.context.device), made.proportions)
        return Stop.of(chosen, made.seconds, promised, made)

    def _proportions(self, simulation: Simulation) -> Proportions | None:
        size = simulation.scene.object.size
        key = ("proportions", size, *_sample(simulation.setup.gaussians))
        return self._remember(key, lambda: simulation.setup.proportions)

    def _pilot(self, simulation: Simulation) -> Pilot:
        setup, scene = simulation.setup, simulation.scene
        gaussians, options = setup.source, {"crop": setup.crop, "placed": setup.placed}
        key = ("pilot", *_sample(setup.gaussians), _physics(coarsen(scene)), setup.crop)
        return self._remember(key, lambda: run_pilot(gaussians, scene, self.context, **options))

    def _filming(self, setup: Setup) -> dict[str, float]:
        scene = setup.scene
        key = ("film", len(setup.shown), scene.view, scene.time.frames, _look(setup))
        return self._remember(key, lambda: time_film(setup, self.context))

    def _remember(self, key: Any, make: Any, keep: Any = None) -> Any:
        """Return the stored value for a key, or compute and store the value.

        An object whose `id` is in the key must be passed as `keep`, so that no other object gets
        the same id.
        """
        if key not in self._known:
            while len(self._known) >= REMEMBERED:
                self._known.pop(next(iter(self._known)))
            self._known[key] = (make(), keep)
        return self._known[key][0]


def speed_up(threads: int) -> float:
    """Return the factor by which threads speed up the simulation (docs/lab/benchmarks.md)."""
    return 1 + SPEED_UP * (threads - 1)


def _sample(gaussians: Gaussians) -> tuple[int, bytes]:
    """Return the number of Gaussians and a few positions, as a cache key."""
    return len(gaussians), gaussians.means[:: max(1, len(gaussians) // 64)].tobytes()


def pixels_per_size(scene: Scene) -> float:
    """Return the length of the object's longest side in the video [pixels]."""
    if scene.view.fits:
        return min(scene.view.size) / ROOM  # the size of an object at rest
    half_height = np.tan(np.radians(scene.view.fov / 2)) * scene.view.distance
    return float(min(scene.view.size) / (2 * half_height))


def _look(setup: Setup) -> tuple[Any, ...]:
    """Return the materials that are rendered in a special way, with highlights, shadows or an
    extracted surface, and the side of a cell [m], on which such surfaces depend. The result is
    empty without such materials.
    """
    drawn = [m for m in setup.materials if m.redrawn]
    materials = tuple(section.model_dump_json() for section in drawn)
    return (setup.scene.dx, *materials) if drawn else ()


def _physics(scene: Scene) -> str:
    """Return the fields of a scene that determine the run's time."""
    return scene.model_dump_json(exclude={"description", "seed"})


def _caveat(pilot: Pilot, limiters: Mapping[str, float]) -> str | None:
    if pilot.stopped:
        return (
            "The motion is unstable on a coarse grid, so the time of the run cannot be predicted."
        )
    moving = sum(limiters.get(name, 0.0) for name in ("speed", "gradient"))
    if moving > UNSURE:
        return (
            f"The speed of the material, not its stiffness, limits {moving:.0%} of the substeps. "
            "This fraction differs between grids, so the predicted time is only a rough estimate."
        )
    return None


def _ratio(spent: float, predicted: float) -> float | None:
    return spent / predicted if predicted > 0 else None
