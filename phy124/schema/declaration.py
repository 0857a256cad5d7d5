"""Describes in words the values that the fields of a section accept."""

from functools import cache
from typing import Any

from pydantic import BaseModel

Node = dict[str, Any]
COUNTS = {2: "two", 3: "three", 4: "four"}


class Declaration:
    """The JSON schema of a section and of all sections inside it."""

    def __init__(self, root: type[BaseModel]) -> None:
        self.schema: Node = root.model_json_schema()

    def resolve(self, node: Node) -> Node:
        """Return the schema to which a node refers. For an optional field, return the schema of the
        value.
        """
        while True:
            options = [option for option in node.get("anyOf", []) if option != {"type": "null"}]
            if "$ref" in node:
                inner = self.schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
            elif len(options) == 1:
                inner = options[0]
            else:
                return node
            node = {**inner, **{k: v for k, v in node.items() if k not in ("$ref", "anyOf")}}

    def kinds(self, node: Node) -> dict[str, Node]:
        """Return the sections that a field accepts, by their law or kind."""
        mapping = self.resolve(node).get("discriminator", {}).get("mapping", {})
        return {name: self.resolve({"$ref": ref}) for name, ref in mapping.items()}

    def choices(self, node: Node) -> list[Node]:
        """Return the alternatives that a field accepts."""
        node = self.resolve(node)
        return [self.resolve(option) for option in node.get("anyOf", [])] or [node]

    def describe(self, node: Node) -> str:
        """Describe the values that a field accepts, such as "a number from 1 to 1e13"."""
        return " or ".join(self._describe_choice(choice) for choice in self.choices(node))

    def _describe_choice(self, node: Node) -> str:
        tag = node.get("discriminator", {}).get("propertyName")
        if tag:
            return f"a table whose {tag} is one of {', '.join(self.kinds(node))}"
        if "enum" in node:
            return f"one of {', '.join(map(str, node['enum']))}"
        if node.get("type") == "array":
            if items := [self.describe(item) for item in node.get("prefixItems", [])]:
                return f"{COUNTS[len(items)]} values in [...], each {items[0]}"
            return f"a list in [...], each item {self.describe(node['items'])}"
        maximum = node.get("maxLength")
        text = f"text of at most {maximum} characters" if maximum else "text"
        plain = {"boolean": "true or false", "string": text, "object": "a table"}
        if node.get("type") in plain:
            return plain[node["type"]]
        noun = "a whole number" if node.get("type") == "integer" else "a number"
        return f"{noun} {describe_bounds(node)}".rstrip()


@cache
def read_declaration(root: type[BaseModel]) -> Declaration:
    """Return the declaration of a section class; it is cached, because it takes 0.2 s to make."""
    return Declaration(root)


def describe_bounds(node: Node) -> str:
    """Return the bounds of a number in words; empty if there are no bounds."""
    if "minimum" in node and "maximum" in node:
        return f"from {format_number(node['minimum'])} to {format_number(node['maximum'])}"
    words = {
        "minimum": "of at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    return ", ".join(f"{word} {format_number(node[k])}" for k, word in words.items() if k in node)


def format_number(value: float) -> str:
    """Format a number in the way a person would type it."""
    if isinstance(value, int) and abs(value) < 1e12:
        return str(value)
    return f"{value:g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
