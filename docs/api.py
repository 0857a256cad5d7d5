"""Write the API reference from the docstrings before Sphinx reads the pages.

Each module and each folder directly in `phy124/` has a page, and so have the web page and the
bridge. griffe reads the sources without importing them, so that neither torch nor Warp is needed.
Names that begin with an underscore and the modules in `LEFT_OUT` are omitted. Sphinx's Python
domain is not used, since it resolves every annotation of every signature and takes a hundred times
as long.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from logging import Handler, LogRecord, getLogger
from pathlib import Path

import griffe
from sphinx.application import Sphinx
from sphinx.util import logging

HERE = Path(__file__).parent
PAGES = HERE / "reference/api"
LEFT_OUT = {
    "phy124.commands",
    "phy124.schema.arguments",
    "phy124.studies.validation.stress",
}
"""Modules without a page: the command line, and modules that only phy124 itself uses."""
PROGRAMS = ("demo", "bridge")
"""Further packages; each of them has a page."""
WIDTH = 90
"""Maximum number of characters in a line of a signature."""
CODE = re.compile(r"(`[^`]*`)")
SPECIAL = re.compile(r"([*_<>\[\]])")


class _Warnings(Handler):
    """Passes griffe's messages about wrong docstrings to Sphinx as warnings."""

    def emit(self, record: LogRecord) -> None:
        logging.getLogger(__name__).warning(record.getMessage())


def write_pages(app: Sphinx | None = None) -> None:
    """Write all pages."""
    package, *programs = (_read(name) for name in ("phy124", *PROGRAMS))
    getLogger("griffe").handlers = [_Warnings("WARNING")]
    PAGES.mkdir(exist_ok=True)
    rooms = _inside(package) + programs
    for page in PAGES.glob("*.md"):
        page.unlink()
    for room in rooms:
        (PAGES / f"{room.name}.md").write_text("\n".join(_module(room, "#")), "utf-8")
    (PAGES / "index.md").write_text("\n".join(_contents(package, rooms)), "utf-8")


def _read(package: str) -> griffe.Module:
    """Load a package with griffe and return it."""
    return griffe.load(
        package, search_paths=[HERE.parent], docstring_parser="google", allow_inspection=False
    )


def _contents(package: griffe.Module, rooms: list[griffe.Module]) -> Iterator[str]:
    yield from ["# API", "", _text(package), "", "| name | what it is |", "|---|---|"]
    for name in package.exports or ():
        room = package[name].target_path.split(".")[1]
        yield f"| [phy124.{name}]({room}.md) | {_summary(package[name])} |"
    yield from ["", "| module | what it is |", "|---|---|"]
    yield from (f"| [{room.path}]({room.name}.md) | {_summary(room)} |" for room in rooms)
    yield from ["", "```{toctree}", ":hidden:", ":glob:", "", "*", "```", ""]


def _module(module: griffe.Module, level: str) -> Iterator[str]:
    yield from [f"{level} {module.path}", "", _text(module), ""]
    aliases = [name for name, member in module.members.items() if member.is_alias]
    if names := [name for name in module.exports or () if str(name) in aliases]:
        yield from ["Gives " + ", ".join(f"`{name}`" for name in names) + ".", ""]
    for member in _public(module):
        yield from _member(member, level + "#")
    for inner in _inside(module):
        yield from _module(inner, "##")  # nested folders have the same level


def _inside(module: griffe.Module) -> list[griffe.Module]:
    """Return the public submodules of a module by name, without modules that it imports."""
    modules = [inner for inner in module.modules.values() if not inner.is_alias]
    public = [m for m in modules if not m.name.startswith("_") and m.path not in LEFT_OUT]
    return sorted(public, key=lambda inner: inner.name)


def _public(owner: griffe.Module | griffe.Class) -> list[griffe.Object]:
    """Return the public members with docstrings in the order of the source, values first."""
    members = [member for member in owner.members.values() if not member.is_alias]
    public = [m for m in members if not m.name.startswith("_") and not m.is_module]
    documented = [member for member in public if member.has_docstring]
    return sorted(documented, key=lambda member: (not member.is_attribute, member.lineno or 0))


def _member(member: griffe.Object, level: str) -> Iterator[str]:
    if member.is_attribute:
        yield from _attribute(member)
        return
    owner = f"{member.parent.name}." if member.parent.is_class else ""
    yield from [f"{level} {owner}{member.name}", "", "```python", _signature(member), "```", ""]
    yield from [_text(member), ""]
    if member.is_class:
        for inner in _public(member):
            yield from _member(inner, level + "#")


def _attribute(attribute: griffe.Attribute) -> Iterator[str]:
    kind = f": `{attribute.annotation}`" if attribute.annotation else ""
    lines = _text(attribute).splitlines()
    yield from [f"- **`{attribute.name}`**{kind}", ""]
    yield from [*(f"  {line}".rstrip() for line in lines), ""]


def _signature(member: griffe.Object) -> str:
    if member.is_class:
        bases = ", ".join(str(base) for base in member.bases)
        return f"class {member.name}({bases})" if bases else f"class {member.name}"
    line = f"def {member.signature()}"
    if len(line) <= WIDTH:
        return line
    head, inner, tail = re.fullmatch(r"([^(]*\()(.*)(\)(?: -> .*)?)", line, re.S).groups()
    parameters = re.split(r", (?=\*{0,2}\w+[:=,]|\*,|/,|\*{0,2}\w+$)", inner)
    return "\n".join([head, *(f"    {parameter}," for parameter in parameters), tail])


def _summary(documented: griffe.Object | griffe.Alias) -> str:
    """Return the first paragraph of a docstring as a single line, for a cell of a table."""
    return _text(documented).split("\n\n")[0].replace("\n", " ").replace("|", r"\|")


def _text(documented: griffe.Object) -> str:
    """Return a docstring as Markdown."""
    if documented.docstring is None:
        return ""
    return "\n\n".join(_section(section) for section in documented.docstring.parsed)


def _section(section: griffe.DocstringSection) -> str:
    if section.kind is griffe.DocstringSectionKind.text:
        return _escape(section.value)
    if section.kind is griffe.DocstringSectionKind.admonition:
        return f"{section.title}: {_escape(section.value.contents)}"
    rows = [f"**{section.kind.value.capitalize()}**", ""]
    for row in section.value:
        name = getattr(row, "name", "") or row.annotation
        rows.append(f"- `{name}`: " + _escape(row.description).replace("\n", " "))
    return "\n".join(rows)


def _escape(text: str) -> str:
    """Escape the characters that are markup in Markdown, except in `code` and indented formulae."""
    lines = []
    for line in text.splitlines():
        parts = CODE.split(line)
        if not line.startswith("    "):
            parts[::2] = [SPECIAL.sub(r"\\\1", part) for part in parts[::2]]
        lines.append("".join(parts))
    return "\n".join(lines)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register `write_pages`, which Sphinx calls when it starts."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
