"""The tables of experiments: as text for a terminal, and as a page in Markdown with plots."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phy124.io.files import replacing
from phy124.studies.validation.experiments.outcome import Found, Outcome
from phy124.studies.validation.experiments.plots import save_plot

PathLike = str | os.PathLike[str]
HEAD = """# Against the world's experiments

`phy124 validate` repeats experiments and theories of others with the solver that makes the clips
(`phy124/studies/validation/experiments/`). `phy124 validate --docs` wrote this page; nothing
is typed in by hand. `phy124 accuracy --verify` shows that the equations are solved
([accuracy](accuracy.md)); this shows whether they describe the world.

- **Three grids** each, and Richardson's value for a grid without error. Its estimated error is its
  distance from the finest grid's value, and their scatter. Where grids do not converge, it is the
  finest value and their spread.
- **A band**: what sources or theory leave open. A value is in it give or take its own error; the
  table says where it is so only by that error.
- **A control** with a deliberate mistake, on the coarsest grid: it must leave the band of at least
  one quantity by more than that grid's error, otherwise the comparison would prove nothing.
- **What misses its band** is said to, with the reason as far as it was found.
"""


def summary(outcome: Outcome) -> str:
    """One experiment in a line for a terminal."""
    name, verdict = outcome.experiment.name, outcome.verdict
    return f"{name:<16}{verdict:<22}{outcome.seconds:7.1f} s"


def details(outcome: Outcome) -> list[str]:
    """Its quantities and what there is to say about them, a line each."""
    rows = [f"    {failure}" for failure in outcome.failures]
    for each in outcome.found:
        seen = "" if math.isnan(each.control) else _number(each.control)
        where = "in by error" if each.by_its_error else "in the band"
        rows.append(
            f"    {where if each.inside else 'OUTSIDE':<13}{each.quantity.name:<36}"
            f"{_number(each.value):>8} ± {_number(each.error):<8} published {_band(each)}"
            f"{'; control ' + seen if seen else ''}"
        )
    if outcome.missed and outcome.experiment.reason:
        rows.append(f"    why: {outcome.experiment.reason}")
    return rows


def data(outcome: Outcome) -> dict[str, Any]:
    """The outcome as plain data."""
    return {
        "name": outcome.experiment.name,
        "verdict": outcome.verdict,
        "good": outcome.good,
        "control_holds": outcome.control_holds,
        "seconds": round(outcome.seconds, 2),
        "grids": list(outcome.experiment.grids),
        "failures": list(outcome.failures),
        "quantities": [_row(each) for each in outcome.found],
    }


def _row(each: Found) -> dict[str, Any]:
    return {
        "name": each.quantity.name,
        "published": each.quantity.published,
        "band": [each.quantity.low, each.quantity.high],
        "levels": list(each.levels),
        "value": each.value,
        "error": each.error,
        "order": each.order,
        "inside": each.inside,
        "control": None if math.isnan(each.control) else each.control,
    }


def save_page(
    outcomes: Sequence[Outcome], page: PathLike, plots: PathLike, *, machine: str
) -> None:
    """Write the page and a plot per experiment.

    Args:
        outcomes: What the experiments found.
        page: The Markdown file.
        plots: Folder of the SVG files.
        machine: What measured, in a sentence.

    Raises:
        InputError: matplotlib is not installed.
    """
    plots, page = Path(plots), Path(page)
    plots.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        if outcome.found:
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
            o.verdict if o.failures else f"{o.inside} of {len(o.found)}",
            _worst(o),
            "leaves it" if o.control_holds else "**stays in it**",
            f"{o.seconds:.0f}",
        ]
        for o in outcomes
    ]
    return _markdown(heads, rows)


def _worst(outcome: Outcome) -> str:
    """The quantity farthest from its published value among those outside their bands."""
    if not outcome.missed:
        return ""
    worst = max(outcome.missed, key=lambda each: abs(each.deviation))
    return f"{worst.quantity.name}: {100 * worst.deviation:+.1f} %"


def _section(outcome: Outcome, link: str) -> str:
    """Everything about one experiment."""
    e = outcome.experiment
    said = [
        f"## {e.title}\n",
        f"{e.measured}\n",
        f"- Source: {e.source}.",
        f"- Band: {e.band}.",
        f"- Control: {e.mistake}.",
        f"- Cells across {e.across}: {', '.join(map(str, e.grids))}; {outcome.seconds:.0f} s.",
    ]
    if outcome.missed:
        said.append(f"- **Outside:** {e.reason or 'the reason is not known.'}")
    if outcome.failures:
        return "\n".join([*said, *(f"- **Failed:** {each}" for each in outcome.failures), ""])
    unit = f" [{e.unit}]" if e.unit else ""
    heads = [
        f"quantity{unit}", "published", "band", *(f"{n} cells" for n in e.grids), "limit", "off",
        "order", "", "control",
    ]  # fmt: skip
    table = _markdown(heads, [_cells(each) for each in outcome.found])
    return "\n".join([*said, "", table, f"![{e.title}]({link}/{e.name}.svg)\n"])


def _cells(each: Found) -> list[str]:
    q, near_zero = each.quantity, each.quantity.published == 0
    seen = "" if math.isnan(each.control) else _number(each.control)
    return [
        q.name, _number(q.published), f"{_number(q.low)} to {_number(q.high)}",
        *map(_number, each.levels), f"{_number(each.value)} ± {_number(each.error)}",
        "" if near_zero else f"{100 * each.deviation:+.1f} %",
        "" if each.order is None else f"{each.order:.1f}",
        ("in by its error" if each.by_its_error else "in") if each.inside else "**outside**",
        f"{seen}{' (leaves)' if each.control_outside else ''}",
    ]  # fmt: skip


def _band(each: Found) -> str:
    return f"{_number(each.quantity.low)} to {_number(each.quantity.high)}"


def _number(value: float) -> str:
    """A number with four digits, or the thousandths of what is about one."""
    return f"{value:.4g}" if abs(value) >= 0.1 else f"{value:.4f}"


def _anchor(title: str) -> str:
    """The anchor that Markdown gives to a heading."""
    kept = (c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")
    return "".join(kept)


def _markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(each) + " |" for each in lines) + "\n"
