"""Measured errors and times of a visitor's scene on several grids."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from phy124.accuracy import promises
from phy124.accuracy.promises import Promise
from phy124.scene import Scene
from phy124.studies.validation.accuracy.report import Report, error_on

GRIDS = (12, 16, 24)
"""Grids of an error study [number of cells across the object]."""


class Level(BaseModel):
    """Result of an error study on one grid."""

    model_config = ConfigDict(frozen=True)

    cells: int
    seconds: float
    """Time to simulate the motion and to compute the Gaussians of all frames [s]."""
    error: float | None
    """Error as a fraction of the object's size.

    The error is None if the grids do not converge, or if the object may have torn on this grid.
    """
    torn: bool

    @property
    def name(self) -> str:
        """Name of the grid in the table of results."""
        return f"D/{self.cells}"


class Measurement(BaseModel):
    """Errors of a scene on several grids, independent of the grid set in the scene."""

    model_config = ConfigDict(frozen=True)

    levels: tuple[Level, ...]
    order: float | None
    why_not: str
    """Reason why errors could not be determined."""
    skipped: tuple[str, ...]
    until: float | None = None
    """Time up to which the errors are valid [s]; None if they are valid for the whole motion."""

    @classmethod
    def of(cls, report: Report) -> Measurement:
        """Create a measurement from a part of the report of a study."""
        levels = tuple(
            Level(cells=row.cells, seconds=row.seconds, error=row.error, torn=bool(row.torn))
            for row in report.rows
        )
        order, why_not = report.convergence.order, report.convergence.why_not
        return cls(
            levels=levels,
            order=order,
            why_not=why_not,
            skipped=report.skipped,
            until=report.until,
        )

    def promise(self, cells: int) -> Promise:
        """Return the measured error on a grid as a `Promise`.

        If the object may have torn on any grid, return a message instead of an error.
        """
        torn = [level.name for level in self.levels if level.torn]
        if torn:
            return promises.refuse_promise(f"{promises.torn(torn)}.")
        errors = {level.cells: level.error for level in self.levels if level.error is not None}
        error = error_on(cells, errors, self.order)
        if error is None:
            why = ". ".join([self.why_not or "no grid this coarse was measured", *self.skipped])
            return promises.refuse_promise(f"{why.rstrip('.')}.")
        return promises.promise_measured(error, cells, sorted(errors), self.until)

    def table(self) -> str:
        """Format the name, the time and the error of each grid of the study as an HTML table."""
        rows = [
            f"<tr><td>{level.name}</td><td>{level.seconds:.1f} s</td>"
            f"<td>{promises.off(level.error, torn=level.torn)}</td></tr>"
            for level in self.levels
        ]
        return f'<table class="stops">{"".join(rows)}</table>'

    def rows(self) -> list[dict[str, float | str | bool | None]]:
        """Return the name, the time and the error of each grid of the study, as plain data for
        programs.
        """
        return [{"name": level.name, **level.model_dump()} for level in self.levels]


def grids(scene: Scene) -> tuple[int, ...]:
    """Return the grids of a scene's study, including the scene's grid if it is coarse enough."""
    cells = scene.resolution.cells
    return tuple(sorted({*GRIDS, cells} if cells < GRIDS[-1] else GRIDS))


def on_grid(scene: Scene, cells: int) -> Scene:
    """Return a copy of the scene with another number of cells, for an error study.

    Elastic objects keep the scene's solver. Single precision does not affect the error
    (docs/lab/accuracy.md).
    """
    changes = {"cells": cells, "precision": "float32", "solver": scene.solver}
    accuracy = scene.resolution.model_copy(update=changes)
    return scene.model_copy(update={"accuracy": accuracy})


def read_study(path: Path) -> Measurement | None:
    """Read the stored errors of a scene; None if no errors are stored."""
    try:
        return Measurement.model_validate_json(path.read_text("utf-8"))
    except FileNotFoundError:
        return None
