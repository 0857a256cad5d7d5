"""Predict the time and the error bound of a run before the run starts.

phy124/budget/cost.py computes the work of a run; demo/rates.py measures the time per unit of work.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

from phy124.accuracy import Forecaster, Stop
from phy124.accuracy.expectation import UNKNOWN
from phy124.accuracy.forecast import GUESS
from phy124.accuracy.load import QUIET, Load, LoadMeter, format_span
from phy124.accuracy.promises import Promise, promise, why_broken
from phy124.budget.cost import GAUSSIANS, Rates, Work, count_particles
from phy124.budget.limits import duration
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.particles.thickness import Proportions
from phy124.runtime.context import RunContext
from phy124.scene import PRESETS, Scene
from phy124.scene.lattices import choose_solver

from .course import Course
from .rates import Learned
from .studies import Measurement, on_grid

Measured = tuple[dict[str, Any], Scene]
"""Report and scene of a finished run."""
SET_UP = 0.4
"""Time to prepare one grid of an error study and to compare the result, divided by `Rates.rest`."""


@dataclass(frozen=True)
class Estimate:
    """The predicted time and the error bound of a run."""

    seconds: float
    """Predicted time at the present machine load [s]."""
    substeps: int
    particles: int
    promise: Promise
    """Error bound measured in similar scenes, or the reason why there is no error bound."""
    caveat: str | None = None
    """Reason why the predicted time is uncertain, or None."""
    load: Load = QUIET
    """Load by other programs on this machine."""
    measured: bool = False
    """Whether the time was measured in a short trial run with this object."""
    proportions: Proportions | None = None
    """Proportions of the object; None if no trial run was made."""
    compiling: float = 0.0
    """Time to compile missing kernels [s]."""
    unloaded: float = 0.0
    """Predicted time without load from other programs [s]; 0 if unknown."""
    after: float = 0.0
    """Predicted time of the stages after the simulation, which is a part of `seconds` [s]."""
    course: Course | None = None
    """Predicted course of the run under the page's time limit; None if no limit is known."""
    accuracy: object = None
    """Accuracy of the scene; a named accuracy is a string."""
    stops: Sequence[Stop] = ()
    """Time and error of the scene at each named accuracy."""
    study: Measurement | None = None
    """Errors measured on this scene; None if none were measured."""
    study_seconds: float | None = None
    """Predicted time to measure the error of the scene [s]; None if the error is known."""

    @property
    def span(self) -> tuple[float, float]:
        """Shortest and longest time expected for the run [s]."""
        unsure = 1.0 if self.measured and not self.caveat else GUESS
        return self.load.span(self.seconds, unsure=unsure)

    @property
    def sentence(self) -> str:
        """The forecast as a message for the visitor."""
        busy = " while this machine is busy" if self.load.busy else ""
        text = f"About {format_span(self.span)}{busy}: {self.substeps:,} substeps of "
        text += f"{round(self.particles, -3):,} particles."
        if self.promise.unmeasured != UNKNOWN:
            text += f" {self.promise.brief}"
        if self.load.busy:
            slower = f"{self.load.simulation:.1f} times as long"
            text += f" Other programs on this machine make the motion take {slower} at present;"
            text += " changes of this load are not predicted."
        if self.compiling > 0:
            text += f" The first run of this kind compiles for about {duration(self.compiling)}."
        return f"{text} {self.caveat}" if self.caveat else text


class Estimator:
    """Predicts the time of runs, and learns from the reports of finished runs."""

    def __init__(self, occupied: Callable[[], bool] = lambda: False) -> None:
        self.learned = Learned()
        self._occupied = occupied
        self.meter = LoadMeter()

    @property
    def rates(self) -> Rates:
        """Time that each stage of a run takes per unit of work on this machine."""
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
        network: float = 0.0,
        compiling: float = 0.0,
    ) -> Estimate:
        """Predict the time and the error bound of a run.

        Args:
            scene: The scene.
            gaussians: Number of Gaussians.
            generated: Whether the Gaussians exist already.
            simulated: Whether the clip exists already.
            filmed: Whether the videos exist already.
            pictures: Number of pictures from which Gaussians are generated.
            composed: Number of pixels of the video that shows the object in its photograph.
            network: Time of the generator's network under the current load [s].
            compiling: Time to compile missing kernels on an idle machine [s].
        """
        work, load = Work.of(scene, gaussians), self.load()
        work = replace(work, pixels=work.pixels + composed)
        costs = self.rates.seconds(work) | {"rest": self.rates.rest, "compile": compiling}
        costs["generate"] *= pictures
        done = dict.fromkeys(("simulate", "deform", "compile"), simulated)
        done |= {"generate": generated or simulated, "film": filmed, "rest": filmed}
        costs = {name: cost for name, cost in costs.items() if not done[name]}
        seconds = {name: cost * load.of(name) for name, cost in costs.items()}
        network = 0.0 if done["generate"] else network
        return Estimate(
            sum(seconds.values()) + network,
            round(work.substeps),
            count_particles(scene, gaussians),
            promise(scene, None),
            load=load,
            compiling=seconds.get("compile", 0.0),
            unloaded=sum(costs.values()) + network,
            after=seconds.get("film", 0.0) + seconds.get("rest", 0.0),
        )

    def study(
        self,
        scene: Scene,
        levels: Sequence[int],
        *,
        gaussians: int = GAUSSIANS,
        generated: bool = False,
        compiling: float = 0.0,
    ) -> float:
        """Predict the time to measure a scene's error on several grids [s].

        Args:
            scene: The scene.
            levels: Number of cells across the object, for each grid.
            gaussians: Number of Gaussians.
            generated: Whether the Gaussians exist already.
            compiling: Time to compile missing kernels on an idle machine [s].
        """
        costs = [self.rates.seconds(Work.of(on_grid(scene, n), gaussians)) for n in levels]
        simulate, deform = (sum(cost[name] for cost in costs) for name in ("simulate", "deform"))
        rest = len(levels) * self.rates.rest * SET_UP + compiling
        generate, load = 0.0 if generated else self.rates.generate, self.load()
        return simulate * load.simulation + (deform + rest + generate) * load.thread

    def load(self) -> Load:
        """Return the load from other programs on this machine, measured every few seconds.

        During a run, the last measurement is returned, because a new one would include the run.
        """
        return self.meter.latest if self._occupied() else self.meter.load()

    def calibrate(self, small: Callable[[], Measured], usual: Callable[[], Measured]) -> None:
        """Measure by two runs how long each stage takes per unit of work on this machine.

        The times are corrected for the load from other programs.
        """
        self.learned.calibrate(self._alone(small), self._alone(usual))

    def _alone(self, run: Callable[[], Measured]) -> Measured:
        before = self.meter.measure()
        report, scene = run()
        return _alone(report, before.mean(self.meter.measure())), scene

    def learn(self, report: dict[str, Any], scene: Scene, before: Load) -> None:
        """Correct the predicted time per unit of work by the times of a finished run.

        `before` is the load from other programs when the run started.
        """
        self.learned.learn(_alone(report, before.mean(self.meter.measure())), scene)

    def minimum(self, scene: Scene, *, gaussians: int = GAUSSIANS) -> float:
        """Return the shortest plausible time of a run, from the smallest known costs [s]."""
        return sum(self.learned.minimum.seconds(Work.of(scene, gaussians)).values())

    def min_study(
        self, scene: Scene, levels: Sequence[int], *, gaussians: int = GAUSSIANS
    ) -> float:
        """Return the shortest plausible time of an error study on several grids [s]."""
        works = [Work.of(on_grid(scene, n), gaussians) for n in levels]
        return sum(self.learned.minimum.seconds(work)["simulate"] for work in works)

    def stops(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        proportions: Proportions | None = None,
        seconds: float | None = None,
        study: Measurement | None = None,
    ) -> list[Stop]:
        """Return the predicted time and the error bound of a scene at each named accuracy.

        Args:
            scene: The scene.
            gaussians: Number of Gaussians.
            proportions: Proportions of the object; None if they are unknown.
            seconds: Time measured at the accuracy of the scene [s]; None if it was not measured.
            study: Errors measured on this scene; None if none were measured.
        """
        scale = 1.0 if seconds is None else seconds / self(scene, gaussians=gaussians).seconds
        stops = []
        for name in PRESETS:
            other = scene.model_copy(update={"accuracy": name})
            took = scale * self(other, gaussians=gaussians).seconds
            stops.append(Stop.of(other, took, promise_of(other, proportions, study)))
        return stops


def _alone(report: dict[str, Any], load: Load) -> dict[str, Any]:
    stages = [
        {**stage, "seconds": stage["seconds"] / load.of(stage["name"])}
        for stage in report["stages"]
    ]
    return {**report, "stages": stages}


def probe_estimate(
    gaussians: Gaussians, scene: Scene, context: RunContext, rest: float, crop: Crop = WHOLE
) -> Estimate:
    """Predict the time of a run by a trial run with the object; the trial takes half a second.

    Args:
        gaussians: The object.
        scene: The scene.
        context: Device and number of threads.
        rest: Predicted time of all other stages [s].
        crop: Position of the object in the picture on which the masks of parts were painted.
    """
    probe = Forecaster(context).forecast(gaussians, scene, crop=crop)
    films = sum(probe.stages.get(name, 0.0) for name in ("render", "shine", "encode"))
    return Estimate(
        probe.seconds + rest,
        probe.substeps,
        probe.particles,
        promise(choose_solver(scene, context.device), probe.proportions),
        probe.caveat,
        probe.load,
        measured=True,
        proportions=probe.proportions,
        after=films + rest,
    )


def promise_of(
    scene: Scene,
    proportions: Proportions | None,
    study: Measurement | None,
    report: Mapping[str, Any] | None = None,
) -> Promise:
    """Return the error bound of a scene.

    Args:
        scene: The scene.
        proportions: Proportions of the object; None if they are unknown.
        study: Errors measured on this scene. If None, errors of similar scenes are used.
        report: Report of the scene's run, which may state that no error bound holds.
    """
    if study is None or why_broken(report or {}):
        return promise(scene, proportions, report)
    return study.promise(scene.resolution.cells)


def describe_error(promise: Promise, subject: str = "It is off") -> str:
    """Describe the error of a motion in a sentence, such as "It is off by at most 2 % of ..."."""
    if promise.unmeasured == UNKNOWN:
        return "Its error is known after the first run."
    if promise.error is None:
        return _NOT_MEASURED if promise.unmeasured else _NOT_KNOWN
    until = "" if promise.seconds is None else f", until {promise.seconds:.1f} s"
    return f"{subject} by {promise.size('its size')}{until}."


_NOT_MEASURED = "Its error has not been measured."
_NOT_KNOWN = "Its error is not known."


def stops_table(stops: Sequence[Stop], chosen: object) -> str:
    """Format the time and the error at each position of the accuracy slider as an HTML table."""
    mark = {chosen: " class=chosen"}
    rows = [
        f"<tr{mark.get(stop.name, '')}><td>{escape(stop.name.capitalize())}</td>"
        f"<td>about {format_seconds(stop.seconds)}</td>"
        f"<td>{'' if stop.promise.unmeasured == UNKNOWN else stop.promise.off(stop.pixels)}</td>"
        "</tr>"
        for stop in stops
    ]
    return f'<table class="stops">{"".join(rows)}</table>'


def format_seconds(seconds: float) -> str:
    """Format a time: "4 s", "1.5 min"."""
    if seconds < 90:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.1f} min" if seconds < 3600 else f"{seconds / 3600:.1f} h"
