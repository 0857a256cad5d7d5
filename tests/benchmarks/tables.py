"""Tables of figures between two marks of a page, so that a script can renew them."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path

import warp as wp

DOCS = Path(__file__).parents[2] / "docs"


def markdown(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def machine() -> str:
    """What measured, as a sentence; says so if others were at work too."""
    cores, load = os.cpu_count() or 1, os.getloadavg()[0]
    names = [line for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    name = names[0].partition(":")[2].strip() if names else platform.machine()
    said = f"Measured on {cores} cores of {name}, Python {platform.python_version()}, Warp "
    said += f"{wp.__version__}"
    busy = f"; the machine was busy (load {load:.0f}), so seconds are too long"
    return said + (busy if load > 1.5 * cores else "") + "."


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).exists() else []


def renew(page: Path, name: str, text: str) -> None:
    """Replace what is between `<!-- name -->` and `<!-- end name -->`."""
    content = page.read_text("utf-8")
    first, last = f"<!-- {name} -->", f"<!-- end {name} -->"
    before, found, rest = content.partition(first)
    _, ended, after = rest.partition(last)
    if not (found and ended):
        raise ValueError(f"{page} has no marks {first} and {last}")
    page.write_text(f"{before}{first}\n{text.strip()}\n\n{machine()}\n{last}{after}", "utf-8")
