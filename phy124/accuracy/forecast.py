"""Forecasts the time of a run, before it runs, and measures the load by other programs.

    seconds = substeps * (a * particles + b * nodes) + frames * (shapes + views * pictures)

a and b come from probes of 20 substeps of the solver that will run, which is then reset to its
start; the number of substeps comes from a pilot (`phy124.accuracy.probe`); shapes, pictures and
video from making a few. The seconds are only a guess if the particles' speed limits the substep.
"""

from __future__ import annotations

import math
import threading
import time
import zlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import numpy as np

from phy124.accuracy.probe import (
    Pilot,
    SubstepCost,
    coarsen,
    probe,
    run_pilot,
    time_film,
    time_shapes,
)
from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.rendering.nearest import ROOM
from phy124.runtime.context import RunContext
from phy124.runtime.cores import cores
from phy124.scene import AccuracyName, Scene
from phy124.simulation import Simulation, prepare

SPIN = 0.3
"""Time for which threads spin to measure the fraction of a core that each gets [s]."""
ENOUGH, LONGEST = 0.2, 4.0
"""Smallest fraction of `SPIN` that a thread must run, and the longest duration as a multiple."""
BLOCK = bytes(1 << 18)
"""Data that a spinning thread reads without holding Python's global lock."""
ALONE = 0.93
"""Fraction of a core above which no other program uses it."""
SECOND_THREAD = 1.5
"""Factor on the time of a simulation that cannot use a second thread for lack of a free core."""
MINIMUM, MAXIMUM = 0.8, 1.5
"""Range of the time of runs relative to forecasts on an idle machine (docs/lab/forecasts.md)."""
BUSY = 1.2
"""Factor by which the range is wider on a busy machine, since the load changes during a run."""
FRESH = 10.0
"""Time for which a measurement is valid [s]."""


@dataclass(frozen=True)
class Load:
    """Factors by which work takes longer because of other programs on this machine."""

    thread: float = 1.0
    """Factor for the work of one thread."""
    simulation: float = 1.0
    """Factor for a simulation."""

    @classmethod
    def measure(cls, device: str = "cpu") -> Load:
        """Measure the load from the fraction of the cores that spinning threads get for a moment.

        It includes priorities, the limits of a container and how the system shares its cores, but
        not the past. Other work of this process counts as load. A run on a GPU is hardly affected.
        """
        if device != "cpu":
            return cls()
        fraction = _measure_fraction(1)
        thread = 1.0 if fraction > ALONE else 1 / fraction
        free = fraction > ALONE and (cores() == 1 or _measure_fraction(2) > ALONE)
        return cls(thread, thread if free else SECOND_THREAD * thread)

    def of(self, stage: str) -> float:
        """Return the factor for a stage of a run."""
        return self.simulation if stage == "simulate" else self.thread

    def mean(self, other: Load) -> Load:
        """Return the mean of two loads, for work between two measurements."""
        thread = (self.thread + other.thread) / 2
        return Load(thread, (self.simulation + other.simulation) / 2)

    @property
    def busy(self) -> bool:
        """Whether other programs are busy."""
        return self.simulation > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Return the shortest and longest time [s] of a run that takes `seconds` under this load.

        Programs that start or end during the run are not predicted.
        """
        wider = unsure * (BUSY if self.busy else 1.0)
        return MINIMUM / wider * seconds, MAXIMUM * wider * seconds


class LoadMeter:
    """Measures the load when it is needed and the last measurement is too old.

    A measurement takes 0.6 s of all cores.
    """

    def __init__(self, device: str = "cpu") -> None:
        """Measure nothing yet.

        Args:
            device: Warp device of the runs.
        """
        self.latest = Load()
        """The last measurement; before the first one, that of an idle machine."""
        self._device, self._measured = device, -math.inf
        self._measuring = threading.Lock()

    def load(self) -> Load:
        """Return the load, measured again if the last measurement is too old."""
        if time.monotonic() > self._measured + FRESH:
            self.measure()
        return self.latest

    def measure(self) -> Load:
        """Measure the load now."""
        with self._measuring:  # two simultaneous measurements would count each other as load
            self.latest = Load.measure(self._device)
            self._measured = time.monotonic()
            return self.latest


def format_span(span: tuple[float, float]) -> str:
    """Format a range of times [s]: "12 to 18 s", "1.5 to 2.3 min"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _measure_fraction(threads: int) -> float:
    """Return the mean fraction of a core that each of several spinning threads gets."""
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(_spin, [SPIN] * threads)) / threads


def _spin(seconds: float) -> float:
    """Return the fraction of a core that this thread gets while it spins for some seconds.

    It spins longer if it hardly ran in that time.
    """
    start, start_cpu, passed, ran = time.perf_counter(), time.thread_time(), 0.0, 0.0
    while passed < seconds or (ran < ENOUGH * seconds and passed < LONGEST * seconds):
        zlib.crc32(BLOCK)
        passed, ran = time.perf_counter() - start, time.thread_time() - start_cpu
    return max(ran, 1e-3) / passed


UNSURE = 0.1
"""Fraction of substeps limited by motion instead of stiffness above which there is no promise."""
GUESS = 1.14
"""Factor by which the range is wider if the seconds are a guess."""
QUIET = Load()
REMEMBERED = 32
"""Number of forecasts and measurements that are kept; the oldest is removed."""


@dataclass(frozen=True)
class Forecast:
    """The predicted time of a run, and what it consists of."""

    stages: dict[str, float]
    """Stage, named as in the report -> predicted time [s]."""
    measured: tuple[str, ...]
    """Stages that are finished and were measured instead."""
    particles: int
    nodes: int
    """Mean number of grid nodes."""
    substeps: int
    limiters: dict[str, float]
    """Limit of the substep -> fraction of the substeps."""
    rates: SubstepCost
    memory: float = 0.0
    """Approximate memory (`phy124.budget.limits`) [bytes]."""
    caveat: str | None = None
    """Why the seconds are only a guess."""
    load: Load = QUIET
    """Load by other programs on this machine when the probes ran."""
    thickness: float | None = None
    """Local thickness of the object relative to its size; None in scenes of several objects."""

    @property
    def span(self) -> tuple[float, float]:
        """Shortest and longest time expected [s]; a wide range if the seconds are a guess."""
        done = sum(self.stages[name] for name in self.measured if name in self.stages)
        low, high = self.load.span(self.seconds - done, unsure=GUESS if self.caveat else 1.0)
        return done + low, done + high

    @property
    def seconds(self) -> float:
        """Predicted time of all stages [s]."""
        return sum(self.stages.values())

    def with_measured(self, name: str, seconds: float) -> Forecast:
        """Add a finished stage and its measured time [s]."""
        return replace(self, stages={name: seconds, **self.stages}, measured=(*self.measured, name))

    def with_predicted(self, name: str, seconds: float, caveat: str) -> Forecast:
        """Add a first stage with a predicted time, and the reason why it is only a guess."""
        caveats = " ".join(filter(None, (self.caveat, caveat)))
        return replace(self, stages={name: seconds, **self.stages}, caveat=caveats)

    def lines(self) -> list[str]:
        """Format the forecast, a line for each stage."""
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
        return [*made, total, about, *([self.caveat] if self.caveat else [])]

    def data(self) -> dict[str, Any]:
        """Return plain data for scripts."""
        return {**asdict(self), "seconds": self.seconds, "span": self.span}

    def compare(self, spent: Mapping[str, float]) -> dict[str, Any]:
        """Compare predicted and spent seconds, by stage and in total, for the report."""
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
    """A position of the accuracy slider."""

    name: str
    seconds: float
    """Predicted time from Gaussians to files [s]."""
    promise: Promise
    """The promised error, or the reason why there is none."""
    pixels: float | None
    """The promised error in the video [pixels]."""
    caveat: str | None = None
    """Why the seconds are only a guess."""
    forecast: Forecast | None = None
    """The forecast of the seconds, if it was made for the object itself."""

    @classmethod
    def of(
        cls, scene: Scene, seconds: float, promise: Promise, forecast: Forecast | None = None
    ) -> Stop:
        """Return the accuracy level that a scene names.

        Args:
            scene: The scene.
            seconds: Predicted time [s].
            promise: Promised error.
            forecast: Forecast of the time, if there is one.
        """
        pixels = None if promise.error is None else promise.error * pixels_per_size(scene)
        caveat = forecast.caveat if forecast else None
        return cls(str(scene.accuracy), seconds, promise, pixels, caveat, forecast)

    @property
    def error(self) -> float | None:
        """Promised error as a fraction of the object's size; None if it was not measured."""
        return self.promise.error


@dataclass
class Forecaster:
    """Makes forecasts on a device; stores rates and pilots, so that later forecasts are fast."""

    context: RunContext = field(default_factory=RunContext)
    """Device and threads of the runs; nothing is reported."""
    _known: dict[Any, Any] = field(default_factory=dict, repr=False)
    _meter: LoadMeter = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._meter = LoadMeter(self.context.device)

    def forecast(self, gaussians: Gaussians, scene: Scene, *, crop: Crop = WHOLE) -> Forecast:
        """Forecast a run of a scene, by its particles and a probe.

        Args:
            gaussians: The object.
            scene: The scene.
            crop: Where the object is in the picture that the masks of parts were painted on.

        Raises:
            InputError: As `Simulation` does.
        """
        context = self.context.aside()
        simulation = Simulation(prepare(gaussians, scene, context, crop=crop))
        made = self.of(simulation)
        return made.with_measured("particles", context.watch.seconds["particles"])

    def of(
        self, simulation: Simulation, *, filming: bool = True, load: Load | None = None
    ) -> Forecast:
        """Forecast a simulation that has not started; its state does not change.

        Args:
            simulation: The simulation.
            filming: Whether it will be filmed.
            load: Load by other programs; None: it is measured.
        """
        scene = simulation.scene
        pilot = self._pilot(simulation)
        rates, nodes, each_frame = probe(simulation)
        substeps, limiters = pilot.substeps(scene.resolution.cells)
        mean_nodes = nodes * pilot.growth
        particles = len(simulation.setup.particles)
        per_substep = rates.particle * particles + rates.node * mean_nodes
        stages = {
            "simulate": substeps * per_substep + scene.time.frames * each_frame,
            "deform": scene.time.frames * time_shapes(simulation),
            **(self._filming(simulation.setup.shown, scene) if filming else {}),
        }
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
            thickness=self._thickness(simulation),
        )

    def stops(self, gaussians: Gaussians, scene: Scene) -> dict[str, Stop]:
        """Return time and promised error of draft, standard and fine."""
        return {name: self._stop(name, gaussians, scene) for name in get_args(AccuracyName)}

    def _stop(self, name: AccuracyName, gaussians: Gaussians, scene: Scene) -> Stop:
        chosen = scene.model_copy(update={"accuracy": name})
        key = (id(gaussians), _physics(chosen))
        made: Forecast = self._remember(key, lambda: self.forecast(gaussians, chosen), gaussians)
        return Stop.of(chosen, made.seconds, promise(chosen, made.thickness), made)

    def _thickness(self, simulation: Simulation) -> float | None:
        size = simulation.scene.object.size
        key = ("thickness", size, *_sample(simulation.setup.gaussians))
        return self._remember(key, lambda: simulation.setup.thickness)

    def _pilot(self, simulation: Simulation) -> Pilot:
        gaussians, scene, crop = simulation.setup.gaussians, simulation.scene, simulation.setup.crop
        key = ("pilot", *_sample(gaussians), _physics(coarsen(scene)), crop)
        return self._remember(key, lambda: run_pilot(gaussians, scene, self.context, crop=crop))

    def _filming(self, gaussians: Gaussians, scene: Scene) -> dict[str, float]:
        """Return the times of pictures, videos and saving [s]."""
        view = scene.view
        key = ("film", len(gaussians), view, scene.time.frames)
        return self._remember(key, lambda: time_film(gaussians, scene, self.context))

    def _remember(self, key: Any, make: Any, keep: Any = None) -> Any:
        """Return a value that is computed once; `keep` is an object whose id is in the key."""
        if key not in self._known:
            while len(self._known) >= REMEMBERED:
                self._known.pop(next(iter(self._known)))
            self._known[key] = (make(), keep)
        return self._known[key][0]


def _sample(gaussians: Gaussians) -> tuple[int, bytes]:
    """Return the number of some Gaussians and a few of their positions, to recognise them."""
    return len(gaussians), gaussians.means[:: max(1, len(gaussians) // 64)].tobytes()


def pixels_per_size(scene: Scene) -> float:
    """Return the size of the object's longest side in the video [pixels]."""
    if scene.view.fits:
        return min(scene.view.size) / ROOM  # the size of an object at rest
    half_height = np.tan(np.radians(scene.view.fov / 2)) * scene.view.distance
    return float(min(scene.view.size) / (2 * half_height))


def _physics(scene: Scene) -> str:
    """Return everything in a scene that its time depends on."""
    return scene.model_dump_json(exclude={"description", "seed"})


def _caveat(pilot: Pilot, limiters: Mapping[str, float]) -> str | None:
    if pilot.stopped:
        return "The motion is not stable on a coarse grid, so its duration cannot be determined."
    moving = sum(limiters.get(name, 0.0) for name in ("speed", "gradient"))
    if moving > UNSURE:
        return (
            f"The speed of the material, not its stiffness, limits {moving:.0%} of the substeps. "
            "This differs between grids, so the seconds are only a guess."
        )
    return None


def _ratio(spent: float, predicted: float) -> float | None:
    return spent / predicted if predicted > 0 else None
