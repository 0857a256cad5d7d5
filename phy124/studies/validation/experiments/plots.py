"""Plots of experiments as SVG: what was published, three grids, their limit, and the control."""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import Any

from phy124.errors import InputError
from phy124.io.files import replacing
from phy124.runtime.installation import install_command
from phy124.studies.validation.experiments.outcome import Outcome

PathLike = str | os.PathLike[str]
BLUE, GREY, ORANGE, GREEN = "#2563a8", "#9aa3ad", "#c2571a", "#2c8a4b"
SHADES = ("#c9d8ea", "#8fb0d6", "#5a8bc2")
"""Of the three grids, from coarse to fine."""


def refuse_missing_plots() -> None:
    """Make sure that plots can be drawn.

    Raises:
        InputError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise InputError(
            "plots", "SVG", "this needs matplotlib, which is not installed.",
            f"Run `{install_command('plots')}`, or leave --out and --docs out.",
        )  # fmt: skip


def save_plot(outcome: Outcome, path: PathLike) -> None:
    """Draw one experiment: a curve if its quantities have places on an axis, otherwise rows.

    Args:
        outcome: What it found.
        path: The SVG file.

    Raises:
        InputError: matplotlib is not installed.
    """
    refuse_missing_plots()
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    curve = bool(outcome.experiment.axis)
    height = 3.6 if curve else 1.2 + 0.42 * len(outcome.found)
    figure = Figure(figsize=(7.5, height), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.subplots()
    (_draw_curve if curve else _draw_rows)(axes, outcome)
    axes.legend(fontsize=8, frameon=False, loc="best")
    # The same figures give the same file.
    fixed: Any = {"svg.hashsalt": outcome.experiment.name}
    with replacing(path) as temporary, matplotlib.rc_context(fixed):
        figure.savefig(temporary, format="svg", metadata={"Date": None})


def _draw_curve(axes: Any, outcome: Outcome) -> None:
    """Values over the quantities' places."""
    experiment, found = outcome.experiment, outcome.found
    places = [each.quantity.at for each in found]
    low, high = ([getattr(f.quantity, side) for f in found] for side in ("low", "high"))
    axes.fill_between(places, low, high, color=GREEN, alpha=0.25, label="published", linewidth=0)
    axes.plot(places, [f.quantity.published for f in found], color=GREEN, linewidth=1)
    for k, cells in enumerate(experiment.grids):
        values = [f.levels[k] for f in found]
        axes.plot(places, values, "o", color=SHADES[k], markersize=4, label=f"{cells} cells")
    values, errors = [f.value for f in found], [f.error for f in found]
    axes.errorbar(
        places, values, errors, fmt="D", color=BLUE, capsize=3, label="limit of the grids"
    )
    axes.plot(places, [f.control for f in found], "x", color=ORANGE, label=experiment.mistake)
    axes.set(xlabel=experiment.axis, ylabel=experiment.unit)
    axes.grid(alpha=0.3)


def _draw_rows(axes: Any, outcome: Outcome) -> None:
    """A row per quantity, each relative to what was published; near zero, the difference."""
    experiment, found = outcome.experiment, outcome.found
    rows = range(len(found))

    def placed(values: list[float]) -> list[float]:
        return [
            100 * (value - f.quantity.published) / (abs(f.quantity.published) or 1.0)
            for value, f in zip(values, found, strict=True)
        ]

    low, high = (placed([getattr(f.quantity, side) for f in found]) for side in ("low", "high"))
    widths = [b - a for a, b in zip(low, high, strict=True)]
    axes.barh(rows, widths, left=low, height=0.7, color=GREEN, alpha=0.25, label="published")
    for k, cells in enumerate(experiment.grids):
        values = placed([f.levels[k] for f in found])
        axes.plot(values, rows, "o", color=SHADES[k], markersize=4, label=f"{cells} cells")
    errors = [100 * f.error / (abs(f.quantity.published) or 1.0) for f in found]
    axes.errorbar(
        placed([f.value for f in found]), rows, xerr=errors, fmt="D", color=BLUE, capsize=3,
        label="limit of the grids",
    )  # fmt: skip
    axes.plot(placed([f.control for f in found]), rows, "x", color=ORANGE, label=experiment.mistake)
    axes.set_yticks(rows, [f.quantity.name for f in found], fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="off the published value [%]")
    axes.grid(alpha=0.3, axis="x")
