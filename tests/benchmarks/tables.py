"""Tables of figures between two marks of a page, so that a script can renew them."""

from collections.abc import Sequence
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def markdown(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def renew(page: Path, name: str, text: str) -> None:
    """Replace what is between `<!-- name -->` and `<!-- end name -->`."""
    content = page.read_text("utf-8")
    first, last = f"<!-- {name} -->", f"<!-- end {name} -->"
    before, found, rest = content.partition(first)
    _, ended, after = rest.partition(last)
    if not (found and ended):
        raise ValueError(f"{page} has no marks {first} and {last}")
    page.write_text(f"{before}{first}\n{text.strip()}\n{last}{after}", "utf-8")
