"""Runs one scene with several settings, and measures the time and the error of each setting.

A level differs from the scene only in its grid spacing. The results of all levels are extrapolated
to zero spacing with the observed order (Richardson). The error of a setting is its distance from
this extrapolation plus the extrapolation's uncertainty. If the motions diverge at some time, the
errors describe only the motion up to that time.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from phy124.accuracy.companion import with_own_error
from phy124.accuracy.convergence import Convergence, distances, longest_convergence
from phy124.accuracy.difference import difference
from phy124.accuracy.forecast import Forecaster, pixels_per_size
from phy124.accuracy.load import QUIET
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip
from phy124.monitor.dissipation import Loss, split_seconds
from phy124.monitor.tearing import Tearing
from phy124.monitor.watchdog import Watchdog
from phy124.particles.thickness import Proportions
from phy124.progress import Progress
from phy124.runtime.context import RunContext
from phy124.runtime.failures import failure, is_stop
from phy124.scene import Accuracy, Scene
from phy124.scene.lattices import choose_solver
from phy124.simulation import Simulation, Stopped, prepare
from phy124.studies.validation.accuracy.report import Report, Row, kept_promises, recommend

LEVELS = (16, 24, 32, 48)
"""Cells across the object in each level; the levels include the grids of all presets."""
MIN_PARTICLES_PER_AXIS = 1.5
"""Smallest number of particles per cell and axis with which finer grids are more accurate."""
VARIED = 24
"""Cells across the object in the settings that vary other options."""
SIZE = 256
"""Maximum width and height of the compared videos [pixels]."""


@dataclass
class Study:
    """Runs one scene with several settings, all with the same Gaussians."""

    gaussians: Gaussians
    scene: Scene
    context: RunContext = field(default_factory=RunContext)
    """Device, threads and progress.

    Progress is called with ("study", index of the setting, number of settings). It may raise
    Cancelled, which ends the study, or Stopped, which skips the setting.
    """
    levels: tuple[int, ...] = LEVELS
    crop: Crop = WHOLE
    thorough: bool = True
    """Whether to vary other options, forecast each setting and compare videos as well. The study
    then takes three times as long.
    """
    on_row: Callable[[Row], None] = lambda row: None
    """Function called with the row of each finished setting, before the errors are known."""
    keep: bool = False
    """Whether finished settings are evaluated if the study ends early."""
    ended: Exception | None = field(default=None, init=False)
    """The exception that ended the study early, if finished settings were kept."""
    clips: dict[str, Clip] = field(default_factory=dict, repr=False)
    _forecaster: Forecaster = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.scene = choose_solver(self.scene, self.context.device)
        self._forecaster = Forecaster(self.context)
        self._proportions: Proportions | None = None

    def run(self) -> Report:
        """Run the scene with all settings of the study.

        Raises:
            InputError: The scene cannot be run, or has too few particles per cell and axis.
            Cancelled: The function `progress` cancelled the study, and no finished setting is kept.
        """
        _require_particles(self.scene.resolution.particles_per_axis)
        rows, skipped = [], []
        plan = list(self._plan())
        for number, (name, scene) in enumerate(plan):
            still = partial(self._still, number, len(plan))
            try:
                still()
                row, reason = self._row(name, scene, still)
            except Stopped as stop:
                row, reason = None, f"{name} is left out: {stop}"
            except Exception as problem:
                if not (self.keep and rows):
                    raise
                self.ended = problem
                why = "interrupted." if is_stop(problem) else str(failure(problem))
                skipped += [f"{late} was not run: {why}" for late, _ in plan[number:]]
                break
            if reason:
                skipped.append(reason)
            if row:
                rows.append(row)
                self.on_row(row)
        else:
            self.context.progress("study", len(plan), len(plan))
        report = self._conclude_or_keep(rows, tuple(skipped))
        return replace(report, interrupted=self.ended is not None)

    def _conclude_or_keep(self, rows: list[Row], skipped: tuple[str, ...]) -> Report:
        """Return the report; without errors if the comparison fails and `keep` is true."""
        try:
            return self._conclude(rows, skipped)
        except Exception as problem:
            if not (self.keep and rows):
                raise
            self.ended = problem
            why = "the settings were not compared"
            return self._conclude_without_errors(
                rows, (*skipped, f"{why}: {failure(problem)}"), why
            )

    def _still(self, number: int, count: int, stage: str = "study", *steps: int) -> None:
        if stage == "compile":
            self.context.progress(stage, *steps)
        self.context.progress("study", number, count)

    def _plan(self) -> Iterator[tuple[str, Scene]]:
        base = self.scene.resolution.model_copy(update={"solver": self.scene.solver})
        for cells in self.levels:
            yield f"D/{cells}", self._with(base.model_copy(update={"cells": cells}))
        if not self.thorough:
            return
        middle = base.model_copy(update={"cells": min(VARIED, max(self.levels))})
        here = f"at D/{middle.cells}"
        if not self.scene.projects:  # the substeps of these scenes do not depend on cfl
            shorter = middle.model_copy(update={"cfl": middle.cfl / 2})
            yield f"half the substep {here}", self._with(shorter)
        other = "float64" if self.scene.precision == "float32" else "float32"
        yield f"{other} {here}", self._with(middle.model_copy(update={"precision": other}))
        if self.scene.on_lattice:
            yield f"solver mpm {here}", self._with(middle.model_copy(update={"solver": "mpm"}))
            return
        if self.scene.projects:
            compressible = middle.model_copy(update={"liquid": "compressible"})
            yield f"liquid compressible {here}", self._with(compressible)
            return
        binding = "lattice" if self.scene.binding == "particles" else "particles"
        bound = self._with(middle).model_copy(update={"binding": binding})
        yield f"binding {binding} {here}", bound

    def _with(self, accuracy: Accuracy) -> Scene:
        scene = self.scene.model_copy(update={"accuracy": accuracy})
        update = {"balance": True, "energy": self.thorough and _can_split(scene)}
        checks = self.scene.checks.model_copy(update=update)
        return scene.model_copy(update={"checks": checks})

    def _row(self, name: str, scene: Scene, progress: Progress) -> tuple[Row | None, str]:
        """Run a setting; return its row, and a sentence about a problem. If the run stops early,
        there is no row. If the object may have torn, there is a row and a sentence.
        """
        context = replace(self.context.aside(), progress=progress)
        simulation = Simulation(prepare(self.gaussians, scene, context, crop=self.crop))
        self._proportions = self._proportions or simulation.setup.proportions
        predicted = self._forecast(simulation) if self.thorough else None
        clip = simulation.run()
        if not clip.report["complete"]:
            return None, f"{name} is left out: {clip.report['stopped']}"
        self.clips[name] = clip.surface
        solver, accuracy = simulation.solver, scene.resolution
        tearing, watchdog = simulation.find(Tearing), simulation.find(Watchdog)
        seconds, torn = (
            simulation.setup.context.watch.seconds,
            " ".join(tearing.notes() if tearing else ()),
        )
        counts, stated = solver.clock.limiters, None
        if self.thorough and name.startswith("D/"):
            stated = with_own_error(simulation, clip).report["error"]
        return Row(
            name=name,
            cells=accuracy.cells,
            precision=scene.precision,
            cfl=accuracy.cfl,
            binding=scene.binding,
            particles=len(simulation.setup.particles),
            particles_per_axis=_particles_per_axis(simulation),
            substeps=solver.clock.substeps,
            predicted=predicted,
            seconds=seconds["simulate"] + seconds["deform"] - split_seconds(simulation.timings),
            limiters={key: count / sum(counts.values()) for key, count in counts.items()},
            energy_lost=-clip.report["balance"]["energy_gain"],
            lost_to=_lost_to(clip.report.get("energy")),
            angular_momentum_lost=_momentum_lost(scene, watchdog) if watchdog else None,
            torn=torn,
            stated=stated,
        ), f"{name}: {torn}" if torn else ""

    def _forecast(self, simulation: Simulation) -> float:
        """Forecast the time of the same run without the analysis of energy losses [s]."""
        scene = simulation.scene
        if scene.checks.energy:
            checks = scene.checks.model_copy(update={"energy": False})
            plain = scene.model_copy(update={"checks": checks})
            context = self.context.aside()
            simulation = Simulation(prepare(self.gaussians, plain, context, crop=self.crop))
        forecast = self._forecaster.of(simulation, filming=False, load=QUIET)
        return forecast.stages["simulate"] + forecast.stages["deform"]

    def _conclude(self, rows: list[Row], skipped: tuple[str, ...]) -> Report:
        levels = [row for row in rows if row.level and not row.torn]
        size = self.scene.object.size
        if not levels:
            torn = any(row.level for row in rows)
            why = (
                "on every level the grid may tear the material" if torn else "no level could be run"
            )
            return self._conclude_without_errors(rows, skipped, why)
        names = [row.name for row in levels]
        clips = [self.clips[name] for name in names]
        means = [clip.object_means for clip in clips]
        spacings = [1 / row.cells for row in levels]
        convergence, frames = longest_convergence(spacings, means, size)
        convergence = _without_torn(rows, convergence)
        known = dict(zip(names, convergence.errors, strict=False))
        judged = tuple(self._compare(row, clips, convergence, known, frames) for row in rows)
        finest = distances(means[-2:])
        times = clips[0].times
        until = float(times[frames - 1]) if frames < len(times) else None
        return Report(
            judged,
            skipped,
            convergence,
            size,
            recommend(judged, convergence, (frames - 1, len(times) - 1)),
            kept_promises(self.scene, self._proportions, judged, convergence, until),
            until=until,
            closest=float(finest[0, 1]) / size if len(clips) > 1 else None,
        )

    def _conclude_without_errors(
        self, rows: list[Row], skipped: tuple[str, ...], why: str
    ) -> Report:
        none, size = Convergence(None, why_not=why), self.scene.object.size
        promises = kept_promises(self.scene, self._proportions, tuple(rows), none)
        return Report(tuple(rows), skipped, none, size, why, promises)

    def _compare(
        self,
        row: Row,
        levels: list[Clip],
        convergence: Convergence,
        known: dict[str, float],
        frames: int,
    ) -> Row:
        """Return a row with its error, and with its difference from the motion on the finest grid.

        The `known` errors of the levels are valid for the first `frames` frames.
        """
        if row.torn:
            return row
        view, clip, size = self.scene.view, self.clips[row.name], self.scene.object.size
        shrink = min(1.0, SIZE / max(view.size))
        small = view.model_copy(update={"size": tuple(round(side * shrink) for side in view.size)})
        apart = None
        if clip is not levels[-1] and self.thorough:
            apart = difference(clip, levels[-1], small, device=self.context.device)
            apart = replace(apart, pixels=apart.pixels / shrink)
        x = [other.object_means[:frames] for other in (clip, *levels)]
        each = [distances([x[0], level])[0, 1] / size for level in x[1:]]
        error = known.get(row.name, convergence.error_of(np.array(each)))
        if error is None:
            return replace(row, from_finest=apart)
        seen = apart.pixels / apart.relative if apart and apart.relative else None
        scale = pixels_per_size(self.scene) if seen is None else seen
        return replace(row, from_finest=apart, error=error, pixels=error * scale)


def _can_split(scene: Scene) -> bool:
    try:
        scene.replaced({"checks.balance": True, "checks.energy": True})
    except InputError:
        return False
    return True


def _lost_to(energy: dict[str, float] | None) -> dict[str, float] | None:
    if energy is None or not energy["turnover"] > 0:
        return None
    return {name: float(energy[name] / energy["turnover"]) for name in Loss._fields}


def _without_torn(rows: list[Row], convergence: Convergence) -> Convergence:
    torn = ", ".join(row.name for row in rows if row.level and row.torn)
    if not torn or not convergence.why_not:
        return convergence
    return replace(
        convergence, why_not=f"{convergence.why_not} ({torn} may be torn and do not count)"
    )


def _require_particles(per_axis: float | None) -> None:
    """Refuse too few particles per cell, because finer grids would then not be more accurate."""
    if per_axis is not None and per_axis < MIN_PARTICLES_PER_AXIS:
        limit = f"with fewer than {MIN_PARTICLES_PER_AXIS}, finer grids are not more accurate."
        remedy = f"Set {MIN_PARTICLES_PER_AXIS} or more, or leave it out."
        raise InputError("accuracy.particles_per_axis", f"{per_axis:g}", limit, remedy)


def _particles_per_axis(simulation: Simulation) -> float:
    """Return the median number of particles per cell and axis, over cells with particles."""
    cells = np.floor(simulation.setup.particles.x / simulation.solver.model.dx).astype(np.int64)
    _, counts = np.unique(cells, axis=0, return_counts=True)
    return float(np.median(counts) ** (1 / 3))


def _momentum_lost(scene: Scene, watchdog: Watchdog) -> float | None:
    """Return the relative change of angular momentum; None if forces or walls may change it."""
    before, after = watchdog.first, watchdog.last
    start = float(np.linalg.norm(before.angular))
    if scene.acting or scene.boundaries or start == 0:
        return None
    return float(np.linalg.norm(after.angular - before.angular)) / start
