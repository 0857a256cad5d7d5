"""Makes the report of a sweep: a table for the terminal, and an HTML page with thumbnails."""

import base64
import html
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import Row

PAGE = "report.html"
SHOWN = 600
"""Maximum number of thumbnails on the page."""
BARS = 12
MEASURES = (
    ("seconds.clip", "wall time per clip, with compilation [s]"),
    ("largest_force", "largest force on a wall [N]"),
    ("own_error", "error bound measured for the clip itself [object sizes]"),
    ("expected_error", "error bound from similar scenes, for all other clips [object sizes]"),
    ("energy_gain", "energy gained / energy supplied (below 0: energy lost)"),
    ("bytes", "bytes per clip"),
)
STYLE = """
:root { color-scheme: light dark; font: 15px/1.45 system-ui, sans-serif; }
body { margin: 2rem auto; max-width: 70rem; padding: 0 1rem; overflow-wrap: anywhere; }
table { border-collapse: collapse; margin: 1rem 0; }
td, th { padding: .2rem .8rem; text-align: right; border-bottom: 1px solid #8884; }
td:first-child, th:first-child { text-align: left; }
.sheet { display: grid; grid-template-columns: repeat(auto-fill, minmax(96px, 1fr)); gap: 6px; }
.sheet figure { margin: 0; } .sheet img { width: 100%; border-radius: 4px; background: #fff; }
figcaption { font-size: 11px; overflow-wrap: anywhere; }
.bars { display: flex; align-items: end; height: 90px; gap: 2px; max-width: 36rem; }
.bars i { flex: 1; background: #4a7fb5; min-height: 1px; }
"""


def summarise(storage: Storage) -> dict[str, Any]:
    """Return the report as plain data.

    `measures` has the percentiles 5, 50 and 95 of each measure, and `by` has the number of clips
    and their mean time [s] for each value of each axis.

    Raises:
        InputError: The folder contains no results of a sweep.
    """
    rows = read_manifest(storage)
    done = [row for row in rows if row["status"] == "done"]
    return {
        "clips": len(rows),
        "statuses": _statuses(rows),
        "measures": {
            name: np.percentile(values, [5, 50, 95]).tolist()
            for name, _ in MEASURES
            if len(values := _values(done, name))
        },
        "by": {
            name: {value: [len(group), _mean_seconds(group)] for value, group in groups.items()}
            for name, groups in _by_axis(done)
        },
        "reasons": dict(_reasons(rows).most_common()),
    }


def format_lines(summary: dict[str, Any]) -> list[str]:
    """Format the data of `summarise` as lines of text for the terminal."""
    lines = [f"{summary['clips']} clips: {_count(summary['statuses'])}"]
    for name, words in MEASURES:
        if values := summary["measures"].get(name):
            low, mid, high = values
            lines.append(f"  {words:<42} median {mid:.4g}, 5 to 95 %: {low:.4g} to {high:.4g}")
    for name, groups in summary["by"].items():
        lines.append(f"  by {name}:")
        for value, (count, seconds) in groups.items():
            lines.append(f"    {value:<40.40} {count:6} clips, {seconds:.3g} s each")
    lines += [f"  {count} x {why}" for why, count in [*summary["reasons"].items()][:10]]
    return lines


def write_page(storage: Storage) -> str:
    """Write the HTML page of the report, and return its address.

    Raises:
        InputError: The folder contains no results of a sweep.
    """
    rows = read_manifest(storage)
    done = [row for row in rows if row["status"] == "done"]
    parts = [
        f"<h1>{len(rows)} clips</h1><p>{html.escape(_count(_statuses(rows)))}</p>",
        *(_distribution(words, _values(done, name)) for name, words in MEASURES),
        *(_table(name, groups) for name, groups in _by_axis(done)),
        _refusals(_reasons(rows)),
        _sheet(storage, done),
    ]
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Sweep</title>'
        '<meta name="viewport" content="width=device-width">'
        f"<style>{STYLE}</style><body>{''.join(parts)}</body></html>"
    )
    storage.write(PAGE, page.encode())
    return storage.place(PAGE)


def _statuses(rows: Iterable[Row]) -> dict[str, int]:
    return dict(sorted(Counter(row["status"] for row in rows).items()))


def _mean_seconds(rows: Iterable[Row]) -> float:
    return float(np.mean(_values(rows, "seconds.clip")))


def _count(statuses: dict[str, int]) -> str:
    return ", ".join(f"{count} {status}" for status, count in statuses.items())


def _values(rows: Iterable[Row], name: str) -> Any:
    return np.array([row[name] for row in rows if row.get(name) is not None], dtype=float)


def _by_axis(rows: list[Row]) -> Iterator[tuple[str, dict[str, list[Row]]]]:
    columns = [name for name in rows[0] if name.startswith("set.")] if rows else []
    for name in ("picture", "generator", *columns):
        groups: defaultdict[str, list[Row]] = defaultdict(list)
        for row in rows:
            groups[_format(row.get(name))].append(row)
        if 1 < len(groups) <= 20:
            yield name.removeprefix("set."), dict(groups)


def _reasons(rows: Iterable[Row]) -> Counter[str]:
    return Counter(f"{row['status']}: {row['sentence']}" for row in rows if row.get("sentence"))


def _distribution(words: str, values: Any) -> str:
    if not len(values):
        return ""
    counts, edges = np.histogram(values, BARS)
    bars = "".join(
        f'<i style="height:{100 * count / counts.max():.0f}%" '
        f'title="{low:.4g} to {high:.4g}: {count}"></i>'
        for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True)
    )
    ends = f"{edges[0]:.4g} to {edges[-1]:.4g}, median {np.median(values):.4g}"
    return f'<h2>{html.escape(words)}</h2><div class="bars">{bars}</div><p>{ends}</p>'


def _table(name: str, groups: dict[str, list[Row]]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(value)}</td><td>{len(group)}</td>"
        f"<td>{_mean_seconds(group):.3g}</td></tr>"
        for value, group in groups.items()
    )
    head = f"<tr><th>{html.escape(name)}</th><th>clips</th><th>seconds each</th></tr>"
    return f"<table>{head}{rows}</table>"


def _refusals(reasons: Counter[str]) -> str:
    if not reasons:
        return ""
    items = "".join(
        f"<li>{count} x {html.escape(why)}</li>" for why, count in reasons.most_common(50)
    )
    return f"<h2>Not made, or stopped early</h2><ul>{items}</ul>"


def _sheet(storage: Storage, rows: list[Row]) -> str:
    chosen = rows if len(rows) <= SHOWN else [rows[i * len(rows) // SHOWN] for i in range(SHOWN)]
    columns = [name for name in rows[0] if name.startswith("set.")] if rows else []
    differ = [name for name in columns if len({str(row.get(name)) for row in rows}) > 1]
    figures = []
    for row in chosen:
        picture = base64.b64encode(storage.read(f"{row['folder']}/thumbnail.webp")).decode()
        values = [f"{name.removeprefix('set.')} {_format(row.get(name))}" for name in differ]
        words = html.escape(", ".join([f"{row['index']}", *values]))
        figures.append(
            f'<figure><img loading="lazy" alt="clip {row["index"]}" '
            f'src="data:image/webp;base64,{picture}"><figcaption>{words}</figcaption></figure>'
        )
    return f'<h2>The clips</h2><div class="sheet">{"".join(figures)}</div>'


def _format(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
