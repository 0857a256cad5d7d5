"""Write pages of the reference from declarations in the code before Sphinx reads the pages.

The pages of the scene are written from its pydantic models, the pages of the commands from their
classes, and the page of report.json from the typed dictionary of its keys.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout, suppress
from pathlib import Path
from unittest import mock

import griffe
from sphinx.application import Sphinx

HERE = Path(__file__).parent
PAGES = HERE / "reference/generated"
COLUMNS = "100"
"""Width of a command's help text [characters]."""


def write_pages(app: Sphinx | None = None) -> None:
    """Write all pages."""
    pages = {"report": "\n".join(format_report())}
    pages |= {f"scene/{name}": text for name, text in format_scene().items()}
    pages |= {f"commands/{name}": text for name, text in format_commands().items()}
    for old in PAGES.rglob("*.md"):
        old.unlink()
    for name, text in pages.items():
        path = PAGES / f"{name}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")


def format_scene() -> dict[str, str]:
    """Return a page for each section of a scene."""
    from phy124.scene.reference import list_pages

    pages = {}
    for name, text in list_pages().items():
        head, _, rest = text.partition("\n")
        pages[name] = f"# `{name}`\n{rest if head == f'## `{name}`' else chr(10) + text}"
    return pages


def format_commands() -> dict[str, str]:
    """Return a page for each command of the two programs."""
    from phy124_bridge.commands import COMMANDS as BRIDGE

    from phy124.commands import COMMANDS

    pages = {f"phy124-{name}": _format_help("phy124", name, COMMANDS) for name in COMMANDS}
    return pages | {
        f"bridge-{name}": _format_help("phy124-bridge", name, BRIDGE) for name in BRIDGE
    }


def _format_help(program: str, name: str, commands: Mapping[str, type]) -> str:
    from phy124.schema.arguments.parsing import Answered, parse

    output = io.StringIO()
    environment = mock.patch.dict(os.environ, COLUMNS=COLUMNS, NO_COLOR="1")
    with environment, redirect_stdout(output), suppress(Answered):
        parse([name, "--help"], commands, program=program)
    return f"# `{program} {name}`\n\n```text\n{output.getvalue().strip()}\n```\n"


def format_report() -> Iterator[str]:
    """Yield the lines of the page on report.json."""
    # `griffe.load` would read all modules of the package.
    path = HERE.parent / "phy124/pipeline/report_keys.py"
    module = griffe.visit(path.stem, path, path.read_text("utf-8"))
    sections = [member for member in module.classes.values() if not member.is_alias]
    for section in reversed(sections):
        yield from [f"## {section.name}", "", section.docstring.value, ""]
        yield from ["| key | type | meaning |", "|---|---|---|"]
        for key in section.attributes.values():
            kind = str(key.annotation)
            if kind.startswith("NotRequired["):
                kind = kind.removeprefix("NotRequired[").removesuffix("]")
                kind = f"{_escape(kind)}, optional"
            else:
                kind = _escape(kind)
            meaning = key.docstring.value.replace("\n", " ")
            yield f"| `{key.name}` | {kind} | {meaning} |"
        yield ""


def _escape(kind: str) -> str:
    return "`" + kind.replace("|", "or").replace("None", "null") + "`"


def setup(app: Sphinx) -> dict[str, bool]:
    """Register `write_pages`, which Sphinx calls when it starts."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
