"""Changes to a scene's plain data at dotted paths, such as `material.E=2e4`."""

import itertools
import re
import sys
from typing import Any

from phy124.errors import InputError
from phy124.scene.accuracies import PRESETS
from phy124.scene.files import DEEPEST, check_depth
from phy124.scene.renamed import rename_item
from phy124.schema.refusals import shorten

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TAGS = ("law", "kind")
"""Keys that state the kind of a section."""
LENGTH = ("time.frames", "time.seconds")
"""Fields that set a scene's length; a change of `time.seconds` removes `time.frames`."""
BARE = re.compile(r"([\[,=]\s*)(?!(?:true|false|inf|nan)\b)([A-Za-z][\w./-]*)(?=\s*[],}])")
"""Matches a value without quotes in a list or an inline table."""
REFERENCE = "`phy124 scenes --reference` lists all fields."


def apply(data: dict[str, Any], changes: dict[str, Any]) -> None:
    """Set values at dotted paths, outer paths first.

    If the kind of a section changes, such as the law of a material, the old values of the section
    are replaced by defaults.

    Raises:
        InputError: A path does not exist in the data.
    """
    for path, value in changes.items():
        _check_path(path)
        check_depth(value, path)
    changes = dict(rename_item(path, value) for path, value in changes.items())
    frames, seconds = LENGTH
    if seconds in changes:
        if frames in changes:
            limit = f"{frames} = {changes[frames]} sets the length, too."
            raise InputError(seconds, changes[seconds], limit, "Give one of the two.")
        data.get("time", {}).pop("frames", None)
    for path in sorted(changes, key=_outer_first):
        _put(data, path, changes[path])


def _check_path(path: str) -> None:
    if "" in path.split("."):
        limit = "the name before or after a dot is empty."
        raise InputError(shorten(path) or "''", "a path", limit, REFERENCE)
    keys = path.count(".") + 1
    if keys > DEEPEST:
        limit = f"it has {keys:,} names; a path in a scene has at most {DEEPEST}."
        raise InputError(shorten(path), "a path", limit, REFERENCE)


def parse_value(text: str) -> Any:
    """Parse a value in TOML notation; return text that is not valid TOML unchanged.

    In lists and tables, words need no quotes, because shells remove quotes: `views=["front"]`
    arrives as `views=[front]`.
    """
    quoted = BARE.sub(r'\1"\2"', text)
    for notation in (text, quoted) if text.startswith(("[", "{")) else (text,):
        try:
            table = tomllib.loads(f"value = {notation}")
        except (ValueError, RecursionError):
            continue
        return table["value"] if len(table) == 1 else text
    return text


def parse_changes(texts: tuple[str, ...]) -> dict[str, Any]:
    """Parse texts such as `material.E=2e4` into values by path.

    Raises:
        InputError: A text is not of the form KEY=VALUE, or two texts set the same path to different
            values.
    """
    pairs: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise InputError(
                "set", text, "it is not KEY=VALUE.", "Write, for example, material.E=2e4."
            )
        pairs = merge_changes(pairs, {key.strip(): parse_value(value.strip())})
    return pairs


def merge_changes(some: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """Merge two sets of changes.

    Raises:
        InputError: The two sets contain different values for the same path.
    """
    for path in some.keys() & others.keys():
        if some[path] != others[path]:
            limit = f"it is also set to {some[path]}."
            raise InputError(path, others[path], limit, "Give one of the two.")
    return {**some, **others}


def _outer_first(path: str) -> tuple[int, bool]:
    keys = path.split(".")
    return len(keys), keys[-1] not in TAGS


def _put(data: dict[str, Any], path: str, value: Any) -> None:
    """Set a value in nested dicts and lists; an index equal to a list's length appends the
    value.
    """
    keys = path.split(".")
    section: Any = data
    for key, inner in itertools.pairwise(keys):
        section = _item(section, key, path, value, new=[] if inner.isdecimal() else {})
    last = keys[-1]
    if isinstance(section, dict):
        if last in TAGS and section.get(last) != value:
            section.clear()
        section[last] = value
    else:
        _item(section, last, path, value)
        section[int(last)] = value


def _item(section: Any, key: str, path: str, value: Any, new: Any = None) -> Any:
    """Return the dict or list under a key; if the key is missing, add `new` and return it.

    A named accuracy is replaced by its values, so that one value can be changed.
    """
    if isinstance(section, dict):
        inner = section.setdefault(key, new)
        if key == "accuracy" and isinstance(inner, str) and inner in PRESETS:
            section[key] = PRESETS[inner].model_dump()
        return section[key]
    if not isinstance(section, list):
        raise InputError(path, value, f"the value before {key!r} has no fields.", REFERENCE)
    number = int(key) if key.isdecimal() else -1
    if number == len(section):
        section.append(new)
    if not 0 <= number < len(section):
        items = "1 item" if len(section) == 1 else f"{len(section)} items"
        limit = f"there is no item {key!r}; the list has {items}."
        raise InputError(
            path, value, limit, f"Items are counted from 0; use {len(section)} to add an item."
        )
    return section[number]
