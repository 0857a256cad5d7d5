"""Formats the outcomes of experiments as text, and as a Markdown page with plots."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.io.files import replacing
from phy124.runtime.installation import install_command
from phy124.studies.validation.experiments.experiment import Estimate, Outcome

BLUE, ORANGE, GREEN = "#2563a8", "#c2571a", "#2c8a4b"
SHADES = ("#c9d8ea", "#8fb0d6", "#5a8bc2")
"""Colours of the grids, from coarse to fine."""


def refuse_missing_plots() -> None:
    """Check that plots can be drawn.

    Raises:
        InputError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        limit = "plots need matplotlib, which is not installed."
        remedy = f"Run `{install_command('plots')}`, or omit --out and --docs."
        raise InputError("plots", "SVG", limit, remedy)


def save_plot(outcome: Outcome, path: PathLike) -> None:
    """Draw the outcome of an experiment as an SVG file.

    Quantities with positions on an axis form a curve; others have a row each.

    Raises:
        InputError: matplotlib is not installed.
    """
    refuse_missing_plots()
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    curve = bool(outcome.experiment.axis)
    height = 3.6 if curve else 1.2 + 0.42 * len(outcome.estimates)
    figure = Figure(figsize=(7.5, height), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.subplots()
    (_draw_curve if curve else _draw_rows)(axes, outcome)
    axes.legend(fontsize=8, frameon=False, loc="best")
    # With this setting, equal outcomes give equal files.
    fixed: Any = {"svg.hashsalt": outcome.experiment.name}
    with replacing(path) as temporary, matplotlib.rc_context(fixed):
        figure.savefig(temporary, format="svg", metadata={"Date": None})


def _draw_curve(axes: Any, outcome: Outcome) -> None:
    experiment, estimates = outcome.experiment, outcome.estimates
    places = [each.quantity.at for each in estimates]
    low, high = ([getattr(f.quantity, side) for f in estimates] for side in ("low", "high"))
    axes.fill_between(places, low, high, color=GREEN, alpha=0.25, label="published", linewidth=0)
    axes.plot(places, [f.quantity.published for f in estimates], color=GREEN, linewidth=1)
    _draw_values(axes, outcome, lambda values: (places, values), yerr=[f.error for f in estimates])
    axes.set(xlabel=experiment.axis, ylabel=experiment.unit)
    axes.grid(alpha=0.3)


def _draw_values(
    axes: Any, outcome: Outcome, at: Callable[[list[float]], tuple[Any, Any]], **errors: list[float]
) -> None:
    """Draw the values; `at` converts values, one per quantity, to x and y coordinates of points."""
    experiment, estimates = outcome.experiment, outcome.estimates
    for k, cells in enumerate(experiment.grids):
        dots = {"color": SHADES[k], "markersize": 4, "label": f"{cells} cells"}
        axes.plot(*at([f.levels[k] for f in estimates]), "o", **dots)
    style = {"fmt": "D", "color": BLUE, "capsize": 3, "label": "limit of the grids"}
    axes.errorbar(*at([f.value for f in estimates]), **errors, **style)
    controls = at([f.control for f in estimates])
    axes.plot(*controls, "x", color=ORANGE, label=experiment.mistake)


def _draw_rows(axes: Any, outcome: Outcome) -> None:
    """Draw deviations in per cent, or absolute ones if the published value is zero."""
    estimates = outcome.estimates
    rows = range(len(estimates))

    def deviate(values: list[float]) -> list[float]:
        return [
            100 * (value - f.quantity.published) / (abs(f.quantity.published) or 1.0)
            for value, f in zip(values, estimates, strict=True)
        ]

    low, high = (
        deviate([getattr(f.quantity, side) for f in estimates]) for side in ("low", "high")
    )
    widths = [b - a for a, b in zip(low, high, strict=True)]
    axes.barh(rows, widths, left=low, height=0.7, color=GREEN, alpha=0.25, label="published")
    errors = [100 * f.error / (abs(f.quantity.published) or 1.0) for f in estimates]
    _draw_values(axes, outcome, lambda values: (deviate(values), rows), xerr=errors)
    axes.set_yticks(rows, [f.quantity.name for f in estimates], fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="off the published value [%]")
    axes.grid(alpha=0.3, axis="x")


PathLike = str | os.PathLike[str]
HEAD = """# Comparison with published experiments

`phy124 validate` repeats published experiments and theories with the solvers that make the clips
(`phy124/studies/validation/experiments/`), and `phy124 validate --docs` writes this page. Elastic
bodies are simulated on lattices; experiments whose names end in `-mpm` repeat them with MPM.
`phy124 accuracy --verify` tests whether the equations are solved correctly
([accuracy](accuracy.md)). This page tests whether the equations describe real materials.

- **Grids**: Each experiment runs on three grids. The values on these grids are extrapolated to zero
  grid spacing (Richardson), which gives the *limit*. The estimated error of the limit is its
  distance from the value on the finest grid, plus the scatter. If the values on the grids do not
  converge, the limit is the value on the finest grid, and its error is the spread of the three
  values. *Off* is the deviation of the limit from the published value.
- **Band**: the range of values that the sources or the theory permit. A value outside the band
  also counts as inside if its distance from the band is smaller than its error. The tables mark
  such values with *in by its error*.
- **Control**: a run with a deliberate mistake, on the coarsest grid. At least one quantity of
  the control must be outside the band by more than the error on this grid (*leaves*). If all
  quantities stayed inside, the experiment could not detect the mistake, and agreement would prove
  nothing.
- **Values outside their band** are marked, with the reason if it is known. `phy124 validate` fails
  if a deviation is larger than the largest known deviation of the quantity.
"""


def summary(outcome: Outcome) -> str:
    """Describe the outcome of an experiment in one line."""
    name, verdict = outcome.experiment.name, outcome.verdict
    return f"{name:<20}{verdict:<22}{outcome.seconds:7.1f} s"


def details(outcome: Outcome) -> list[str]:
    """Describe the failed runs and the quantities, one per line."""
    rows = [f"    {failure}" for failure in outcome.failures]
    for each in outcome.estimates:
        seen = "" if math.isnan(each.control) else _number(each.control)
        where = "in by error" if each.by_its_error else "in the band"
        rows.append(
            f"    {where if each.inside else 'OUTSIDE':<13}{each.quantity.name:<36}"
            f"{_number(each.value):>8} ± {_number(each.error):<8} published {_band(each)}"
            f"{'; control ' + seen if seen else ''}"
        )
    return rows + [f"    why: {why}" for why in _explain(outcome)]


def _explain(outcome: Outcome) -> list[str]:
    """Return the reason for known deviations, and a sentence for each new deviation."""
    experiment, new = outcome.experiment, outcome.new
    reasons = [experiment.reason] if len(new) < len(outcome.missed) else []
    for each in new:
        known = 100 * experiment.known.get(each.quantity.name, 0.0)
        reasons.append(
            f"The deviation of {each.quantity.name}, {100 * each.deviation:+.1f} %, is new; the "
            f"largest known deviation is {known:+.1f} %."
        )
    return reasons


def data(outcome: Outcome) -> dict[str, Any]:
    """Return the outcome as plain data."""
    return {
        "name": outcome.experiment.name,
        "verdict": outcome.verdict,
        "good": outcome.good,
        "control_holds": outcome.control_holds,
        "seconds": round(outcome.seconds, 2),
        "grids": list(outcome.experiment.grids),
        "failures": list(outcome.failures),
        "new": [each.quantity.name for each in outcome.new],
        "quantities": [_row(each) for each in outcome.estimates],
    }


def _row(each: Estimate) -> dict[str, Any]:
    return {
        "name": each.quantity.name,
        "published": each.quantity.published,
        "band": [each.quantity.low, each.quantity.high],
        "levels": [_finite(level) for level in each.levels],
        "value": _finite(each.value),
        "error": _finite(each.error),
        "order": each.order,
        "inside": each.inside,
        "control": _finite(each.control),
    }


def _finite(value: float) -> float | None:
    """Return None instead of NaN and infinity, which JSON does not have."""
    return value if math.isfinite(value) else None


def save_page(
    outcomes: Sequence[Outcome], page: PathLike, plots: PathLike, *, machine: str
) -> None:
    """Write the Markdown page, and one plot per experiment.

    Args:
        outcomes: The outcomes in their order on the page.
        page: The Markdown file.
        plots: Folder of the SVG files.
        machine: A sentence that describes the computer.

    Raises:
        InputError: matplotlib is not installed.
    """
    plots, page = Path(plots), Path(page)
    plots.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        if outcome.estimates:
            save_plot(outcome, plots / f"{outcome.experiment.name}.svg")
    link = os.path.relpath(plots, page.parent).replace(os.sep, "/")
    parts = [HEAD, _overview(outcomes), machine, *(_section(each, link) for each in outcomes)]
    with replacing(page) as temporary:
        Path(temporary).write_text("\n".join(parts), "utf-8")


def _overview(outcomes: Sequence[Outcome]) -> str:
    heads = ["experiment", "in the band", "largest miss", "control", "seconds"]
    rows = [
        [
            f"[{o.experiment.name}](#{_anchor(o.experiment.title)})",
            o.verdict if o.failures else f"{o.inside} of {len(o.estimates)}",
            _worst(o),
            "leaves it" if o.control_holds else "**stays in it**",
            f"{o.seconds:.0f}",
        ]
        for o in outcomes
    ]
    return _markdown(heads, rows)


def _worst(outcome: Outcome) -> str:
    if not outcome.missed:
        return ""
    worst = max(outcome.missed, key=lambda each: abs(each.deviation))
    return f"{worst.quantity.name}: {100 * worst.deviation:+.1f} %"


def _section(outcome: Outcome, link: str) -> str:
    e = outcome.experiment
    lines = [
        f"## {e.title}\n",
        f"{e.measured}\n",
        f"- Source: {e.source}.",
        f"- Band: {e.band}.",
        f"- Control: {e.mistake}.",
        f"- Cells across {e.across}: {', '.join(map(str, e.grids))}; CPU time of all runs: "
        f"{outcome.seconds:.0f} s.",
    ]
    lines += [f"- **Outside:** {why}" for why in _explain(outcome)]
    if outcome.failures:
        return "\n".join([*lines, *(f"- **Failed:** {each}" for each in outcome.failures), ""])
    unit = f" [{e.unit}]" if e.unit else ""
    grids = [f"{n} cells" for n in e.grids]
    last = ["limit", "off", "order", "", "control"]
    heads = [f"quantity{unit}", "published", "band", *grids, *last]
    table = _markdown(heads, [_cells(each) for each in outcome.estimates])
    return "\n".join([*lines, "", table, f"![{e.title}]({link}/{e.name}.svg)\n"])


def _cells(each: Estimate) -> list[str]:
    q, near_zero = each.quantity, each.quantity.published == 0
    seen = "" if math.isnan(each.control) else _number(each.control)
    return [
        q.name,
        _number(q.published),
        _band(each),
        *map(_number, each.levels),
        f"{_number(each.value)} ± {_number(each.error)}",
        "" if near_zero else f"{100 * each.deviation:+.1f} %",
        "" if each.order is None else f"{each.order:.1f}",
        ("in by its error" if each.by_its_error else "in") if each.inside else "**outside**",
        f"{seen}{' (leaves)' if each.control_outside else ''}",
    ]


def _band(each: Estimate) -> str:
    return f"{_number(each.quantity.low)} to {_number(each.quantity.high)}"


def _number(value: float) -> str:
    """Use four significant digits, or four decimals below 0.1."""
    return f"{value:.4g}" if abs(value) >= 0.1 else f"{value:.4f}"


def _anchor(title: str) -> str:
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


def _markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(each) + " |" for each in lines) + "\n"
