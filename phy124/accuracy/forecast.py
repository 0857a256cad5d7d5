"""Forecasts the time of a run before it starts.

The time [s] is substeps * (a * particles + b * nodes) + frames * (shapes + views * pictures). The
rates a and b are measured in trial runs of 20 substeps, after which the solver is reset to its
initial state. The number of substeps comes from a pilot run on a coarse grid
(`phy124.accuracy.probe`). The times for shapes, rendering and video are measured on a few frames.
The forecast is less reliable if the particles' speed limits the substep.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import numpy as np

from phy124.accuracy import companion
from phy124.accuracy.load import QUIET, Load, LoadMeter, format_span
from phy124.accuracy.probe import (
    Pilot,
    SubstepCost,
    coarsen,
    probe,
    run_pilot,
    substeps_at_rest,
    time_film,
    time_shapes,
)
from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.particles.thickness import Proportions
from phy124.rendering.nearest import ROOM
from phy124.runtime.context import RunContext
from phy124.scene import AccuracyName, Scene
from phy124.simulation import Simulation, prepare

SPEED_UP = 0.72
"""Increase of the speed-up with each additional thread."""
GROWTH = 2.5
"""The time of a companion run is assumed to grow with this power of the cells across the object."""
UNSURE = 0.1
"""A forecast is reliable if the particles' speed limits at most this fraction of the substeps."""
GUESS = 1.14
"""Factor that widens the range of the predicted time if the forecast is not reliable."""
ON_DEVICE = ("simulate", "deform", "render")
"""Names of the stages that run on the GPU, if there is a GPU."""
REMEMBERED = 32
"""Maximum number of stored forecasts and measurements; a new entry replaces the oldest entry."""


@dataclass(frozen=True)
class Forecast:
    """The predicted time of each stage of a run, with the counts and rates of the prediction."""

    stages: dict[str, float]
    """Predicted time of each stage [s], by the names in the report."""
    measured: tuple[str, ...]
    """Names of finished stages, whose times in `stages` were measured."""
    particles: int
    nodes: int
    """Mean number of grid nodes over the run."""
    substeps: int
    limiters: dict[str, float]
    """For each stability limit, the fraction of the substeps whose length this limit determines."""
    rates: SubstepCost
    memory: float = 0.0
    """Estimated memory of the run (`phy124.budget.limits`) [bytes]."""
    caveat: str | None = None
    """Reason why the predicted time is not reliable, or None."""
    load: Load = QUIET
    """Load by other programs on this machine during the trial runs."""
    proportions: Proportions | None = None
    """Proportions of the objects; None if they are unknown."""
    device: str = "cpu"
    """Device on which the run is computed."""

    @property
    def span(self) -> tuple[float, float]:
        """Expected range of the total time (shortest, longest) [s]."""
        done = sum(self.stages[name] for name in self.measured if name in self.stages)
        low, high = self.load.span(self.seconds - done, unsure=GUESS if self.caveat else 1.0)
        return done + low, done + high

    @property
    def seconds(self) -> float:
        """Predicted time of all stages [s]."""
        return sum(self.stages.values())

    def with_measured(self, name: str, seconds: float) -> Forecast:
        """Return the forecast, updated with the measured time [s] of a finished stage."""
        return replace(self, stages={name: seconds, **self.stages}, measured=(*self.measured, name))

    def with_predicted(self, name: str, seconds: float, caveat: str) -> Forecast:
        """Return the forecast with an additional first stage, whose time is not reliable.

        Args:
            name: Name of the stage.
            seconds: Predicted time of the stage [s].
            caveat: Reason why this time is not reliable.
        """
        caveats = " ".join(filter(None, (self.caveat, caveat)))
        return replace(self, stages={name: seconds, **self.stages}, caveat=caveats)

    def lines(self) -> list[str]:
        """Format the forecast as lines of text, one for each stage and then a summary."""
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
        """Return a note if a run on a GPU spends most of its time in stages that run on the CPU."""
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
        """Return the forecast as plain data for scripts."""
        return {**asdict(self), "seconds": self.seconds, "span": self.span}

    def compare(self, spent: Mapping[str, float]) -> dict[str, Any]:
        """Compare the predicted with the measured times `spent` [s], by stage and in total."""
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
    """The predicted time and error of a run for one position of the accuracy slider."""

    name: str
    seconds: float
    """Predicted time from the Gaussians to the finished files [s]."""
    promise: Promise
    """The error bound, or the reason why there is none."""
    pixels: float | None
    """The error bound in the video [pixels]; None if there is no bound."""
    caveat: str | None = None
    """Reason why the predicted time is not reliable, or None."""
    forecast: Forecast | None = None
    """The forecast of the time; None if no trial runs were made."""

    @classmethod
    def of(
        cls, scene: Scene, seconds: float, promise: Promise, forecast: Forecast | None = None
    ) -> Stop:
        """Return the position of the accuracy slider for a scene, with the scene's time and error.

        The scene must use one of the named accuracies.

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
        """Error bound as a fraction of the object's size; None if there is no bound."""
        return self.promise.error


@dataclass
class Forecaster:
    """Forecasts the times of runs on a device, and stores measurements for later forecasts."""

    context: RunContext = field(default_factory=RunContext)
    """Device and threads of the runs; progress and stopwatch are not used."""
    error: bool = True
    """Whether the forecasts include the time in which each run estimates its error."""
    _known: dict[Any, Any] = field(default_factory=dict, repr=False)
    _meter: LoadMeter = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._meter = LoadMeter(self.context.device)

    def forecast(self, gaussians: Gaussians, scene: Scene, *, crop: Crop = WHOLE) -> Forecast:
        """Forecast the time of a run: create the scene's particles, then make trial runs.

        Args:
            gaussians: The object.
            scene: The scene.
            crop: Rectangle of the object in the picture on which the masks of parts were painted.

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
            error: Whether this run will estimate its error. The forecast includes the time for this
                only if the forecaster's `error` is also set.
            load: Load by other programs; if None, the load is measured.
        """
        scene = simulation.scene
        pilot = self._pilot(simulation)
        rates, nodes, each_frame = probe(simulation, pilot)
        rest = substeps_at_rest(simulation.solver) / scene.time.fps if pilot.stages else None
        substeps, limiters = pilot.substeps(scene.resolution.cells, rest)
        mean_nodes = nodes * pilot.growth
        particles = len(simulation.setup.particles)
        per_substep = rates.particle * particles + rates.node * mean_nodes
        once, each_shape = time_shapes(simulation)
        stages = {
            "simulate": substeps * per_substep + scene.time.frames * each_frame,
            "deform": once + scene.time.frames * each_shape,
            **(self._filming(simulation.setup.shown, scene) if filming else {}),
        }
        cost = companion.forecast(simulation, substeps)
        wanted = error and self.error and scene.time.frames >= companion.FEWEST
        if wanted and cost <= companion.affordable(simulation):
            faster = speed_up(simulation.setup.threads) / speed_up(
                companion.count_threads(simulation.setup)
            )
            stages["companion"] = cost * faster * stages["simulate"]
            if pilot.stages:  # a companion run takes as long as a pilot run
                ratio = companion.coarsen(scene).resolution.cells / pilot.cells
                stages["companion"] = pilot.seconds * ratio**GROWTH
        return Forecast(
            stages,
            measured=(),
            particles=particles,
            nodes=round(mean_nodes),
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
        """Return the predicted time and the error bound for accuracies draft, standard and fine."""
        return {name: self._stop(name, gaussians, scene) for name in get_args(AccuracyName)}

    def _stop(self, name: AccuracyName, gaussians: Gaussians, scene: Scene) -> Stop:
        chosen = scene.model_copy(update={"accuracy": name})
        key = (id(gaussians), _physics(chosen))
        made: Forecast = self._remember(key, lambda: self.forecast(gaussians, chosen), gaussians)
        return Stop.of(chosen, made.seconds, promise(chosen, made.proportions), made)

    def _proportions(self, simulation: Simulation) -> Proportions | None:
        size = simulation.scene.object.size
        key = ("proportions", size, *_sample(simulation.setup.gaussians))
        return self._remember(key, lambda: simulation.setup.proportions)

    def _pilot(self, simulation: Simulation) -> Pilot:
        setup, scene = simulation.setup, simulation.scene
        gaussians, options = setup.source, {"crop": setup.crop, "placed": setup.placed}
        key = ("pilot", *_sample(setup.gaussians), _physics(coarsen(scene)), setup.crop)
        return self._remember(key, lambda: run_pilot(gaussians, scene, self.context, **options))

    def _filming(self, gaussians: Gaussians, scene: Scene) -> dict[str, float]:
        """Return the predicted times of rendering, encoding and saving [s]."""
        view = scene.view
        key = ("film", len(gaussians), view, scene.time.frames)
        return self._remember(key, lambda: time_film(gaussians, scene, self.context))

    def _remember(self, key: Any, make: Any, keep: Any = None) -> Any:
        """Return the stored value for a key; if the value is missing, compute and store it.

        If the key contains the `id` of a Python object, pass this object as `keep`. While the
        object is stored, no other object can get the same id.
        """
        if key not in self._known:
            while len(self._known) >= REMEMBERED:
                self._known.pop(next(iter(self._known)))
            self._known[key] = (make(), keep)
        return self._known[key][0]


def speed_up(threads: int) -> float:
    """Return the factor by which threads speed up the dynamics (docs/lab/benchmarks.md)."""
    return 1 + SPEED_UP * (threads - 1)


def _sample(gaussians: Gaussians) -> tuple[int, bytes]:
    """Return the number of Gaussians and a few positions, for use as a cache key."""
    return len(gaussians), gaussians.means[:: max(1, len(gaussians) // 64)].tobytes()


def pixels_per_size(scene: Scene) -> float:
    """Return the length of the object's longest side in the video [pixels]."""
    if scene.view.fits:
        return min(scene.view.size) / ROOM  # the size of an object at rest
    half_height = np.tan(np.radians(scene.view.fov / 2)) * scene.view.distance
    return float(min(scene.view.size) / (2 * half_height))


def _physics(scene: Scene) -> str:
    """Return, as JSON, the fields of a scene that determine the run's time."""
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
