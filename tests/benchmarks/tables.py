"""Writes tables of figures between two marks of a page."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path

import warp as wp

DOCS = Path(__file__).parents[2] / "docs"
LOAD = os.getloadavg()[0]
"""Load when the benchmark starts, before its own processes count."""


def markdown(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def machine() -> str:
    """Return a sentence on what measured, which says so if the machine was busy."""
    busy = f"; the machine was busy (load {LOAD:.0f}), so seconds are too long"
    return f"Measured on {processor()}" + (busy if 1.5 * (os.cpu_count() or 1) < LOAD else "") + "."


def processor() -> str:
    """Return the processor and the versions that compute, in words."""
    names = [line for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    name = names[0].partition(":")[2].strip() if names else platform.machine()
    versions = f"Python {platform.python_version()}, Warp {wp.__version__}"
    return f"{os.cpu_count() or 1} cores of {name}, {versions}"


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).exists() else []


def renew(page: Path, name: str, text: str) -> None:
    """Replace what is between `<!-- name -->` and `<!-- end name -->`, and name the machine."""
    replace_block(page, name, f"{text.strip()}\n\n{machine()}")


def replace_block(page: Path, name: str, text: str) -> None:
    """Replace the lines between `<!-- name -->` and `<!-- end name -->` of a page."""
    page.write_text(fill_block(page.read_text("utf-8"), name, text), "utf-8")


def fill_block(content: str, name: str, text: str) -> str:
    """Return a page with other lines between `<!-- name -->` and `<!-- end name -->`.

    Raises:
        ValueError: The page has no such marks.
    """
    first, last = f"<!-- {name} -->", f"<!-- end {name} -->"
    before, result, rest = content.partition(first)
    _, ended, after = rest.partition(last)
    if not (result and ended):
        raise ValueError(f"the page has no marks {first} and {last}")
    return f"{before}{first}\n{text.strip()}\n{last}{after}"
