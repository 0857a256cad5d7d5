"""Writes the scene reference: each field with its accepted values, its default and its meaning."""

import json
from collections.abc import Iterator
from typing import Any

from phy124.errors import InputError, suggest
from phy124.scene.scene import Scene
from phy124.schema.declaration import Declaration, Node, format_number, read_declaration

HEAD = """# Scene reference

Every field of a scene file, written by `phy124 scenes --reference`. A scene file is TOML; fields
that are left out have their default. On the command line the same fields are set by their path,
`--set object.lift=0.5 forces.0.kind=wind`. Items of lists are counted from 0; the index after the
last item adds an item. `phy124 scenes NAME` prints a preset in full, as a start for a new scene.
`phy124 scenes --schema > scene.schema.json` writes a JSON schema, with which an editor completes
and checks scene files; most editors use it if a file begins with `#:schema scene.schema.json`.

```toml
{example}```
"""
EXAMPLE = """\
description = "A cake on a hard plate shakes in a gust while a ball rolls over it."
accuracy = {cells = 24}

[object]
size = 0.3  # m, the longest side
lift = 0.02

[material]
law = "neo_hookean"
E = 2e4
density = 600
damping = 20

[stiffness]  # softer towards the top
kind = "gradient"
axis = "z"
first = 1.0
last = 0.3

[[parts]]  # the plate: everything below 7 cm
region = {upper = [1.0, 1.0, 0.07]}
material = {law = "rigid"}

[[forces]]
kind = "gravity"

[[forces]]
kind = "wind"
v = [0.0, 4.0, 0.0]
end = 0.5
profile = {kind = "sine", frequency = 4.0, offset = 1.0}

[[boundaries]]
kind = "ground"
friction = 0.8

[[boundaries]]
kind = "sphere"
centre = [0.0, -0.3, 0.35]
radius = 0.08
motion = {kind = "path", times = [0.0, 1.0], points = [[0.0, 0.0, 0.0], [0.0, 0.6, 0.0]]}

[time]
frames = 24

[view]
views = ["front", "orbit"]
background = "whitesmoke"
"""


def format_reference(section: str | None = None) -> str:
    """Return the reference in Markdown, or only one section such as `material`.

    Raises:
        InputError: There is no section of this name.
    """
    pages = list_pages()
    if section is not None:
        if section not in pages:
            limit = "a scene has no such section."
            raise InputError("section", section, limit, suggest(section, [*pages]))
        return pages[section]
    return "\n".join([HEAD.format(example=EXAMPLE), *pages.values()])


def list_pages() -> dict[str, str]:
    """Return tables in Markdown by section name. The table `scene` lists the top-level fields."""
    declared, written = read_declaration(Scene), dict[str, str]()
    pages = dict[str, str]()
    for path, text in _format_section(declared, "Fields of a scene", declared.schema, "", written):
        name = path.partition(".")[0].partition("[")[0] or "scene"
        pages[name] = "\n".join(filter(None, [pages.get(name), text]))
    return pages


def format_schema() -> str:
    """Return the JSON schema of a scene, for editors."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps({**dialect, **read_declaration(Scene).schema}, indent=1) + "\n"


def _format_section(
    declared: Declaration, title: str, node: Node, path: str, written: dict[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield the path and the table of a section, then those of inner sections that have no table
    yet.

    `written` maps sections to the headings of their tables.
    """
    description = (node.get("description") or "").replace("\n", " ")
    table = "\n".join(_format_table(declared, node, written))
    yield path, f"## {title}\n\n{description}\n\n{table}\n"
    for name, inner in node["properties"].items():
        where = f"{path}{name}"
        for kind, section in _list_sections(declared, inner):
            if section["title"] not in written:
                label = f"`{where.replace('[]', '')}`" + (f": {kind}" if kind else "")
                written[section["title"]] = label
                many = "[]." if "items" in declared.resolve(inner) else "."
                yield from _format_section(declared, label, section, f"{where}{many}", written)


def _list_sections(declared: Declaration, node: Node) -> Iterator[tuple[str, Node]]:
    """Yield the sections that a field accepts, with the name of law or kind."""
    node = declared.resolve(node)
    if "items" in node:
        yield from _list_sections(declared, node["items"])
    elif kinds := declared.kinds(node):
        yield from kinds.items()
    else:
        yield from (("", choice) for choice in declared.choices(node) if "properties" in choice)


def _format_table(declared: Declaration, node: Node, written: dict[str, str]) -> Iterator[str]:
    yield "| field | accepts | default | meaning |\n|---|---|---|---|"
    fields = {name: declared.resolve(inner) for name, inner in node["properties"].items()}
    for name, inner in sorted(fields.items(), key=lambda field: "const" not in field[1]):
        if "const" in inner:
            yield f'| `{name}` | `"{inner["const"]}"` | required | selects this kind |'
            continue
        # A section has one table, wherever else a scene may contain it.
        tables = [
            written[section["title"]]
            for kind, section in _list_sections(declared, inner)
            if not kind and section["title"] in written
        ]
        accepts = declared.describe(inner) + "".join(f" like {label}" for label in tables)
        required = name in node.get("required", [])
        default = "required" if required else _format_default(inner, below=not tables)
        examples = ", ".join(f"`{json.dumps(example)}`" for example in inner.get("examples", []))
        default += f", such as {examples}" if examples else ""
        meaning = inner.get("description", "")
        yield f"| `{name}` | {accepts} | {default} | {meaning} |"


def _format_default(node: Node, *, below: bool) -> str:
    """Return the default of a field. If `below` is false, a section without a law or kind is
    written in full.
    """
    default = node.get("default")
    if default in (None, [], ""):
        return "none"
    sections = default if isinstance(default, list) else [default]
    if isinstance(sections[0], dict):
        kinds = [section.get("law", section.get("kind")) for section in sections]
        named = ", ".join(filter(None, kinds))
        return named or ("as below" if below else f"`{_format_inline(sections[0])}`")
    plain = isinstance(default, float) and format_number(default)
    return f"`{plain or json.dumps(default)}`"


def _format_inline(section: dict[str, Any]) -> str:
    fields = [f"{name} = {json.dumps(value)}" for name, value in section.items() if value]
    return "{" + ", ".join(fields) + "}"
