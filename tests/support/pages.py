"""The pages of the documentation, and the paragraphs and blocks on them."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *(
        page
        for page in sorted((ROOT / "docs").rglob("*.md"))
        if not {"api", "generated"} & {*page.parts}
    ),
    ROOT / "CONTRIBUTING.md",
]
"""Pages that are written by hand; the API reference is made from docstrings."""
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", re.M | re.S)


class Block(NamedTuple):
    """A block of code on a page, and the words after the opening fence."""

    page: Path
    words: list[str]
    text: str


def blocks() -> list[Block]:
    """Return all blocks, in the order of the pages."""
    return [
        Block(page, info.split(), text)
        for page in PAGES
        for info, text in BLOCK.findall(page.read_text("utf-8"))
    ]


def paragraphs(text: str) -> Iterator[str]:
    """Return the paragraphs and list items of a page, without tables and code, one per line."""
    for part in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", BLOCK.sub("\n", text)):
        lines = part.strip().splitlines()
        if lines and not lines[0].lstrip().startswith(("|", "#", "<!--", "---")):
            yield " ".join(line.strip() for line in lines)


def count_words(text: str) -> int:
    """Return the number of words in prose, tables and code, without numbers."""
    return sum(any(map(str.isalpha, word)) for word in text.split())
