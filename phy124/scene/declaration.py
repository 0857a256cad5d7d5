"""The fields a section declares, read from its JSON schema and described in words."""

from __future__ import annotations

from functools import cache
from typing import Any

from pydantic import BaseModel

Node = dict[str, Any]
"""A piece of JSON schema."""
COUNTS = {2: "two", 3: "three", 4: "four"}


class Declaration:
    """The JSON schema of a section and of all sections inside it."""

    def __init__(self, root: type[BaseModel]) -> None:
        self.schema: Node = root.model_json_schema()

    def resolved(self, node: Node) -> Node:
        """The schema that a reference points to; for an optional field, the schema of its value."""
        while True:
            if "$ref" in node:
                inner = self.schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
            elif (
                len(given := [one for one in node.get("anyOf", []) if one != {"type": "null"}]) == 1
            ):
                inner = given[0]
            else:
                return node
            node = {**inner, **{k: v for k, v in node.items() if k not in ("$ref", "anyOf")}}

    def kinds(self, node: Node) -> dict[str, Node]:
        """The sections a field may hold, by their law or kind."""
        mapping = self.resolved(node).get("discriminator", {}).get("mapping", {})
        return {name: self.resolved({"$ref": ref}) for name, ref in mapping.items()}

    def choices(self, node: Node) -> list[Node]:
        """The alternatives a field accepts."""
        node = self.resolved(node)
        return [self.resolved(one) for one in node.get("anyOf", [])] or [node]

    def wanted(self, node: Node) -> str:
        """What a field accepts, in words: "a number from 1 to 1e13", for example."""
        return " or ".join(self._one(choice) for choice in self.choices(node))

    def _one(self, node: Node) -> str:
        tag = node.get("discriminator", {}).get("propertyName")
        if tag:
            return f"a table whose {tag} is one of {', '.join(self.kinds(node))}"
        if "enum" in node:
            return f"one of {', '.join(map(str, node['enum']))}"
        if node.get("type") == "array":
            return self._array(node)
        maximum = node.get("maxLength")
        text = f"text of at most {maximum} characters" if maximum else "text"
        plain = {"boolean": "true or false", "string": text, "object": "a table"}
        if node.get("type") in plain:
            return plain[node["type"]]
        noun = "a whole number" if node.get("type") == "integer" else "a number"
        return f"{noun} {span(node)}".rstrip()

    def _array(self, node: Node) -> str:
        items = [self.wanted(item) for item in node.get("prefixItems", [])]
        if items:
            return f"{COUNTS[len(items)]} values in [...], each {items[0]}"
        return f"a list in [...], each item {self.wanted(node['items'])}"


@cache
def declaration(root: type[BaseModel]) -> Declaration:
    """The declaration of a section class; it takes a fifth of a second and is cached."""
    return Declaration(root)


def span(node: Node) -> str:
    """The bounds of a number in words; empty if it has none."""
    minimum, above = node.get("minimum"), node.get("exclusiveMinimum")
    maximum, below = node.get("maximum"), node.get("exclusiveMaximum")
    low, high = (_either(inside, beyond) for inside, beyond in ((minimum, above), (maximum, below)))
    if minimum is not None and maximum is not None:
        return f"from {low} to {high}"
    said = [f"above {low}" if above is not None else low and f"of at least {low}"]
    said.append(f"below {high}" if below is not None else high and f"at most {high}")
    return ", ".join(filter(None, said))


def _either(inside: float | None, beyond: float | None) -> str:
    """Whichever of two bounds exists, in words; empty if neither does."""
    bound = beyond if inside is None else inside
    return "" if bound is None else number(bound)


def number(value: float) -> str:
    """A number as a person would type it."""
    if isinstance(value, int) and abs(value) < 1e12:
        return str(value)
    return f"{value:g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
