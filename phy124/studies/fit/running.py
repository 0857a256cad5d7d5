"""One fit from its declaration to its files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phy124.io.clip import Clip
from phy124.io.files import staging, write_whole
from phy124.io.video import refuse_missing_encoder
from phy124.progress import Progress, silent
from phy124.scene import Scene
from phy124.studies.fit.budget import Budget, Outlook, outlook
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.estimate import Estimate, estimate
from phy124.studies.fit.page import write_page
from phy124.studies.fit.picture import Comparison
from phy124.studies.fit.report import pictures, report_of, table
from phy124.studies.fit.runs import Runs
from phy124.studies.fit.target import Target
from phy124.studies.fit.video import Film

SCENE, REPORT = "fitted.toml", "fit.json"
SHEET, FILM, PAGE = "comparison.png", "comparison.mp4", "comparison.html"


@dataclass(frozen=True)
class Fitted:
    """What a fit has found, and where it is."""

    scene: Scene
    """The scene with the values found for its own grid."""
    report: dict[str, Any]
    files: tuple[Path, ...]

    def table(self) -> str:
        """For people."""
        return table(self.report)


def fit(
    declared: Fit,
    out: Path,
    *,
    workers: int = 0,
    told: Callable[[Outlook], object] = lambda outlook: None,
    progress: Progress = silent,
) -> Fitted:
    """Find the values; the same call goes on where it was stopped.

    Args:
        declared: What to find, and from what.
        out: Folder of the results; runs are kept in it.
        workers: Processes; 0: this one.
        told: Called with what it will take, before the first run.
        progress: Called with ("fit", runs made, runs that are expected); may raise Cancelled.

    Raises:
        InputError: Something cannot be used, cannot be told apart, or takes longer than it may.
    """
    target = Target(declared)
    if target.film is not None:
        refuse_missing_encoder()
    budget = Budget(declared.seconds)
    runs = Runs(target, out, budget, progress)
    expected = _outlook(runs, target, workers)
    expected.refuse(declared.seconds)
    told(expected)
    budget.expected = sum(expected.runs())
    with runs.workers(workers):
        found = estimate(runs, seed=declared.seed)
    return _written(target, runs, budget, found, out)


def forecast(declared: Fit, *, workers: int = 0) -> Outlook:
    """What a fit will take; makes no run of it.

    Raises:
        InputError: Something cannot be used.
    """
    target = Target(declared)
    return _outlook(Runs(target, Path(), Budget(declared.seconds)), target, workers)


def _outlook(runs: Runs, target: Target, workers: int) -> Outlook:
    middle = np.full(len(runs.names), 0.5)
    scenes = [runs.scene_at(middle, level) for level in range(len(runs.grids))]
    return outlook(target.gaussians, scenes, len(runs.names), workers, target.crop)


def _written(target: Target, runs: Runs, budget: Budget, found: Estimate, out: Path) -> Fitted:
    """Play the scene that was found, and write it, the report and the comparison."""
    values = runs.values(found.on(target.scene.resolution.cells)[0])
    scene = target.scene.replaced(values)
    clip = runs.player.clip(target.played.replaced(values).data())
    report = report_of(target, runs, found, clip, seconds=budget.spent)
    with staging(out, keeps=True) as folder:
        write_whole(folder / SCENE, scene.to_toml())
        _write_report(folder, report)
        if target.film is not None:
            report["pictures"] = pictures(target, runs, clip)
            _write_report(folder, report)
            _compare(target, target.film, clip, report, folder)
        names = sorted(path.name for path in folder.iterdir())
    return Fitted(scene, report, tuple(out / name for name in names))


def _write_report(folder: Path, report: dict[str, Any]) -> None:
    write_whole(folder / REPORT, json.dumps(report, indent=2, allow_nan=False) + "\n")


def _compare(target: Target, film: Film, clip: Clip, report: dict[str, Any], folder: Path) -> None:
    """Write film and fitted scene side by side: some instants, all as a film, and a page."""
    both = Comparison(film, target.times_of(film), clip, target.seen_by())
    both.write_sheet(folder / SHEET)
    both.write_film(folder / FILM, report["pictures"]["fps"])
    write_page(folder / PAGE, report, folder / FILM)
