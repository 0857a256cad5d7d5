"""Turns pydantic's validation errors into single sentences, using what the section declares."""

from __future__ import annotations

import difflib
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from phy124.errors import InputError, did_you_mean
from phy124.scene.declaration import Declaration, Node, declaration, number
from phy124.section import Section

LONGEST = 60
"""Longest piece of a value that a message repeats, in characters."""


def refusal(error: ValidationError, source: str, root: type[BaseModel]) -> InputError:
    """The most deeply nested validation error as one sentence with a remedy."""
    found: dict[str, Any] = {**max(error.errors(), key=lambda complaint: len(complaint["loc"]))}
    if found["type"] == "missing" and isinstance(found["loc"][-1], int):
        # A list that is too short: it is the list that is wrong.
        found |= {"type": "too_short", "loc": found["loc"][:-1]}
    declared = declaration(root)
    place = _place(declared, found["loc"])
    if found["type"].startswith("union_tag"):
        place, found = _at_tag(place, found)
    field = ".".join(map(str, place.keys)) or source
    nothing = found["type"] == "missing" or found["input"] is None
    value = "nothing" if nothing else shortened(found["input"])
    return InputError(field, value, *_said(declared, place, found))


def refusal_of_options(error: ValidationError) -> InputError:
    """The error of a section of options, which pydantic names by its class."""
    kinds, found = [Section], {}
    while kinds:
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        found[kind.__name__] = kind
    return refusal(error, "options", found[error.title])


def shortened(value: Any) -> str:
    """A value as a message shows it: numbers in full, long values shortened."""
    try:
        text = str(value)
    except ValueError:  # Python writes no integers of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


class _Place(NamedTuple):
    """Where in the scene an error lies."""

    keys: list[int | str]
    """Its path as a user would write it, without the names of kinds."""
    node: Node
    """The schema at that place, or around it if the key does not exist."""
    around: Node
    """The schema of the section that the key belongs to."""
    description: str
    """The description of the nearest field that has one."""


def _place(declared: Declaration, location: tuple[int | str, ...]) -> _Place:
    node = around = declared.schema
    keys: list[int | str] = []
    description = ""
    for part in location:
        kinds = declared.kinds(node)
        if part in kinds:
            node = kinds[str(part)]
            continue
        inner = _inner(declared, node, part)
        if inner is None:
            continue  # the name of a choice
        around = declared.resolved(node) if isinstance(part, str) else around
        node = inner
        keys.append(part)
        description = declared.resolved(node).get("description", description)
    return _Place(keys, declared.resolved(node), around, description)


def _inner(declared: Declaration, node: Node, part: int | str) -> Node | None:
    """The schema under a key; {} if the key does not exist, None if the part is no key."""
    choices = declared.choices(node)
    if isinstance(part, int):
        for choice in choices:
            if "prefixItems" in choice:
                return choice["prefixItems"][min(part, len(choice["prefixItems"]) - 1)]
            if "items" in choice:
                return choice["items"]
    for choice in choices:
        if part in choice.get("properties", {}):
            return choice["properties"][part]
    names = {str(choice.get("title")) for choice in choices}
    named = len(choices) > 1 and (part in names or str(part).startswith("literal["))
    return None if named else {}


def _said(declared: Declaration, place: _Place, found: Any) -> tuple[str, str]:
    """The limit and the remedy of the message."""
    kind, message = found["type"], found["msg"].removeprefix("Value error, ")
    if kind == "extra_forbidden":
        return _unknown(declared, place)
    if kind == "missing":
        return f"it must be given: {declared.wanted(place.node)}.", _about(place)
    if kind == "no_such_kind":
        return _no_such_kind(declared, place, found)
    if kind == "value_error":
        limit, _, remedy = message.partition("; ")
        return f"{limit.rstrip('.')}.", _sentence(remedy)
    limit = f"it must be {declared.wanted(place.node)}."
    return limit, " ".join(
        filter(None, [_try(declared, place.node, found["input"]), _about(place)])
    )


def _sentence(text: str) -> str:
    end = "" if text.endswith(("?", ".")) else "."
    return f"{text[:1].upper()}{text[1:]}{end}" if text else ""


def _about(place: _Place) -> str:
    return f"It is: {place.description}" if place.description else ""


def _try(declared: Declaration, node: Node, value: Any) -> str:
    """A legal value to suggest."""
    known = [str(name) for one in declared.choices(node) for name in one.get("enum", [])]
    if known:
        return did_you_mean(str(value), known)
    legal = node.get("default")
    numbers = legal if isinstance(legal, list) else [legal]
    if legal in (None, []) or any(
        isinstance(x, bool) or not isinstance(x, int | float) for x in numbers
    ):
        return ""
    return f"Try {legal if isinstance(legal, list) else number(legal)}."


def _unknown(declared: Declaration, place: _Place) -> tuple[str, str]:
    """Limit and remedy for a key that does not exist."""
    key = str(place.keys[-1])
    known = sorted({k for one in declared.choices(place.around) for k in one.get("properties", ())})
    meant = _in_sections(declared, key) if len(place.keys) == 1 else []
    meant = meant or difflib.get_close_matches(key, known, 1)
    if meant:
        return "there is no such key.", f"Did you mean {' or '.join(meant)}?"
    if key in declared.schema["properties"]:
        return "there is no such key here.", f"{key} stands at the top of the scene."
    others = declared.schema.get("$defs", {}).values()
    if any(key in other.get("properties", {}) for other in others):
        own = [
            str(place.around["properties"][tag]["const"]) for tag in ("law", "kind") if tag in known
        ]
        where = f"{own[0]} has no such key" if own else "there is no such key here"
        return f"{where}.", "Leave it out."
    return "there is no such key.", f"Known keys: {', '.join(known)}."


def _in_sections(declared: Declaration, key: str) -> list[str]:
    """Paths of the sections that do have this key, such as "view.size"."""
    found = []
    for name, node in declared.schema["properties"].items():
        inner = [*declared.choices(node), *map(declared.resolved, declared.kinds(node).values())]
        if any(key in choice.get("properties", {}) for choice in inner):
            found.append(f"{name}.{key}")
    return found


def _at_tag(place: _Place, found: dict[str, Any]) -> tuple[_Place, dict[str, Any]]:
    """The error moved from a section to the key that names its law or kind."""
    tag = place.node["discriminator"]["propertyName"]
    given = found["input"]
    given = given.get(tag) if isinstance(given, dict) else None
    found = {**found, "type": "no_such_kind", "input": given}
    return place._replace(keys=[*place.keys, tag]), found


def _no_such_kind(declared: Declaration, place: _Place, found: Any) -> tuple[str, str]:
    """Limit and remedy for a section whose law or kind is missing or unknown."""
    tag, known = place.keys[-1], list(declared.kinds(place.node))
    listed = f"Give one of {', '.join(known)}."
    if found["input"] is None:
        return f"it must say its {tag}.", listed
    hint = did_you_mean(str(found["input"]), known)
    return f"there is no such {tag}.", f"{hint} {listed}".strip()
