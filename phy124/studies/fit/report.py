"""The report of a fit: values, intervals, and how far each kind of measurement is off."""

from __future__ import annotations

import math
from typing import Any

from phy124.io.clip import Clip
from phy124.studies.fit.estimate import Estimate
from phy124.studies.fit.problem import Distance
from phy124.studies.fit.runs import Runs
from phy124.studies.fit.silhouettes import Silhouettes
from phy124.studies.fit.table import Values
from phy124.studies.fit.target import Target

FASTEST = 240.0
"""Most pictures per second of the comparison."""


def report_of(
    target: Target, runs: Runs, found: Estimate, clip: Clip, *, seconds: float
) -> dict[str, Any]:
    """Everything about a fit as plain data.

    Args:
        target: What was measured, and on what.
        runs: What was run.
        found: What was found.
        clip: The scene with the values found, on its own grid.
        seconds: Time since the fit began [s].
    """
    cells = target.scene.resolution.cells
    complete = bool(clip.report["complete"])
    played = Distance(runs).misfits(target.observations.predicted(clip)) if complete else None
    stopped = [] if complete else [f"The fitted scene stops early: {clip.report['stopped']}"]
    return {
        "target": target.declared.target,
        "cells": cells,
        "found": _values(runs, found, cells),
        "correlation": found.correlation.round(4).tolist(),
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
            for cells, place, misfit in zip(found.grids, found.places, found.misfits, strict=True)
        ],
        "tried": [one._asdict() for one in runs.tried],
        "runs": runs.made,
        "runs_kept": runs.kept,
        "cpu_seconds": round(runs.seconds, 2),
        "seconds": round(seconds, 2),
        "notes": [*found.notes, *stopped],
        "declared": target.declared.model_dump(mode="json", exclude_none=True),
    }


def pictures(target: Target, runs: Runs, clip: Clip) -> dict[str, Any]:
    """How far the silhouettes are off in each picture of a film, fitted and as the scene was.

    Args:
        target: What was measured; a film.
        runs: What was run.
        clip: The scene with the values found, on its own grid.
    """
    (seen,) = (part for part in target.observations.parts if isinstance(part, Silhouettes))
    assert target.film is not None
    before = runs.player(target.played.data())[0]
    fitted = target.observations.predicted(clip) if clip.report["complete"] else None
    place = next(kind.place for kind in runs.kinds if kind.name == seen.name)
    told = {
        name: None if one is None else seen.apart(one[place]).round(5).tolist()
        for name, one in (("before", before), ("fitted", fitted))
    }
    return {
        "fps": min(target.rate_of(target.film), FASTEST),
        "times": target.times_of(target.film).round(5).tolist(),
        "was": {name: at(target.scene.data(), name) for name in runs.names},
        **told,
        "laid": target.laid and target.laid._asdict(),
    }


def at(data: Any, path: str) -> Any:
    """What plain data has at a dotted path."""
    for part in path.split("."):
        data = data[int(part)] if isinstance(data, list | tuple) else data[part]
    return data


def table(report: dict[str, Any]) -> str:
    """A report for people."""
    rows = [("value", f"on {report['cells']} cells", "95 %", "without grid error", "95 %")]
    for path, found in report["found"].items():
        rows.append((path, *_spoken(found), *_spoken(found["limit"])))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    padded = [[c.ljust(width) for c, width in zip(row, widths, strict=True)] for row in rows]
    lines = ["  ".join(row).rstrip() for row in padded]
    lines += [
        f"{name}: {found['misfit']:.3g} {found['unit']} off (root mean square)"
        for name, found in report["measured"].items()
        if found["misfit"] is not None
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in report["notes"])])


def _values(runs: Runs, found: Estimate, cells: int) -> dict[str, Any]:
    """Each value with its intervals."""
    here, limit = _around(runs, *found.on(cells)), _around(runs, *found.on(math.inf))
    sampled = _around(runs, found.on(cells)[0], found.sampling)
    return {
        name: {
            **here[name],
            "from_measurements": sampled[name]["interval"],
            "limit": limit[name],
        }
        for name in runs.names
    }


def _around(runs: Runs, place: Values, errors: Values) -> dict[str, Any]:
    """Values at a place and at the ends of their intervals."""
    value, low, high = (runs.values(one) for one in (place, place - errors, place + errors))
    return {n: {"value": value[n], "interval": [low[n], high[n]]} for n in runs.names}


def _spoken(found: dict[str, Any]) -> tuple[str, str]:
    """A value and its interval as text."""
    low, high = found["interval"]
    return f"{found['value']:.4g}", f"{low:.4g} to {high:.4g}"
