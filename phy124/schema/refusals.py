"""Turn validation errors of pydantic into messages that state the limit and a remedy."""

import difflib
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from phy124.errors import InputError, did_you_mean
from phy124.schema.declaration import Declaration, Node, format_number, read_declaration
from phy124.schema.section import Section

FEW = 3
Options = TypeVar("Options", bound=Section)
LONGEST = 60


def explain(error: ValidationError, source: str, root: type[BaseModel]) -> InputError:
    """Convert pydantic's error at the most deeply nested field to an error with a remedy.

    An `InputError` that a validator raised is returned unchanged.

    Args:
        error: The error that pydantic raised.
        source: Name of the data, for errors that concern no single field.
        root: The class of the validated section.
    """
    details: dict[str, Any] = {**max(error.errors(), key=lambda detail: len(detail["loc"]))}
    cause = details.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return cause
    if details["type"] == "missing" and isinstance(details["loc"][-1], int):
        # If a list is too short, the message names the list, not the missing item.
        details |= {"type": "too_short", "loc": details["loc"][:-1]}
    declared = read_declaration(root)
    place = _find_place(declared, details["loc"])
    if details["type"].startswith("union_tag"):
        tag = place.node["discriminator"]["propertyName"]
        section = details["input"]
        kind = section.get(tag) if isinstance(section, dict) else None
        details |= {"type": "no_such_kind", "input": kind}
        place = place._replace(keys=[*place.keys, tag])
    field = ".".join(map(str, place.keys)) or source
    nothing = details["type"] == "missing" or details["input"] is None
    value = "nothing" if nothing else shorten(details["input"])
    return InputError(field, value, *_limit_and_remedy(declared, place, details))


def explain_options(error: ValidationError) -> InputError:
    """Convert pydantic's error in a section of options; the error's title names the section's
    class.
    """
    kinds, sections = [Section], {}
    while kinds:
        kind = kinds.pop()
        kinds += kind.__subclasses__()
        sections[kind.__name__] = kind
    return explain(error, "options", sections[error.title])


def validate(
    kind: type[Options], data: Options | Mapping[str, Any], source: str = "options"
) -> Options:
    """Return options as an object of their class; the options may also be plain data.

    `source` names the data in errors that concern no single field.

    Raises:
        InputError: A value is invalid, or there is no such option.
    """
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise explain(error, source, kind) from None


def shorten(value: Any) -> str:
    """Return a value as text for a message, of at most `LONGEST` characters."""
    try:
        section = isinstance(value, dict) and value
        text = f"a section with {', '.join(map(str, section))}" if section else str(value)
    except ValueError:  # Python refuses to print integers of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


class _Place(NamedTuple):
    keys: list[int | str]
    """Path of the field as a user writes it, without the names of laws and kinds."""
    node: Node
    """Schema of the field or, if the field does not exist, of the section."""
    around: Node
    description: str


def _find_place(declared: Declaration, location: tuple[int | str, ...]) -> _Place:
    node = around = declared.schema
    keys: list[int | str] = []
    description = ""
    for part in location:
        kinds = declared.kinds(node)
        if part in kinds:
            node = kinds[str(part)]
            continue
        inner = _find_inner(declared, node, part)
        if inner is None:
            continue  # the part names an alternative of a union, not a field
        around = declared.resolve(node) if isinstance(part, str) else around
        node = inner
        keys.append(part)
        description = declared.resolve(node).get("description", description)
    return _Place(keys, declared.resolve(node), around, description)


def _find_inner(declared: Declaration, node: Node, part: int | str) -> Node | None:
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
    is_choice = len(choices) > 1 and (part in names or str(part).startswith("literal["))
    return None if is_choice else {}


def _limit_and_remedy(declared: Declaration, place: _Place, details: Any) -> tuple[str, str]:
    kind, value = details["type"], details["input"]
    about = f"It is: {place.description}" if place.description else ""
    if kind == "extra_forbidden":
        return _explain_unknown_key(declared, place)
    if kind == "missing":
        return f"it is required: {declared.describe(place.node)}.", about
    if kind == "no_such_kind":
        tag, known = place.keys[-1], list(declared.kinds(place.node))
        remedy = f"Give one of {', '.join(known)}."
        if value is None:
            return f"its {tag} is missing.", remedy
        hint = did_you_mean(str(value), known)
        return f"there is no such {tag}.", f"{hint} {remedy}".strip()
    if kind == "value_error":
        limit, _, remedy = details["msg"].removeprefix("Value error, ").partition("; ")
        end = "" if remedy.endswith(("?", ".")) or not remedy else "."
        return f"{limit.rstrip('.')}.", f"{remedy[:1].upper()}{remedy[1:]}{end}"
    suggestion = _suggest(declared, place.node, value)
    limit = f"it must be {declared.describe(place.node)}."
    return limit, " ".join(filter(None, [suggestion, about]))


def _suggest(declared: Declaration, node: Node, value: Any) -> str:
    known = [str(name) for choice in declared.choices(node) for name in choice.get("enum", [])]
    if known:
        return did_you_mean(str(value), known)
    legal, largest = node.get("default"), node.get("maximum")
    if legal == 0 and isinstance(value, int | float) and value > (largest or math.inf):
        legal = largest  # 0 often means that something is omitted, which the user does not want
    numbers = legal if isinstance(legal, list) else [legal]
    if legal in (None, []) or any(
        isinstance(x, bool) or not isinstance(x, int | float) for x in numbers
    ):
        return ""
    return f"Try {legal if isinstance(legal, list) else format_number(legal)}."


def _explain_unknown_key(declared: Declaration, place: _Place) -> tuple[str, str]:
    key = str(place.keys[-1])
    choices = declared.choices(place.around)
    known = sorted({name for choice in choices for name in choice.get("properties", ())})
    similar = _list_sections_with(declared, key) if len(place.keys) == 1 else []
    similar = similar or difflib.get_close_matches(key, known, 1)
    similar = similar or _list_keys_about(declared, choices, key)
    if similar:
        return "there is no such key.", f"Did you mean {' or '.join(similar)}?"
    if key in declared.schema["properties"]:
        return "there is no such key here.", f"{key} belongs at the top level of the scene."
    others = declared.schema.get("$defs", {}).values()
    if any(key in other.get("properties", {}) for other in others):
        tag = next((tag for tag in ("law", "kind") if tag in known), None)
        kind = place.around["properties"][tag]["const"] if tag else None
        limit = f"{kind} has no such key." if kind else "there is no such key here."
        return limit, "Remove it."
    return "there is no such key.", f"Known keys: {', '.join(known)}."


def _list_keys_about(declared: Declaration, choices: list[Node], key: str) -> list[str]:
    words, keys = _split_words(key), []
    for name, node in (
        (k, n) for choice in choices for k, n in choice.get("properties", {}).items()
    ):
        text = declared.resolve(node).get("description", node.get("description", ""))
        if words and words <= _split_words(text.partition(". ")[0]):
            keys.append(name)
    return keys if len(keys) <= FEW else []


def _split_words(text: str) -> set[str]:
    words = re.findall("[a-z]{3,}", text.lower().replace("'s", "").replace("_", " "))
    return {word.removesuffix("s") for word in words}


def _list_sections_with(declared: Declaration, key: str) -> list[str]:
    paths = []
    for name, node in declared.schema["properties"].items():
        inner = [*declared.choices(node), *map(declared.resolve, declared.kinds(node).values())]
        if any(key in choice.get("properties", {}) for choice in inner):
            paths.append(f"{name}.{key}")
    return paths
