"""Runs a fit, and writes the result files."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phy124.io.clip import Clip
from phy124.io.files import refuse_replacing, staging, write_whole
from phy124.io.video import refuse_missing_encoder
from phy124.pipeline import write_json
from phy124.pipeline.disk_space import warn_if_full
from phy124.progress import Progress, silent
from phy124.scene import Scene
from phy124.studies.fit.budget import Budget, Outlook, make_outlook
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.estimate import Estimate, estimate
from phy124.studies.fit.page import Comparison, write_page
from phy124.studies.fit.report import format_table, make_report, report_pictures
from phy124.studies.fit.runs import Runs
from phy124.studies.fit.target import Target
from phy124.studies.fit.video import Film

STORED = 4
"""Size of a predicted measurement in the file of a run [bytes]."""
SCENE, REPORT = "fitted.toml", "fit.json"
SHEET, FILM, PAGE = "comparison.png", "comparison.mp4", "comparison.html"


@dataclass(frozen=True)
class Fitted:
    """The result of a fit, and the files that were written."""

    scene: Scene
    """The scene with the fitted values, extrapolated to the scene's grid but within the ranges."""
    report: dict[str, Any]
    files: tuple[Path, ...]

    def table(self) -> str:
        """Format the report as a table."""
        return format_table(self.report)


def fit(
    declared: Fit,
    out: Path,
    *,
    workers: int = 0,
    on_forecast: Callable[[Outlook], object] = lambda forecast: None,
    progress: Progress = silent,
) -> Fitted:
    """Run a fit and write its files, or continue an interrupted fit.

    Args:
        declared: The options of the fit.
        out: Folder for the results of the fit and of its runs.
        workers: Number of worker processes; 0: this process makes all runs.
        on_forecast: Function called with the forecast before the first run.
        progress: Function called with ("fit", runs made, runs expected); it may raise Cancelled.

    Raises:
        InputError: An input is invalid, a value cannot be determined, the time budget is too short,
            the folder cannot be written, or an input would be overwritten.
    """
    read = [declared.target, declared.object, declared.scene, declared.forces]
    for name in (SCENE, REPORT, SHEET, FILM, PAGE):
        refuse_replacing(out / name, [Path(each) for each in read if each is not None])
    with staging(out):  # An unusable folder is refused before any run.
        pass
    target = Target(declared)
    if target.film is not None:
        refuse_missing_encoder()
    budget = Budget(declared.seconds)
    runs = Runs(target, out, budget, progress)
    expected = _outlook(runs, target, workers)
    expected.refuse(declared.seconds)
    on_forecast(expected)
    budget.expected = sum(expected.runs())
    then = "after a full disk, the same command continues the fit"
    warn_if_full(budget.expected * target.observations.measured.size * STORED, out, then)
    with runs.workers(workers):
        estimated = estimate(runs, seed=declared.seed)
    return _write(target, runs, budget, estimated, out)


def forecast(declared: Fit, *, workers: int = 0) -> Outlook:
    """Forecast the time of a fit without running it.

    Raises:
        InputError: An input is invalid.
    """
    target = Target(declared)
    return _outlook(Runs(target, Path(), Budget(declared.seconds)), target, workers)


def _outlook(runs: Runs, target: Target, workers: int) -> Outlook:
    middle = np.full(len(runs.names), 0.5)
    scenes = [runs.scene_at(middle, level) for level in range(len(runs.grids))]
    return make_outlook(target.gaussians, scenes, len(runs.names), workers, target.crop)


def _write(target: Target, runs: Runs, budget: Budget, estimated: Estimate, out: Path) -> Fitted:
    values = runs.values(np.clip(estimated.on(target.scene.resolution.cells)[0], 0, 1))
    scene = target.scene.replaced(values)
    clip = runs.player.clip(target.played.replaced(values).data())
    report = make_report(target, runs, estimated, clip, seconds=budget.spent)
    with staging(out, keeps=True) as folder:
        write_whole(folder / SCENE, scene.to_toml())
        write_json(folder / REPORT, report)
        if target.film is not None:
            report["pictures"] = report_pictures(target, runs, clip)
            write_json(folder / REPORT, report)
            _compare(target, target.film, clip, report, folder)
        names = sorted(path.name for path in folder.iterdir())
    return Fitted(scene, report, tuple(out / name for name in names))


def _compare(target: Target, film: Film, clip: Clip, report: dict[str, Any], folder: Path) -> None:
    both = Comparison(film, target.times_of(film), clip, target.seen_by())
    both.write_sheet(folder / SHEET)
    both.write_film(folder / FILM, report["pictures"]["fps"])
    write_page(folder / PAGE, report, folder / FILM)
