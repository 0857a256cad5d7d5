"""The page of a fit: film and fitted scene picture by picture, and the curves of their distance.

`figure` is shown by the web page, too, which serves the script and the style from phy124/io/viewer.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from phy124.io.files import replacing
from phy124.io.html import VIEWER
from phy124.studies.fit.report import table

WIDTH, HEIGHT, TOP, BOTTOM, MARGIN = 300, 110, 6, 92, 6
COLOURS = ("#d55e00", "#0072b2")
"""Of the difference: only filmed, only fitted (phy124.studies.fit.picture)."""
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>body {{ max-width: 860px; margin: 24px auto; padding: 0 16px; color: #17202b;
  font: 15px/1.4 system-ui, sans-serif; }}
h1 {{ font-size: 20px; }} pre {{ overflow-x: auto; font-size: 13px; }}
{style}</style></head><body>
<h1>{title}</h1>
{figure}
<pre>{table}</pre>
<script>{script}
Phy124Compare(document.querySelector('.compare'));</script>
</body></html>
"""


def write_page(path: Path, report: dict[str, Any], film: Path) -> None:
    """Write one HTML file with the film inside, which any browser shows without a network.

    Args:
        path: The file.
        report: The report of a fit to a film.
        film: The MP4 of film and fitted scene side by side.
    """
    data = base64.b64encode(film.read_bytes()).decode()
    page = PAGE.format(
        title=f"Fit to {escape(Path(report['target']).name)}",
        style=(VIEWER / "compare.css").read_text("utf-8"),
        script=(VIEWER / "compare.js").read_text("utf-8"),
        figure=figure(report, f"data:video/mp4;base64,{data}"),
        table=escape(table(report)),
    )
    with replacing(path) as temporary:
        temporary.write_text(page, "utf-8")


def figure(report: dict[str, Any], film: str) -> str:
    """The film with its slider, and the curves, as HTML; all of its text is escaped.

    Args:
        report: The report of a fit to a film.
        film: Address of the MP4 of film and fitted scene side by side.
    """
    shown = report["pictures"]
    times = " ".join(f"{time:g}" for time in shown["times"])
    only = "".join(
        f'<b style="background:{colour}"></b><i>only {word}</i>'
        for colour, word in zip(COLOURS, ("filmed", "fitted"), strict=True)
    )
    curves = [distances(shown), *(trials(report, name) for name in report["found"])]
    return (
        f'<figure class="compare" data-fps="{shown["fps"]:g}" data-times="{times}">'
        f'<div class="compare-heads"><span>Filmed</span><span>Fitted</span>'
        f"<span>Difference{only}</span></div>"
        f'<video src="{escape(film)}" muted loop playsinline preload="auto" '
        f'aria-label="Filmed, fitted and their difference"></video>'
        f'<div class="compare-bar"><button type="button" class="quiet">Play</button>'
        f'<input type="range" min="0" max="{len(shown["times"]) - 1}" value="0" '
        f'aria-label="Picture"><output></output></div>'
        f'<div class="compare-curves">{"".join(curves)}</div></figure>'
    )


def distances(shown: dict[str, Any]) -> str:
    """The curve of the distance in each picture, before and after the fit, as SVG."""
    times = shown["times"]
    lines = {name: shown[name] for name in ("before", "fitted") if shown[name]}
    highest = max((max(line) for line in lines.values()), default=0.0) or 1.0
    x = _scale(times, MARGIN, WIDTH - MARGIN)
    y = _scale([0.0, highest], BOTTOM, TOP)
    drawn = [
        f'<polyline class="{name}" points="{" ".join(_point(x(t), y(v)) for t, v in rows)}"/>'
        for name, rows in ((name, zip(times, line, strict=True)) for name, line in lines.items())
    ]
    places = " ".join(f"{x(time):.1f}" for time in times)
    mark = f'<line class="now" y1="{TOP}" y2="{BOTTOM}" data-places="{places}"/>'
    was = ", ".join(f"{value:g}" for value in shown["was"].values())
    label = f"Distance of the outlines, up to {highest:.3f} of a pixel; dashed: before ({was})"
    return _plot(label, [*drawn, mark], f"{times[0]:.2f} s", f"{times[-1]:.2f} s")


def trials(report: dict[str, Any], name: str) -> str:
    """The curve of the distance over a value: all that were tried, and the interval, as SVG."""
    tried = [one for one in report["tried"] if one["misfits"]]
    log = "log_uniform" in report["declared"]["find"][name]
    values = [float(one["values"][name]) for one in tried]
    off = [float(one["misfits"][0]) for one in tried]
    unit, found = next(iter(report["measured"].values()))["unit"], report["found"][name]
    x = _scale(values, MARGIN, WIDTH - MARGIN, log=log)
    y = _scale([0.0, *off], BOTTOM, TOP)
    low, high = (min(max(x(end), MARGIN), WIDTH - MARGIN) for end in found["interval"])
    band = f'<rect class="interval" x="{low:.1f}" y="{TOP}" height="{BOTTOM - TOP}" '
    band += f'width="{max(high - low, 1):.1f}"/>'
    dots = [
        f'<circle class="dot{" finer" if one["level"] else ""}" r="2.5" '
        f'cx="{x(value):.1f}" cy="{y(miss):.1f}"/>'
        for one, value, miss in zip(tried, values, off, strict=True)
    ]
    label = f"Distance over {name}, up to {max(off):.3g} {unit}; blue: finer grids; band: 95 %"
    return _plot(label, [band, *dots], f"{min(values):.3g}", f"{max(values):.3g}")


def _plot(label: str, drawn: Sequence[str], first: str, last: str) -> str:
    return (
        f"<div><p>{escape(label)}</p>"
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(label)}">'
        f'<line class="axis" x1="0" x2="{WIDTH}" y1="{BOTTOM}" y2="{BOTTOM}"/>{"".join(drawn)}'
        f'<text x="0" y="{HEIGHT - 4}">{escape(first)}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT - 4}" text-anchor="end">{escape(last)}</text></svg></div>'
    )


def _point(x: float, y: float) -> str:
    return f"{x:.1f},{y:.1f}"


def _scale(
    values: Sequence[float], start: float, end: float, *, log: bool = False
) -> Callable[[float], float]:
    """A function from values to positions on an axis."""
    turn = math.log if log else float
    low, high = turn(min(values)), turn(max(values))
    span = (high - low) or 1.0
    return lambda value: start + (end - start) * (turn(value) - low) / span
