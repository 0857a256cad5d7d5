"""Writes the summary of a folder of results, with measured and estimated values."""

import json
from pathlib import Path
from typing import Any

PAPER_CLIP, PAPER_GENERATORS = 15.67, 23.89
"""Seconds of the paper on an A40: dynamics of a clip, and picture to Gaussians."""
ESTIMATES = {
    "A40": "substep of 65,536 neo-Hookean particles 155 us as it was, 70 us after the fixes; "
    "the paper's clip 1.3 s, then 0.6 s",
    "H100": "substep of 65,536 neo-Hookean particles 80 us as it was, 45 us after the fixes",
}
"""Card -> estimates from machine code and roofline, to be beaten."""


def rows_of(folder: Path, piece: str) -> list[dict[str, Any]]:
    """The JSON lines that a piece printed."""
    path = folder / f"{piece}.jsonl"
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines if line.startswith("{")]


def summary(folder: Path, pieces: list[dict[str, Any]]) -> str:
    """The page, in Markdown."""
    parts = ["# Evidence of one machine", _table(pieces), "## Estimates to beat"]
    parts += [f"- {card}: {words}" for card, words in ESTIMATES.items()]
    parts.append(f"- the paper, A40: clip {PAPER_CLIP} s, generators {PAPER_GENERATORS} s")
    for piece in (
        "facts",
        "compiling",
        "substep",
        "clip",
        "laws",
        "forecasts",
        "pictures",
        "render",
        "physgaussian",
        "generators",
    ):
        rows = rows_of(folder, piece)
        if rows:
            parts += [f"## {piece.capitalize()}", *map(_table, _alike(rows))]
    parts += _last_lines(folder / "tests.jsonl")
    return "\n\n".join(parts) + "\n"


def _alike(rows: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Rows that follow each other and have the same keys."""
    groups: list[list[dict[str, Any]]] = []
    for row in rows:
        if groups and groups[-1][0].keys() == row.keys():
            groups[-1].append(row)
        else:
            groups.append([row])
    return groups


def _table(rows: list[dict[str, Any]]) -> str:
    if not rows:
        return "Nothing was run."
    heads = list(rows[0])
    lines = [heads, ["---"] * len(heads), *([_text(row[head]) for head in heads] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _text(value: Any) -> str:
    return str(value).replace("\n", "; ").replace("|", "/")


def _last_lines(path: Path) -> list[str]:
    """Return the last line of pytest's output."""
    if not path.exists():
        return []
    return ["## Tests", *path.read_text("utf-8").strip().splitlines()[-1:]]
