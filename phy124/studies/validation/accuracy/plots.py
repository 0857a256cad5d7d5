"""Plots the error of each setting over its time, with the Pareto front, as a PNG and a web page.

Grey settings are dominated: another setting is both faster and more accurate.
"""

import html
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phy124.accuracy.promises import off
from phy124.errors import InputError
from phy124.io.files import replacing, write_whole
from phy124.io.html import fill
from phy124.runtime.installation import install_command
from phy124.scene import PRESETS
from phy124.studies.validation.accuracy.report import Report, Row

PathLike = str | os.PathLike[str]
BLUE, GREY, ORANGE = "#2563a8", "#9aa3ad", "#c2571a"
PAGE = Path(__file__).with_name("plot.html")


def find_dominated(rows: Sequence[Row]) -> set[str]:
    """Return the names of the settings that are not on the Pareto front of time and error."""
    known = [row for row in rows if _error(row) is not None]
    return {
        row.name
        for row in known
        if any(
            other.seconds <= row.seconds and (_error(other) or 0) <= (_error(row) or 0)
            for other in known
            if other.name != row.name
        )
    }


def save_picture(report: Report, path: PathLike, *, title: str = "") -> None:
    """Draw two plots, error over time and PSNR over time, in one PNG file.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        limit = "this needs matplotlib, which is not installed."
        remedy = f"Run `{install_command('plots')}`; accuracy.html shows the same figures."
        raise InputError("plots", "PNG", limit, remedy) from None
    figure = Figure(figsize=(9, 4), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    _draw_errors(left, report)
    _draw_psnr(right, report)
    figure.suptitle(title or report.recommendation, fontsize=10)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw_errors(axes: Any, report: Report) -> None:
    worse = find_dominated(report.rows)
    known = [row for row in report.rows if _error(row) is not None]
    for row in known:
        colour = GREY if row.name in worse else BLUE if row.level else ORANGE
        _mark(axes, row, _error(row) or 0, colour, report)
    front = sorted((r.seconds, _error(r) or 0) for r in known if r.name not in worse)
    if front:
        axes.plot(*zip(*front, strict=True), "-", color=BLUE, linewidth=1, zorder=0)
        axes.set(yscale="log")
    else:
        axes.text(0.5, 0.5, report.convergence.why_not, ha="center", transform=axes.transAxes)
    _label_axes(axes, "error [% of the object's size]")


def _draw_psnr(axes: Any, report: Report) -> None:
    for row in report.rows:
        if row.from_finest is not None and not row.torn and math.isfinite(row.from_finest.psnr):
            colour = BLUE if row.level else ORANGE
            _mark(axes, row, row.from_finest.psnr, colour, report)
    _label_axes(axes, "PSNR against the finest [dB]")


def _mark(axes: Any, row: Row, value: float, colour: str, report: Report) -> None:
    times = [math.log(other.seconds) for other in report.rows]
    late = math.log(row.seconds) > (min(times) + max(times)) / 2
    axes.plot(row.seconds, value, "o" if row.level else "s", color=colour)
    offset, side = (-6 if late else 6, 5 if row.level else -12), "right" if late else "left"
    axes.annotate(
        _label(row),
        (row.seconds, value),
        xytext=offset,
        textcoords="offset points",
        fontsize=8,
        ha=side,
    )


def _label_axes(axes: Any, what: str) -> None:
    from matplotlib.ticker import LogFormatter

    axes.set(xscale="log", xlabel="seconds", ylabel=what)
    scales = [axes.xaxis] + [axes.yaxis] * (axes.get_yscale() == "log")
    for axis in scales:
        axis.set_major_formatter(LogFormatter())
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
    axes.margins(0.12)
    axes.grid(alpha=0.3, which="both")


def save_page(report: Report, path: PathLike, *, title: str = "Accuracy and time") -> None:
    """Write the plot of error over time as a web page that works offline."""
    worse = find_dominated(report.rows)
    points = [
        {
            "name": _label(row),
            "seconds": row.seconds,
            "error": _error(row),
            "off": off(row.error, torn=bool(row.torn)),
            "pixels": row.pixels,
            "psnr": row.from_finest.psnr if row.from_finest else None,
            "particles": row.particles,
            "substeps": row.substeps,
            "level": row.level,
            "dominated": row.name in worse,
        }
        for row in report.rows
    ]
    # The characters "</" in the data could end the script element.
    data = json.dumps(points).replace("</", "<\\/")
    sentences = [*report.sentences, *(f"{n}: {s}" for n, s in report.promises.items())]
    paragraphs = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in sentences)
    texts = {"title": html.escape(title), "sentences": paragraphs, "data": data}
    write_whole(path, fill(PAGE.read_text("utf-8"), texts))


def _label(row: Row) -> str:
    preset = {accuracy.cells: name for name, accuracy in PRESETS.items()}.get(row.cells)
    return f"{row.name} ({preset})" if row.level and preset else row.name


def _error(row: Row) -> float | None:
    return None if row.error is None else 100 * row.error
