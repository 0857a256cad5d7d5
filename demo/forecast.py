"""How long a run will take and what its accuracy promises, said before it starts.

How much there is to do is in phy124/cost.py; what a particle-substep, a drawn pixel and so on
cost on this machine is learned in demo/rates.py.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from phy124.accuracy import Forecaster, Stop
from phy124.accuracy.forecast import GUESS, QUIET
from phy124.accuracy.load import Load, spoken
from phy124.accuracy.promises import Promise, promise, why_broken
from phy124.cost import GAUSSIANS, Rates, Work, count_particles
from phy124.gaussians import Gaussians
from phy124.limits import duration
from phy124.scene import PRESETS, Scene

from .rates import Learned
from .studies import Measurement, on_grid

Measured = tuple[dict[str, Any], Scene]
"""Report and scene of a finished run."""
FRESH = 3.0
"""Seconds for which a look at what others do is good."""
SET_UP = 0.4
"""Seconds to set up one grid of a study and compare its motion, in those of `rest`."""


@dataclass(frozen=True)
class Estimate:
    """What a run is expected to be."""

    seconds: float
    substeps: int
    particles: int
    promise: Promise
    """The error that was measured for such scenes, or why none is promised."""
    caveat: str | None = None
    """Why the seconds are no promise."""
    load: Load = QUIET
    """What others do on this machine at the moment."""
    measured: bool = False
    """Whether it comes from a probe of this very object."""
    compiling: float = 0.0
    """Seconds of these until the kernels are compiled, which is done once."""

    @property
    def span(self) -> tuple[float, float]:
        """Between what seconds the run will lie."""
        unsure = 1.0 if self.measured and not self.caveat else GUESS
        return self.load.span(self.seconds, unsure=unsure)

    @property
    def sentence(self) -> str:
        """For the visitor."""
        beside = " beside what else this machine does" if self.load.busy else ""
        text = f"About {spoken(self.span)}{beside}: {self.substeps:,} substeps of "
        text += f"{round(self.particles, -3):,} particles. {self.promise.brief}"
        if self.load.busy:
            slower = f"{self.load.simulation:.1f} times as long"
            text += f" Others here make its motion take {slower}, as things are;"
            text += " who ends or begins meanwhile is not foreseen."
        if self.compiling > 0:
            text += f" The first run of this kind compiles for about {duration(self.compiling)}."
        return f"{text} {self.caveat}" if self.caveat else text


class Estimator:
    """Predicts runs and learns from the reports of finished ones."""

    def __init__(self, occupied: Callable[[], bool] = lambda: False) -> None:
        self.learned = Learned()
        self._occupied = occupied
        self._load, self._looked = QUIET, -math.inf
        self._looking = threading.Lock()

    @property
    def rates(self) -> Rates:
        """What the stages cost now."""
        return self.learned.now

    def __call__(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        generated: bool = False,
        simulated: bool = False,
        filmed: bool = False,
        compiling: float = 0.0,
    ) -> Estimate:
        """The forecast of a run; `generated` and so on: these stages are there already.

        `compiling` are the seconds, alone on this machine, until the kernels are there.
        """
        work, load = Work.of(scene, gaussians), self.load()
        costs = self.rates.seconds(work) | {"rest": self.rates.rest, "compile": compiling}
        done = {
            "generate": generated or simulated, "simulate": simulated, "deform": simulated,
            "compile": simulated, "film": filmed, "rest": filmed,
        }  # fmt: skip
        seconds = {name: cost * load.of(name) for name, cost in costs.items() if not done[name]}
        return Estimate(
            sum(seconds.values()), round(work.substeps), count_particles(scene, gaussians),
            promise(scene), load=load, compiling=seconds.get("compile", 0.0),
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
        """Seconds of measuring a scene's error on these grids."""
        costs = [self.rates.seconds(Work.of(on_grid(scene, n), gaussians)) for n in levels]
        simulate, deform = (sum(cost[name] for cost in costs) for name in ("simulate", "deform"))
        rest = len(levels) * self.rates.rest * SET_UP + compiling
        generate, load = 0.0 if generated else self.rates.generate, self.load()
        return simulate * load.simulation + (deform + rest + generate) * load.thread

    def load(self) -> Load:
        """What others do on this machine, looked at anew every few seconds.

        While a run of our own is in hand they cannot be told from it: the last look counts.
        """
        if time.monotonic() > self._looked + FRESH and not self._occupied():
            self.look()
        return self._load

    def look(self) -> Load:
        """What others do on this machine now."""
        with self._looking:  # Two at once would take each other for others.
            self._load = Load.measured()
            self._looked = time.monotonic()
            return self._load

    def calibrate(self, small: Callable[[], Measured], usual: Callable[[], Measured]) -> None:
        """Measure the rates by two runs, less what others made them take longer."""
        self.learned.calibrate(self._alone(small), self._alone(usual))

    def _alone(self, run: Callable[[], Measured]) -> Measured:
        """A run done now, as it would have been without others."""
        before = self.look()
        report, scene = run()
        return _alone(report, before.mean(self.look())), scene

    def learn(self, report: dict[str, Any], scene: Scene, before: Load) -> None:
        """Correct the rates by a run just finished, less what others made it take longer."""
        self.learned.learn(_alone(report, before.mean(self.look())), scene)

    def minimum(self, scene: Scene, *, gaussians: int = GAUSSIANS) -> float:
        """Seconds of computing, were this machine as quick as it was ever known to be."""
        return sum(self.learned.minimum.seconds(Work.of(scene, gaussians)).values())

    def min_study(
        self, scene: Scene, levels: Sequence[int], *, gaussians: int = GAUSSIANS
    ) -> float:
        """Seconds of computing, at best, to measure a scene's error on these grids."""
        works = [Work.of(on_grid(scene, n), gaussians) for n in levels]
        return sum(self.learned.minimum.seconds(work)["simulate"] for work in works)

    def stops(
        self,
        scene: Scene,
        *,
        gaussians: int = GAUSSIANS,
        seconds: float | None = None,
        study: Measurement | None = None,
    ) -> list[Stop]:
        """All named accuracies for a scene.

        `seconds` were measured for the one it has, `study` on this very scene.
        """
        scale = 1.0 if seconds is None else seconds / self(scene, gaussians=gaussians).seconds
        found = []
        for name in PRESETS:
            other = scene.model_copy(update={"accuracy": name})
            took = scale * self(other, gaussians=gaussians).seconds
            found.append(Stop.of(other, took, promise_of(other, study)))
        return found


def _alone(report: dict[str, Any], load: Load) -> dict[str, Any]:
    """The report as it would be without a load."""
    stages = [
        {**stage, "seconds": stage["seconds"] / load.of(stage["name"])}
        for stage in report["stages"]
    ]
    return {**report, "stages": stages}


def measured(gaussians: Gaussians, scene: Scene, device: str, rest: float) -> Estimate:
    """The forecast of `phy124.accuracy`, from a probe of this very object; takes half a second."""
    found = Forecaster(device).forecast(gaussians, scene)
    seconds = found.seconds + rest
    return Estimate(
        seconds, found.substeps, found.particles, promise(scene), found.caveat, found.load,
        measured=True,
    )  # fmt: skip


def promise_of(
    scene: Scene, study: Measurement | None, report: Mapping[str, Any] | None = None
) -> Promise:
    """What may be promised of a scene: what was measured on it, else on such scenes.

    With the report of its run, what may still be said.
    """
    if study is None or why_broken(report or {}):
        return promise(scene, report)
    return study.promise(scene.resolution.cells)


def stops_table(stops: list[Stop], chosen: object) -> str:
    """What each stop of the accuracy slider would take and be off by, as HTML."""
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
