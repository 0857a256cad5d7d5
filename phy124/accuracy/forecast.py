"""How long a run will take, before it runs.

    seconds = substeps * (a * particles + b * nodes) + frames * (shapes + views * pictures)

a and b come from probes of 20 substeps of the solver that will run, which is then reset to its
start; the number of substeps comes from a pilot (`phy124.accuracy.pilot`); shapes, pictures and
video from making a few. The seconds are only a guess if the particles' speed limits the substep.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, get_args

import numpy as np

from phy124.accuracy.load import Load, LoadMeter, format_span
from phy124.accuracy.pilot import Pilot, coarsen, run_pilot
from phy124.accuracy.probe import SubstepCost, probe, time_film, time_shapes
from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Gaussians
from phy124.rendering.nearest import ROOM
from phy124.runtime.context import RunContext
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import AccuracyName, Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.parts import WHOLE, Crop

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
        """The forecast with a stage that is finished and took so many seconds."""
        return replace(self, stages={name: seconds, **self.stages}, measured=(*self.measured, name))

    def with_predicted(self, name: str, seconds: float, caveat: str) -> Forecast:
        """The forecast with a stage before the others, and why they are only a guess."""
        caveats = " ".join(filter(None, (self.caveat, caveat)))
        return replace(self, stages={name: seconds, **self.stages}, caveat=caveats)

    def lines(self) -> list[str]:
        """The forecast as text, a line for each stage."""
        made = [
            f"  {name:<12}{seconds:8.2f} s{'  (measured)' if name in self.measured else ''}"
            for name, seconds in self.stages.items()
        ]
        limited = ", ".join(f"{name} {fraction:.0%}" for name, fraction in self.limiters.items())
        beside = " while this machine is busy" if self.load.busy else ""
        total = f"  {'total':<12}{self.seconds:8.2f} s, likely {format_span(self.span)}{beside}"
        about = (
            f"{self.particles} particles, {self.nodes} nodes, about {self.substeps} substeps "
            f"(limited by: {limited}), {1e9 * self.rates.particle:.0f} ns per particle and substep"
            f", about {self.memory / 1e9:.1f} GB"
        )
        return [*made, total, about, *([self.caveat] if self.caveat else [])]

    def data(self) -> dict[str, Any]:
        """Plain data for scripts."""
        return {**asdict(self), "seconds": self.seconds, "span": self.span}

    def compared(self, spent: Mapping[str, float]) -> dict[str, Any]:
        """Predicted and spent seconds and their ratio, by stage and in all, for the report."""
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
            "predicted": total, "spent": used, "ratio": _ratio(used, total), "stages": rows,
            "substeps": self.substeps, "limiters": self.limiters, "caveat": self.caveat,
            "span": self.span,
        }  # fmt: skip


@dataclass(frozen=True)
class Stop:
    """One stop of the accuracy slider."""

    name: str
    seconds: float
    """Predicted time from Gaussians to files [s]."""
    promise: Promise
    """The error measured for such scenes, or why none is promised."""
    pixels: float | None
    """The promised error in the video [pixels]."""
    caveat: str | None = None
    """Why the seconds are only a guess."""
    forecast: Forecast | None = None
    """The forecast behind them, if it was made for the object itself."""

    @classmethod
    def of(
        cls, scene: Scene, seconds: float, promise: Promise, forecast: Forecast | None = None
    ) -> Stop:
        """The stop of a scene with a named accuracy.

        Args:
            scene: The scene.
            seconds: Its predicted time [s].
            promise: Its promised error.
            forecast: The forecast behind the time, if there is one.
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
    """Makes forecasts on one device; remembers rates and pilots, so that a second one is fast."""

    device: str = "cpu"
    threads: int | None = None
    """CPU threads; None: as many as suit."""
    _known: dict[Any, Any] = field(default_factory=dict, repr=False)
    _meter: LoadMeter = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._meter = LoadMeter(self.device)

    def forecast(self, gaussians: Gaussians, scene: Scene, *, crop: Crop = WHOLE) -> Forecast:
        """The forecast of a run of a scene; makes its particles and a probe.

        Args:
            gaussians: The object.
            scene: The scene.
            crop: Where the object is in the picture that the masks of parts were painted on.

        Raises:
            InputError: As `Simulation` does.
        """
        watch = Stopwatch()
        simulation = Simulation(
            prepare(
                gaussians,
                scene,
                RunContext(device=self.device, watch=watch, threads=self.threads),
                crop=crop,
            )
        )
        made = self.of(simulation)
        return made.with_measured("particles", watch.seconds["particles"])

    def of(
        self, simulation: Simulation, *, filming: bool = True, load: Load | None = None
    ) -> Forecast:
        """The forecast of a simulation that has not started; its state does not change.

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
            stages, (), particles, round(mean_nodes), substeps, limiters, rates,
            simulation.setup.estimate.memory, _caveat(pilot, limiters), load or self._meter.load(),
            self._thickness(simulation),
        )  # fmt: skip

    def stops(self, gaussians: Gaussians, scene: Scene) -> dict[str, Stop]:
        """Time and promised error of draft, standard and fine."""
        return {name: self._stop(name, gaussians, scene) for name in get_args(AccuracyName)}

    def _stop(self, name: AccuracyName, gaussians: Gaussians, scene: Scene) -> Stop:
        chosen = scene.model_copy(update={"accuracy": name})
        key = (id(gaussians), _physics(chosen), self.device)
        made: Forecast = self._remember(key, lambda: self.forecast(gaussians, chosen), gaussians)
        return Stop.of(chosen, made.seconds, promise(chosen, made.thickness), made)

    def _thickness(self, simulation: Simulation) -> float | None:
        size = simulation.scene.object.size
        key = ("thickness", size, *_sample(simulation.setup.gaussians))
        return self._remember(key, lambda: simulation.setup.thickness)

    def _pilot(self, simulation: Simulation) -> Pilot:
        gaussians, scene, crop = simulation.setup.gaussians, simulation.scene, simulation.setup.crop
        key = ("pilot", *_sample(gaussians), _physics(coarsen(scene)), crop)
        return self._remember(
            key, lambda: run_pilot(gaussians, scene, device=self.device, crop=crop)
        )

    def _filming(self, gaussians: Gaussians, scene: Scene) -> dict[str, float]:
        """Times of pictures, videos and saving [s]."""
        view = scene.view
        key = ("film", len(gaussians), view, scene.time.frames)
        return self._remember(key, lambda: time_film(gaussians, scene, self.device, self.threads))

    def _remember(self, key: Any, make: Any, keep: Any = None) -> Any:
        """A value that is made once; `keep` keeps the object alive whose id is in the key."""
        if key not in self._known:
            while len(self._known) >= REMEMBERED:
                self._known.pop(next(iter(self._known)))
            self._known[key] = (make(), keep)
        return self._known[key][0]


def _sample(gaussians: Gaussians) -> tuple[int, bytes]:
    """Return the number of some Gaussians and a few of their positions, to recognise them."""
    return len(gaussians), gaussians.means[:: max(1, len(gaussians) // 64)].tobytes()


def pixels_per_size(scene: Scene) -> float:
    """Size of the object's longest side in the video [pixels]."""
    if scene.view.fits:
        return min(scene.view.size) / ROOM  # As large as an object that stays where it is.
    half_height = np.tan(np.radians(scene.view.fov / 2)) * scene.view.distance
    return float(min(scene.view.size) / (2 * half_height))


def _physics(scene: Scene) -> str:
    """Everything in a scene that its time depends on."""
    return scene.model_dump_json(exclude={"description", "seed"})


def _caveat(pilot: Pilot, limiters: Mapping[str, float]) -> str | None:
    if pilot.stopped:
        return "The motion is not stable on a coarse grid, so its length cannot be told."
    moving = sum(limiters.get(name, 0.0) for name in ("speed", "gradient"))
    if moving > UNSURE:
        return (
            f"For {moving:.0%} of the substeps the speed of the material, not its stiffness, sets "
            "their length, which differs from grid to grid: the seconds are only a guess."
        )
    return None


def _ratio(spent: float, predicted: float) -> float | None:
    return spent / predicted if predicted > 0 else None
