"""Collects all values that a scene declares from the schema, so that new fields are included."""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from phy124.scene import Scene
from phy124.schema.declaration import Node, read_declaration

Wrap = Callable[[Any], Any]
ODD = [None, True, "text", "", [], {}, [1], math.nan, math.inf, -math.inf, 10**400, object()]
"""Values that are tried for fields of every type."""
HUGE = [0.0, 1e-300, 1e9, 1e308, -1e308]
PICKED = {"region": {}}
"""The fields without which a part is invalid."""


class Leaf(NamedTuple):
    """One value of a scene."""

    path: str
    wrap: Wrap
    """Return a scene's data with another value at this path."""
    node: Node
    """The JSON schema of the value."""


def leaves(files: dict[str, str]) -> list[Leaf]:
    """Return all values; `files` maps kinds to files for fields that must name a file."""
    return list(_walk(read_declaration(Scene).schema, "", lambda value: value, files))


def _walk(node: Node, path: str, wrap: Wrap, files: dict[str, str]) -> Iterator[Leaf]:
    node = read_declaration(Scene).resolve(node)
    kinds = read_declaration(Scene).kinds(node)
    if kinds:
        tag = node["discriminator"]["propertyName"]
        yield Leaf(f"{path}.{tag}", lambda value: wrap({tag: value}), {"type": "string"})
    for kind, section in kinds.items():
        yield from _section(section, f"{path}[{kind}]", wrap, files)
    if not kinds:
        yield from _inside(node, path, wrap, files)


def _inside(node: Node, path: str, wrap: Wrap, files: dict[str, str]) -> Iterator[Leaf]:
    for choice in read_declaration(Scene).choices(node):
        if "properties" in choice:
            yield from _section(choice, path, wrap, files)
        elif "prefixItems" in choice:
            yield Leaf(path, wrap, choice)
            usual = choice.get("default") or [0] * len(choice["prefixItems"])
            for i, item in enumerate(choice["prefixItems"]):
                yield Leaf(f"{path}.{i}", partial(_with_item, wrap, usual, i), item)
        elif "items" in choice:
            yield Leaf(path, wrap, choice)
            yield from _walk(choice["items"], f"{path}.0", lambda v: wrap([v]), files)
        else:
            yield Leaf(path, wrap, choice)


def _section(node: Node, path: str, wrap: Wrap, files: dict[str, str]) -> Iterator[Leaf]:
    base = {key: item["const"] for key, item in node["properties"].items() if "const" in item}
    kind = next(iter(base.values()), "")
    for key in node.get("required", []):
        base[key] = files.get(kind, "missing")
    if path.startswith(".parts"):
        base |= PICKED if "mask" in node["properties"] else {}
    for key, inner in node["properties"].items():
        if key not in ("law", "kind"):
            put = partial(_with_key, wrap, base, key)
            yield from _walk(inner, f"{path}.{key}", put, files)


def _with_item(wrap: Wrap, usual: list[Any], index: int, value: Any) -> Any:
    return wrap([*usual[:index], value, *usual[index + 1 :]])


def _with_key(wrap: Wrap, base: dict[str, Any], key: str, value: Any) -> Any:
    return wrap({**base, key: value})


def legal(node: Node) -> list[Any]:
    """Return values at the bounds and between the bounds of a leaf."""
    result = [node["default"]] if node.get("default") is not None else []
    result += node.get("enum", [])
    result += [True, False] if node.get("type") == "boolean" else []
    result += [node[key] for key in ("minimum", "maximum") if key in node]
    result += [node[key] * (1 - 1e-9) for key in ("exclusiveMaximum",) if key in node]
    result += [1e-300] if node.get("exclusiveMinimum") == 0 else []
    return result


def beyond(node: Node) -> list[Any]:
    """Return values that are mostly invalid for a leaf."""
    result = [*ODD, *HUGE]
    for key in ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum"):
        if key in node:
            step = max(abs(node[key]) * 1e-6, 1e-12)
            result.append(node[key] - step if "in" in key[-7:-3] else node[key] + step)
    if node.get("type") == "string":
        result += ["nonsense", "a\0b", "\ud800", "x" * 10_000]
    return result
