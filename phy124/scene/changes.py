"""Changes to a scene's plain data at dotted paths, such as `material.E=2e4`."""

from __future__ import annotations

import sys
from typing import Any

from phy124.errors import InputError
from phy124.scene.accuracies import PRESETS
from phy124.scene.depth import DEEPEST, check_depth
from phy124.scene.refusals import shortened
from phy124.scene.renamed import renewed_item

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TAGS = ("law", "kind")
"""Keys that say which of several kinds a section is."""
LENGTH = ("time.frames", "time.seconds")
"""Two ways to say how long a scene is; either replaces the other."""
REFERENCE = "`phy124 scenes --reference` lists all there is."


def apply(data: dict[str, Any], changes: dict[str, Any]) -> None:
    """Set values at dotted paths, outer paths first.

    When a section changes its kind, for instance to a material of another law, it starts from the
    defaults of the new kind, because the old values would mean something else. Values set beside
    the new kind are kept.

    Raises:
        InputError: If a path does not exist in the data.
    """
    for path, value in changes.items():
        _check_path(path)
        check_depth(value, path)
    changes = dict(renewed_item(path, value) for path, value in changes.items())
    frames, seconds = LENGTH
    if seconds in changes:
        if frames in changes:
            limit = f"{frames} = {changes[frames]} says how long it is as well."
            raise InputError(seconds, changes[seconds], limit, "Give one of the two.")
        data.get("time", {}).pop("frames", None)
    for path in sorted(changes, key=_outer_first):
        _put(data, path, changes[path])


def _check_path(path: str) -> None:
    """Refuse a path that no scene has, before tables are made for it."""
    keys = path.count(".") + 1
    if keys > DEEPEST:
        limit = f"it has {keys:,} names, and nothing in a scene has more than {DEEPEST}."
        raise InputError(shortened(path), "a path", limit, REFERENCE)


def parse_value(text: str) -> Any:
    """Parse a value the way TOML writes it; bare words are taken as text."""
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return found["value"] if len(found) == 1 else text


def assignments(texts: tuple[str, ...]) -> dict[str, Any]:
    """Texts such as `material.E=2e4` as a dict of paths and values.

    Raises:
        InputError: If a text is no assignment.
    """
    pairs: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError("set", text, "it is not KEY=VALUE.", "Write material.E=2e4, say.")
        pairs = together(pairs, {key.strip(): parse_value(value.strip())})
    return pairs


def together(some: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """Two sets of changes as one.

    Raises:
        InputError: If they disagree about a value.
    """
    for path in some.keys() & others.keys():
        if some[path] != others[path]:
            limit = f"it is also asked to be {some[path]}."
            raise InputError(path, others[path], limit, "Give one of the two.")
    return {**some, **others}


def _outer_first(path: str) -> tuple[int, bool]:
    keys = path.split(".")
    return len(keys), keys[-1] not in TAGS


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    """Set one value in nested dicts and lists; an item's number one past the end appends."""
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
    """The dict or list under a key, created if it does not exist yet.

    A named accuracy is replaced by its table of values, so that one of them can be changed.
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
