"""Format a run's report as HTML: stage times, effects that were computed or omitted, stability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

from phy124.accuracy import Stop
from phy124.accuracy.promises import Promise, format_percent
from phy124.imaging.cutout import title_of
from phy124.scene import Scene

from .forecast import describe_error, format_seconds, promise_of
from .studies import Measurement

WIDTH, HEIGHT, TALL, MARGIN = 280, 84, 130, 4


def summarise(report: dict[str, Any], promise: Promise) -> list[dict[str, Any]]:
    """Summarise a run for a visitor: its time, its error, and the largest strain or a problem."""
    lines: list[dict[str, Any]] = [{"text": f"It took {format_seconds(report['seconds'])}."}]
    lines.append({"text": describe_error(promise)})
    if report.get("stopped"):
        lines.append({"text": f"It stopped early: {report['stopped']}", "warn": True})
    elif report.get("balance", {}).get("tearing", {}).get("likely"):
        lines.append({"text": "The material may have torn.", "warn": True})
    elif volumes := (report.get("motion") or {}).get("min_J"):
        lines.append({"text": _describe_squeeze(min(volumes))})
    return lines


def _describe_squeeze(volume: float) -> str:
    # The smallest volume of all particles depends on the grid, so the sentence states no number.
    if volume > 0.97:
        return "No part of the object was noticeably compressed."
    return f"Parts of the object were {'' if volume > 0.5 else 'strongly '}compressed."


def describe_finer(stop: Stop, promise: Promise) -> str:
    """Describe the time and the error bound of a finer run of the same motion.

    Args:
        stop: Predicted time and error bound of the finer run.
        promise: Error bound of the finished run. If its error was estimated, errors of similar
            scenes say less than this estimate, and are omitted.
    """
    time = f"about {format_seconds(stop.seconds)}"
    if stop.error is None or stop.promise.of_scene != promise.of_scene:
        return time
    return f"{time}, {stop.promise.off(stop.pixels)}"


def as_html(
    report: dict[str, Any],
    scene: dict[str, Any],
    predicted: float,
    stops: Sequence[Stop] = (),
    study: Measurement | None = None,
) -> str:
    """Format a report for the page; all text in it is escaped.

    Args:
        report: The content of report.json.
        scene: The scene as plain data.
        predicted: Predicted time [s].
        stops: Time and error of each named accuracy.
        study: Errors measured on this scene; None if none were measured.
    """
    promise, parts = promise_of(Scene.from_data(scene), None, study, report), []
    if report.get("stopped"):
        parts.append(f'<p class="notice">Stopped early: {escape(str(report["stopped"]))}</p>')
    parts += [f'<p class="note">{escape(str(note))}</p>' for note in report.get("notes", [])]
    parts += [_accuracy(report, scene, predicted, promise), _pareto(report, promise, stops)]
    parts += [_cut_out(report), _file(report), _objects(report), _stages(report), _motion(report)]
    parts += [_effects(report), _left_out(report)]
    return f'<div class="report">{"".join(parts)}</div>'


def _accuracy(
    report: dict[str, Any], scene: dict[str, Any], predicted: float, promise: Promise
) -> str:
    name = scene.get("accuracy")
    rows = [
        ("Accuracy", name if isinstance(name, str) else "custom"),
        promise.row,
        ("Predicted time", f"{predicted:.1f} s"),
        ("Time", f"{report['seconds']:.1f} s"),
        ("Gaussians", f"{report['gaussians']:,}"),
        ("Particles", f"{report['particles']:,}"),
        ("Substeps", f"{report['substeps']:,}"),
        ("Device", report["device"]),
    ]
    return _section("Accuracy and cost", _table(rows))


def _pareto(report: dict[str, Any], promise: Promise, stops: Sequence[Stop]) -> str:
    reached = promise.error
    known = [(stop, stop.error) for stop in stops if stop.error]
    if not known or not reached:
        return ""
    run = (float(report["seconds"]), reached)
    points = [(stop.seconds, error) for stop, error in known]
    x = _scale([a for a, _ in [*points, run]], 2 * MARGIN, WIDTH - 2 * MARGIN)
    y = _scale([b for _, b in [*points, run]], TALL - 26, 26)
    marks = [
        f'<circle class="stop" cx="{x(a):.1f}" cy="{y(b):.1f}" r="3.5"/>'
        f'<text x="{x(a):.1f}" y="{y(b) - 7:.1f}" text-anchor="{_anchor(x(a))}">'
        f"{escape(stop.name)}, {format_percent(error)}, {stop.seconds:.0f} s</text>"
        for (stop, error), (a, b) in zip(known, points, strict=True)
    ]
    line = " ".join(f"{x(a):.1f},{y(b):.1f}" for a, b in points)
    here = f'<circle class="reached" cx="{x(run[0]):.1f}" cy="{y(run[1]):.1f}" r="5.5"/>'
    label = f"this run: {run[0]:.1f} s, error {promise.size('the size')}"
    return _section(
        "Accuracy over time",
        f'<svg viewBox="0 0 {WIDTH} {TALL}" role="img" aria-label="{escape(label)}">'
        f'<line class="axis" x1="0" x2="{WIDTH}" y1="{TALL - 14}" y2="{TALL - 14}"/>'
        f'<polyline class="curve" points="{line}"/>{"".join(marks)}{here}'
        f'<text x="{MARGIN}" y="{TALL - 3}">{escape(label)}</text></svg>',
    )


def _scale(values: Sequence[float], start: float, end: float) -> Any:
    low, high = math.log(min(values)), math.log(max(values))
    span = (high - low) or 1.0
    return lambda value: start + (end - start) * (math.log(value) - low) / span


def _anchor(x: float) -> str:
    return "start" if x < WIDTH / 3 else "end" if x > 2 * WIDTH / 3 else "middle"


def _stages(report: dict[str, Any]) -> str:
    seconds = {stage["name"]: stage["seconds"] for stage in report["stages"]}
    longest = max(seconds.values(), default=0) or 1
    rows = [
        f"<tr><td>{escape(name)}<span class='share' style='width:"
        f"{100 * each / longest:.0f}%'></span></td><td>{each:.2f} s</td></tr>"
        for name, each in seconds.items()
    ]
    return _section("Time of each stage", f"<table>{''.join(rows)}</table>")


def _cut_out(report: dict[str, Any]) -> str:
    cutout = report.get("cutout")
    if not cutout:
        return ""
    rows = [
        ("Method", title_of(cutout["method"])),
        ("Fraction of the picture", f"{cutout['coverage']:.1%}"),
    ]
    if "compose" in report:
        rows.append(("In the photograph", f"{report['compose']['psnr']:.1f} dB in the first frame"))
    return _section("Cut-out", _table([*rows, *(("Doubt", d) for d in cutout["warnings"])]))


def _file(report: dict[str, Any]) -> str:
    file = report.get("file")
    if not file:
        return ""
    rows = [("Format", report["generator"]), ("Up, front", f"{file['up']}, {file['front']}")]
    rows += [("Probably written by", file["program"])] if file["program"] else []
    return _section("File", _table([*rows, *(("Note", note) for note in report["cleaning"])]))


def _objects(report: dict[str, Any]) -> str:
    rows = []
    for name, body in (report.get("objects") or {}).items():
        cutout = (report.get("sources") or {}).get(name, {}).get("cutout")
        how = f", cut out by {title_of(cutout['method'])}" if cutout else ""
        rows.append((name, f"{body['gaussians']:,} Gaussians, {body['mass']:.3g} kg{how}"))
    for pair, met in (report.get("pairs") or {}).items():
        rows.append((pair.replace("_", " "), f"at most {met['largest_force']:.3g} N"))
    return _section("Objects", _table(rows)) if rows else ""


def _motion(report: dict[str, Any]) -> str:
    motion = report.get("motion") or {}
    if not motion.get("time"):
        return ""
    rows = [
        ("Smallest volume ratio J", f"{min(motion['min_J']):.3f}"),
        ("Largest speed", f"{max(motion['max_speed']):.2f} m/s"),
        ("Largest kinetic energy", f"{max(motion['kinetic_energy']):.3g} J"),
    ]
    balance = report.get("balance") or {}
    if balance.get("energy_gain") is not None:
        gain = balance["energy_gain"]
        label = "Spurious energy" if gain > 0 else "Energy lost (material, contact, numerics)"
        rows.append((label, f"{abs(gain):.2%}"))
    if balance.get("momentum_gain") is not None:
        rows.append(("Spurious momentum", f"{balance['momentum_gain']:.2%}"))
    curve = _plot(motion["time"], motion["kinetic_energy"], "kinetic energy [J]")
    volumes = _plot(motion["time"], motion["min_J"], "smallest J")
    return _section("Stability", _table(rows) + curve + volumes)


def _effects(report: dict[str, Any]) -> str:
    rows = [
        (stage["name"], f"{stage['seconds']:.2f} s in {stage['launches']:,}")
        for stage in report.get("substep_stages", [])
    ]
    return _section("Effects that ran", _table(rows)) if rows else ""


def _left_out(report: dict[str, Any]) -> str:
    rows = []
    for omission in report.get("effects", {}).get("left_out", []):
        saved = omission.get("saved_seconds")
        why = str(omission["why"]) + (f", saved {saved:.2f} s" if saved else "")
        rows.append(
            f"<tr><td>{escape(omission['effect'])}</td><td class='why'>{escape(why)}</td></tr>"
        )
    return _section("Left out", f"<table>{''.join(rows)}</table>") if rows else ""


def _section(title: str, body: str) -> str:
    return f"<section><h3>{escape(title)}</h3>{body}</section>"


def _table(rows: Sequence[tuple[str, Any]]) -> str:
    # Values that have the same name share a row.
    table: dict[str, list[str]] = {}
    for name, value in rows:
        table.setdefault(name, []).append(str(value))
    cells = (
        f"<tr><td>{escape(k)}</td><td>{escape(' '.join(v))}</td></tr>" for k, v in table.items()
    )
    return f"<table>{''.join(cells)}</table>"


def _plot(x: Sequence[float], y: Sequence[float], label: str) -> str:
    low, high, span = min(y), max(y), (x[-1] - x[0]) or 1.0
    height = (high - low) or 1.0
    top, bottom = 16, HEIGHT - 14
    points = " ".join(
        f"{MARGIN + (WIDTH - 2 * MARGIN) * (a - x[0]) / span:.1f},"
        f"{bottom - (bottom - top) * (b - low) / height:.1f}"
        for a, b in zip(x, y, strict=True)
    )
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(label)} over time, '
        f'from {low:.3g} to {high:.3g}"><line class="axis" x1="0" x2="{WIDTH}" y1="{bottom}" '
        f'y2="{bottom}"/><polyline class="curve" points="{points}"/>'
        f'<text x="{MARGIN}" y="10">{escape(label)}, {low:.3g} to {high:.3g}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT - 2}" text-anchor="end">{x[-1]:.2f} s</text></svg>'
    )
