"""Changes to a scene's plain data at dotted paths, such as material.E=2e4."""

from __future__ import annotations

import sys
from typing import Any

from phy124.errors import InputError
from phy124.scene.accuracies import PRESETS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TAGS = ("law", "kind")
"""Keys that say which of several sections one is."""
REFERENCE = "`phy124 scenes --reference` lists all there is."


def apply(data: dict[str, Any], changes: dict[str, Any]) -> None:
    """Set values at dotted paths, outer ones first; raises InputError.

    A section that becomes another kind, a material of another law say, begins from that kind's own
    defaults: the former's values mean nothing to it. What is set beside it stays.
    """
    for path in sorted(changes, key=_outer_first):
        _put(data, path, changes[path])


def parse_value(text: str) -> Any:
    """A value as TOML writes it; bare words are text."""
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return found["value"] if len(found) == 1 else text


def assignments(texts: tuple[str, ...]) -> dict[str, Any]:
    """KEY=VALUE texts as a dict; raises InputError."""
    pairs: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError("set", text, "it is not KEY=VALUE.", "Write material.E=2e4, say.")
        pairs = together(pairs, {key.strip(): parse_value(value.strip())})
    return pairs


def together(some: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """Two sets of changes as one; raises InputError if they do not agree about a value."""
    for path in some.keys() & others.keys():
        if some[path] != others[path]:
            limit = f"it is also asked to be {some[path]}."
            raise InputError(path, others[path], limit, "Give one of the two.")
    return {**some, **others}


def _outer_first(path: str) -> tuple[int, bool]:
    keys = path.split(".")
    return len(keys), keys[-1] not in TAGS


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    """Set one value in nested dicts and lists; items go by number, one past the last is added."""
    *parents, last = path.split(".")
    section: Any = data
    for key in parents:
        section = _item(section, key, path, value)
    if isinstance(section, dict):
        if last in TAGS and section.get(last) != value:
            section.clear()
        section[last] = value
    else:
        _item(section, last, path, value)
        section[int(last)] = value


def _item(section: Any, key: str, path: str, value: Any) -> Any:
    """What lies in a dict or list under a key, made where there is nothing yet.

    A named accuracy becomes its table, so that a part of it can be set.
    """
    if isinstance(section, dict):
        inner = section.setdefault(key, {})
        if key == "accuracy" and isinstance(inner, str) and inner in PRESETS:
            section[key] = PRESETS[inner].model_dump()
        return section[key]
    if not isinstance(section, list):
        raise InputError(path, value, f"there is no {key!r} to set there.", REFERENCE)
    number = int(key) if key.isdecimal() else -1
    if number == len(section):
        section.append({})
    if not 0 <= number < len(section):
        limit = f"there is no item {key!r}; the list has {len(section)}."
        raise InputError(path, value, limit, f"Count from 0; {len(section)} adds one.")
    return section[number]
