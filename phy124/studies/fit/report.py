"""Makes the report of a fit: values, intervals, and misfits for each kind of measurement."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from phy124.io.clip import Clip
from phy124.studies.fit.estimate import Estimate
from phy124.studies.fit.observation import Values
from phy124.studies.fit.problem import Distance
from phy124.studies.fit.runs import Runs
from phy124.studies.fit.silhouettes import Silhouettes
from phy124.studies.fit.target import Target

FASTEST = 240.0
"""Maximum frame rate of the comparison video [frames/s]."""


def make_report(
    target: Target, runs: Runs, estimate: Estimate, clip: Clip, *, seconds: float
) -> dict[str, Any]:
    """Return the report of a fit as plain data.

    Args:
        target: The inputs of the fit.
        runs: The runs of the fit.
        estimate: The fitted values and their intervals.
        clip: The clip of the fitted scene.
        seconds: Time since the fit began [s].
    """
    cells = target.scene.resolution.cells
    complete = bool(clip.report["complete"])
    played = Distance(runs).misfits(target.observations.predict(clip)) if complete else None
    stopped = [] if complete else [f"The fitted scene stops early: {clip.report['stopped']}"]
    fitted = _values(runs, estimate, cells)
    return {
        "target": target.declared.target,
        "cells": cells,
        "found": fitted,
        "correlation": estimate.correlation.round(4).tolist(),
        "measured": {
            kind.name: {
                "count": kind.place.stop - kind.place.start,
                "unit": kind.unit,
                "misfit": played and played[number],
            }
            for number, kind in enumerate(runs.kinds)
        },
        "grids": [
            {"cells": cells, "values": runs.values(place), "misfit": misfit}
            for cells, place, misfit in zip(
                estimate.grids, estimate.places, estimate.misfits, strict=True
            )
        ],
        "tried": [run._asdict() for run in runs.tried],
        "runs": runs.made,
        "runs_kept": runs.kept,
        "cpu_seconds": round(runs.seconds, 2),
        "seconds": round(seconds, 2),
        "notes": [*estimate.notes, *_note_coarse(estimate, cells), *_notes(runs, fitted), *stopped],
        "declared": target.declared.model_dump(mode="json", exclude_none=True),
    }


def report_pictures(target: Target, runs: Runs, clip: Clip) -> dict[str, Any]:
    """Return the silhouette's misfit in each frame of a video, before and after the fit.

    `clip` is the clip of the fitted scene.
    """
    (seen,) = (part for part in target.observations.parts if isinstance(part, Silhouettes))
    assert target.film is not None
    before = runs.player(target.played.data())[0]
    fitted = target.observations.predict(clip) if clip.report["complete"] else None
    place = next(kind.place for kind in runs.kinds if kind.name == seen.name)
    misfits = {
        name: None if predicted is None else seen.apart(predicted[place]).round(5).tolist()
        for name, predicted in (("before", before), ("fitted", fitted))
    }
    return {
        "fps": min(target.rate_of(target.film), FASTEST),
        "times": target.times_of(target.film).round(5).tolist(),
        "was": {name: value_at(target.scene.data(), name) for name in runs.names},
        **misfits,
        "laid": target.laid and target.laid._asdict(),
    }


def value_at(data: Any, path: str) -> Any:
    """Return the value at a dotted path in plain data."""
    for part in path.split("."):
        data = data[int(part)] if isinstance(data, list | tuple) else data[part]
    return data


def format_table(report: dict[str, Any]) -> str:
    """Format the report as a text table."""
    if len(report["grids"]) > 1:
        rows = [("value", f"on {report['cells']} cells", "95 %", "without grid error", "95 %")]
        for path, value in report["found"].items():
            rows.append((path, *_format(value), *_format(value["limit"])))
    else:  # no value can be extrapolated to another grid
        rows = [("value", f"on {report['grids'][0]['cells']} cells", "95 %")]
        rows += [(path, *_format(value)) for path, value in report["found"].items()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = [[c.ljust(width) for c, width in zip(row, widths, strict=True)] for row in rows]
    lines = ["  ".join(row).rstrip() for row in padded]
    lines += [
        f"{name}: {kind['misfit']:.3g} {kind['unit']} off (root mean square)"
        for name, kind in report["measured"].items()
        if kind["misfit"] is not None
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in report["notes"])])


def _values(runs: Runs, estimate: Estimate, cells: int) -> dict[str, Any]:
    here, limit = _around(runs, *estimate.on(cells)), _around(runs, *estimate.on(math.inf))
    sampled = _around(runs, estimate.on(cells)[0], estimate.sampling)
    return {
        name: {**here[name], "from_measurements": sampled[name]["interval"], "limit": limit[name]}
        for name in runs.names
    }


def _note_coarse(estimate: Estimate, cells: int) -> list[str]:
    """Return a note if the values are extrapolated to a grid coarser than those of the fit.

    In a fit on 16 and 24 cells to a clip of 10 cells, the value on 10 cells was off by 2.2 %, four
    times the half-width of its interval.
    """
    if len(estimate.grids) < 2 or cells >= estimate.grids[0]:
        return []
    return [
        f"The scene has {cells} cells, fewer than the grids of the fit, so the intervals on "
        f"{cells} cells may be too narrow. To run this grid, too, give "
        f"--grids {cells},{','.join(map(str, estimate.grids[:-1]))}."
    ]


def _notes(runs: Runs, fitted: dict[str, Any]) -> Iterator[str]:
    """Yield a note for each value whose interval extends beyond the searched range."""
    count = len(runs.names)
    least, most = runs.values(np.zeros(count)), runs.values(np.ones(count))
    for name, value in fitted.items():
        both, range_ = (value, value["limit"]), f"range, {least[name]:g} to {most[name]:g}"
        if any(not least[name] <= each["value"] <= most[name] for each in both):
            yield (
                f"A value of {name} was extrapolated from the grids beyond its {range_}. The "
                "fitted scene does not leave this range, so widen it."
            )
        elif any(
            each["interval"][0] < least[name] or each["interval"][1] > most[name] for each in both
        ):
            yield f"The interval of {name} is extrapolated beyond the searched {range_}."


def _around(runs: Runs, place: Values, errors: Values) -> dict[str, Any]:
    value, low, high = map(runs.values, (place, place - errors, place + errors))
    return {n: {"value": value[n], "interval": [low[n], high[n]]} for n in runs.names}


def _format(value: dict[str, Any]) -> tuple[str, str]:
    low, high = value["interval"]
    return f"{value['value']:.4g}", f"{low:.4g} to {high:.4g}"
