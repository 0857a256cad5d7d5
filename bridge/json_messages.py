"""JSON messages: ROS 2 messages as viewers send and read them, with their schemas (JSON Schema)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from phy124.errors import InputError

from .messages import DEFINITIONS, Field, fields

INTEGERS = ("byte", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
WORDS = {bool: "boolean", str: "string", int: "integer", float: "number"}
"""Python type -> that of JSON Schema."""
REMEDY = "Send JSON with the members of the message; those left out are zero or empty."


def from_json(name: str, data: bytes) -> Any:
    """A message whose members are attributes; those that are left out are zero, empty or false.

    NaN and Infinity, which JSON does not have, are read as Python writes them.

    Raises:
        InputError: It is no JSON, or a member is unknown or of the wrong kind.
    """
    try:
        content = json.loads(data or b"{}")
    except (ValueError, RecursionError) as error:
        raise InputError(name, data[:40], f"it is no JSON ({error}).", REMEDY) from None
    return _message(name, content, name)


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema of a message."""
    members = {member.name: _schema(member) for member in fields(name)}
    return {"type": "object", "properties": members}


def _message(name: str, content: Any, where: str) -> Any:
    if not isinstance(content, Mapping):
        raise InputError(where, content, "it must be an object.", REMEDY)
    known = fields(name)
    if unknown := sorted(content.keys() - {member.name for member in known}):
        limit = f"{name} has no {', '.join(map(str, unknown))}."
        raise InputError(where, unknown[0], limit, REMEDY)
    return SimpleNamespace(
        **{member.name: _member(member, content, f"{where}.{member.name}") for member in known}
    )


def _member(member: Field, content: Mapping[str, Any], where: str) -> Any:
    given = content.get(member.name)
    if member.length is None:
        return _value(member.base, given, where)
    listed = [] if given is None else given
    if not isinstance(listed, list):
        raise InputError(where, given, "it must be a list.", REMEDY)
    return [_value(member.base, value, where) for value in listed]


def _value(base: str, given: Any, where: str) -> Any:
    if base in DEFINITIONS:
        return _message(base, {} if given is None else given, where)
    kinds, zero = _kind(base)
    if given is None:
        return zero
    if isinstance(given, bool) is not (base == "bool") or not isinstance(given, kinds):
        raise InputError(where, given, f"it must be a {base}.", REMEDY)
    return given


def _kind(base: str) -> tuple[tuple[type, ...], Any]:
    """The Python types of a primitive, and its zero."""
    if base == "bool":
        return (bool,), False
    if base == "string":
        return (str,), ""
    return ((int,), 0) if base in INTEGERS else ((int, float), 0.0)


def _schema(member: Field) -> dict[str, Any]:
    if member.base in DEFINITIONS:
        inner = schema(member.base)
    else:
        kinds, _ = _kind(member.base)
        inner = {"type": WORDS[kinds[-1]]}
    return inner if member.length is None else {"type": "array", "items": inner}
