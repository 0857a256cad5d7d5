"""The reference page of a scene: every field with what it accepts, its default and its meaning."""

from __future__ import annotations

import json
from collections.abc import Iterator

from phy124.scene.declaration import Declaration, Node, declaration, number
from phy124.scene.scene import Scene

HEAD = """# Scene reference

Every field of a scene file, made from the declaration by `phy124 scenes --reference`. A scene
file is TOML; what is left out has its default. On the command line the same fields are set by
their path, `--set object.lift=0.5 forces.0.kind=wind`; items of lists count from 0, and one past
the last is added. `phy124 scenes NAME` prints a preset in full, to start from.
`phy124 scenes --schema > scene.schema.json` writes the JSON schema with which an editor completes
and checks scene files; the line `#:schema scene.schema.json` at a file's top tells most of them.

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
"""A complete scene file with a part, stiffness, forces, a profile, boundaries and a motion."""


def reference() -> str:
    """The reference page in Markdown."""
    declared, written = declaration(Scene), set[str]()
    parts = [HEAD.format(example=EXAMPLE)]
    parts += _page(declared, "Scene", declared.schema, "", written)
    return "\n".join(parts)


def schema() -> str:
    """The JSON schema of a scene, for editors."""
    told = {"$schema": "https://json-schema.org/draft/2020-12/schema", **declaration(Scene).schema}
    return json.dumps(told, indent=1) + "\n"


def _page(
    declared: Declaration, title: str, node: Node, path: str, written: set[str]
) -> Iterator[str]:
    """The table of a section, then those of the sections in it that are not written yet."""
    yield f"## {title}\n\n{_sentence(node)}\n"
    yield "\n".join(_table(declared, node)) + "\n"
    for name, inner in node["properties"].items():
        where = f"{path}{name}"
        for kind, section in _sections(declared, inner):
            if section["title"] not in written:
                written.add(section["title"])
                label = f"`{where.replace('[]', '')}`" + (f": {kind}" if kind else "")
                many = "[]." if "items" in declared.resolved(inner) else "."
                yield from _page(declared, label, section, f"{where}{many}", written)


def _sections(declared: Declaration, node: Node) -> Iterator[tuple[str, Node]]:
    """The sections a field may hold, each with the name of its law or kind."""
    node = declared.resolved(node)
    if "items" in node:
        yield from _sections(declared, node["items"])
    elif kinds := declared.kinds(node):
        yield from kinds.items()
    else:
        yield from (("", one) for one in declared.choices(node) if "properties" in one)


def _table(declared: Declaration, node: Node) -> Iterator[str]:
    yield "| field | must be | default | what it is |\n|---|---|---|---|"
    fields = {name: declared.resolved(inner) for name, inner in node["properties"].items()}
    for name, inner in sorted(fields.items(), key=lambda field: "const" not in field[1]):
        if "const" in inner:
            yield f'| `{name}` | `"{inner["const"]}"` | must be given | says which one it is |'
            continue
        given = "must be given" if name in node.get("required", []) else _default(inner)
        examples = ", ".join(f"`{json.dumps(example)}`" for example in inner.get("examples", []))
        given += f", such as {examples}" if examples else ""
        yield f"| `{name}` | {declared.wanted(inner)} | {given} | {inner.get('description', '')} |"


def _default(node: Node) -> str:
    given = node.get("default")
    if given in (None, [], ""):
        return "none"
    sections = given if isinstance(given, list) else [given]
    if isinstance(sections[0], dict):
        kinds = [one.get("law", one.get("kind")) for one in sections]
        return ", ".join(filter(None, kinds)) or "as below"
    plain = isinstance(given, float) and number(given)
    return f"`{plain or json.dumps(given)}`"


def _sentence(node: Node) -> str:
    return (node.get("description") or "").replace("\n", " ")
