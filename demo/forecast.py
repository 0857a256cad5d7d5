"""How long a run will take and what error is promised, told before it starts.

phy124/budget/cost.py says how much work a run is; demo/rates.py learns what a particle and substep,
a drawn pixel and so on cost on this machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

from phy124.accuracy import Forecaster, Stop
from phy124.accuracy.forecast import GUESS, QUIET
from phy124.accuracy.load import Load, LoadMeter, format_span
from phy124.accuracy.promises import Promise, promise, why_broken
from phy124.budget.cost import GAUSSIANS, Rates, Work, count_particles
from phy124.budget.limits import duration
from phy124.gaussians import Gaussians
from phy124.scene import PRESETS, Scene

from .rates import Learned
from .studies import Measurement, on_grid

Measured = tuple[dict[str, Any], Scene]
"""Report and scene of a finished run."""
SET_UP = 0.4
"""Time to set up one grid of a study and to compare its motion, relative to that of `rest`."""


@dataclass(frozen=True)
class Estimate:
    """What a run is expected to take, and the error it promises."""

    seconds: float
    substeps: int
    particles: int
    promise: Promise
    """The error that was measured for such scenes, or why none is promised."""
    caveat: str | None = None
    """Why the seconds are uncertain."""
    load: Load = QUIET
    """How busy other programs keep this machine."""
    measured: bool = False
    """Whether it comes from a probe of this object."""
    thickness: float | None = None
    """Local thickness of the object relative to its size, if it was probed."""
    compiling: float = 0.0
    """The part of the seconds in which kernels are compiled, which is done once."""

    @property
    def span(self) -> tuple[float, float]:
        """Shortest and longest time expected for the run [s]."""
        unsure = 1.0 if self.measured and not self.caveat else GUESS
        return self.load.span(self.seconds, unsure=unsure)

    @property
    def sentence(self) -> str:
        """The estimate in words, for the visitor."""
        beside = " while this machine is busy" if self.load.busy else ""
        text = f"About {format_span(self.span)}{beside}: {self.substeps:,} substeps of "
        text += f"{round(self.particles, -3):,} particles. {self.promise.brief}"
        if self.load.busy:
            slower = f"{self.load.simulation:.1f} times as long"
            text += f" Other work on this machine makes the motion take {slower} at present;"
            text += " what ends or starts meanwhile is not predicted."
        if self.compiling > 0:
            text += f" The first run of this kind compiles for about {duration(self.compiling)}."
        return f"{text} {self.caveat}" if self.caveat else text


class Estimator:
    """Predicts runs and learns from the reports of finished ones."""

    def __init__(self, occupied: Callable[[], bool] = lambda: False) -> None:
        self.learned = Learned()
        self._occupied = occupied
        self.meter = LoadMeter()

    @property
    def rates(self) -> Rates:
        """The current costs of the stages."""
        return self.learned.now

    def __call__(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        generated: bool = False,
        simulated: bool = False,
        filmed: bool = False,
        pictures: int = 1,
        composed: float = 0.0,
        compiling: float = 0.0,
    ) -> Estimate:
        """The forecast of a run.

        Args:
            scene: The scene.
            gaussians: Number of Gaussians.
            generated: Whether the Gaussians exist already.
            simulated: Whether the clip exists already.
            filmed: Whether the films exist already.
            pictures: Number of pictures of which Gaussians are made.
            composed: Pixels drawn for the film in the photograph.
            compiling: Time until the kernels are compiled if nothing else runs [s].
        """
        work, load = Work.of(scene, gaussians), self.load()
        work = replace(work, pixels=work.pixels + composed)
        costs = self.rates.seconds(work) | {"rest": self.rates.rest, "compile": compiling}
        costs["generate"] *= pictures
        done = {
            "generate": generated or simulated, "simulate": simulated, "deform": simulated,
            "compile": simulated, "film": filmed, "rest": filmed,
        }  # fmt: skip
        seconds = {name: cost * load.of(name) for name, cost in costs.items() if not done[name]}
        return Estimate(
            sum(seconds.values()), round(work.substeps), count_particles(scene, gaussians),
            promise(scene, None), load=load, compiling=seconds.get("compile", 0.0),
        )  # fmt: skip

    def study(
        self,
        scene: Scene,
        levels: Sequence[int],
        *,
        gaussians: int = GAUSSIANS,
        generated: bool = False,
        compiling: float = 0.0,
    ) -> float:
        """Time to measure a scene's error on some grids [s].

        Args:
            scene: The scene.
            levels: Cells across the object of each grid.
            gaussians: Number of Gaussians.
            generated: Whether the Gaussians exist already.
            compiling: Time until the kernels are compiled if nothing else runs [s].
        """
        costs = [self.rates.seconds(Work.of(on_grid(scene, n), gaussians)) for n in levels]
        simulate, deform = (sum(cost[name] for cost in costs) for name in ("simulate", "deform"))
        rest = len(levels) * self.rates.rest * SET_UP + compiling
        generate, load = 0.0 if generated else self.rates.generate, self.load()
        return simulate * load.simulation + (deform + rest + generate) * load.thread

    def load(self) -> Load:
        """The load by other programs on this machine, measured again every few seconds.

        While a run of this page is in progress it cannot be told from others, so the last
        measurement is used.
        """
        return self.meter.latest if self._occupied() else self.meter.load()

    def calibrate(self, small: Callable[[], Measured], usual: Callable[[], Measured]) -> None:
        """Measure the rates by two runs, corrected for the load by other programs."""
        self.learned.calibrate(self._alone(small), self._alone(usual))

    def _alone(self, run: Callable[[], Measured]) -> Measured:
        """A run done now, with its times as they would be without other programs."""
        before = self.meter.measure()
        report, scene = run()
        return _alone(report, before.mean(self.meter.measure())), scene

    def learn(self, report: dict[str, Any], scene: Scene, before: Load) -> None:
        """Correct the rates by a run just finished, which had the load `before`."""
        self.learned.learn(_alone(report, before.mean(self.meter.measure())), scene)

    def minimum(self, scene: Scene, *, gaussians: int = GAUSSIANS) -> float:
        """Time of a run [s] if this machine is as fast as it has ever been."""
        return sum(self.learned.minimum.seconds(Work.of(scene, gaussians)).values())

    def min_study(
        self, scene: Scene, levels: Sequence[int], *, gaussians: int = GAUSSIANS
    ) -> float:
        """Time to measure a scene's error on these grids [s] if this machine is at its fastest."""
        works = [Work.of(on_grid(scene, n), gaussians) for n in levels]
        return sum(self.learned.minimum.seconds(work)["simulate"] for work in works)

    def stops(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        thickness: float | None = None,
        seconds: float | None = None,
        study: Measurement | None = None,
    ) -> list[Stop]:
        """Time and error of all named accuracies for a scene.

        Args:
            scene: The scene.
            gaussians: Number of Gaussians.
            thickness: Local thickness of the object relative to its size, if it is known.
            seconds: Time measured for the scene's own accuracy [s], if it was.
            study: The errors measured on this scene, if they were.
        """
        scale = 1.0 if seconds is None else seconds / self(scene, gaussians=gaussians).seconds
        found = []
        for name in PRESETS:
            other = scene.model_copy(update={"accuracy": name})
            took = scale * self(other, gaussians=gaussians).seconds
            found.append(Stop.of(other, took, promise_of(other, thickness, study)))
        return found


def _alone(report: dict[str, Any], load: Load) -> dict[str, Any]:
    """The report with its times as they would be without the load."""
    stages = [
        {**stage, "seconds": stage["seconds"] / load.of(stage["name"])}
        for stage in report["stages"]
    ]
    return {**report, "stages": stages}


def measured(gaussians: Gaussians, scene: Scene, device: str, rest: float) -> Estimate:
    """The forecast of `phy124.accuracy`, from a probe of this object; takes half a second.

    Args:
        gaussians: The object.
        scene: The scene.
        device: Warp device.
        rest: Time of all other stages [s].
    """
    found = Forecaster(device).forecast(gaussians, scene)
    seconds = found.seconds + rest
    return Estimate(
        seconds, found.substeps, found.particles, promise(scene, found.thickness), found.caveat,
        found.load, measured=True, thickness=found.thickness,
    )  # fmt: skip


def promise_of(
    scene: Scene,
    thickness: float | None,
    study: Measurement | None,
    report: Mapping[str, Any] | None = None,
) -> Promise:
    """The error that may be promised for a scene.

    Args:
        scene: The scene.
        thickness: Local thickness of the object relative to its size, if it is known.
        study: The errors measured on this scene; None: those measured on such scenes are used.
        report: The report of its run, which may rule a promise out.
    """
    if study is None or why_broken(report or {}):
        return promise(scene, thickness, report)
    return study.promise(scene.resolution.cells)


def stops_table(stops: list[Stop], chosen: object) -> str:
    """Time and error of each stop of the accuracy slider, as an HTML table."""
    mark = {chosen: " class=chosen"}
    rows = [
        f"<tr{mark.get(stop.name, '')}><td>{escape(stop.name.capitalize())}</td>"
        f"<td>about {_duration(stop.seconds)}</td>"
        f"<td>{stop.promise.off(stop.pixels)}</td></tr>"
        for stop in stops
    ]
    return f'<table class="stops">{"".join(rows)}</table>'


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.1f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"
