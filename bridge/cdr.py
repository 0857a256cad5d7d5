"""CDR: the bytes of ROS 2 messages, little-endian XCDR version 1 (OMG DDS-XTypes 1.3, 7.4.1).

All sinks use this encoder. A message is a mapping from member names to values; missing members are
zero, empty or false, as in ROS. A message whose members all have the same primitive type (points,
quaternions, colours) may also be a sequence of values.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from .messages import DEFINITIONS, Field, fields
from .topics import Message, Topic

ENCAPSULATION = b"\x00\x01\x00\x00"
PRIMITIVES = {
    "bool": "?",
    "byte": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
NANO = 1_000_000_000


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """Return the CDR payload of a message of type `package/msg/Name`, including the CDR header.

    A large `uint8[]` member (bytes, a memoryview or a contiguous array) is copied only once.

    Raises:
        KeyError: The type has no member of this name.
        struct.error: A number is out of range.
        ValueError: An array has the wrong length.
    """
    body = _Body()
    _encoder(name)(body, message)
    return b"".join([ENCAPSULATION, *body.parts])


def message(topic: Topic, stamp: int, content: Mapping[str, Any]) -> Message:
    """Return an encoded message; `stamp` is in ns since 1970."""
    return Message(topic, stamp, encode(topic.type, content))


def stamp(epoch: float, seconds: float) -> int:
    """Return the time stamp [ns since 1970] of the time `seconds` [s] after `epoch` [s since 1970].

    The two numbers are rounded separately, because their sum would be accurate to 0.2 us only.
    """
    return round(epoch * NANO) + round(seconds * NANO)


def time(nanoseconds: int) -> dict[str, int]:
    """Convert nanoseconds to a `builtin_interfaces/msg/Time` or `Duration`."""
    seconds, rest = divmod(nanoseconds, NANO)
    return {"sec": seconds, "nanosec": rest}


class _Body:
    """The payload is a list of parts, so that large data is copied only once, at the end."""

    def __init__(self) -> None:
        self.parts: list[Any] = []
        self.size = 0

    def align(self, size: int) -> None:
        gap = -self.size % size
        if gap:
            self.append(b"\x00" * gap)

    def append(self, data: Any) -> None:
        self.parts.append(data)
        self.size += data.nbytes if isinstance(data, (np.ndarray, memoryview)) else len(data)

    def pack(self, layout: struct.Struct, align: int, *values: Any) -> None:
        self.align(align)
        self.append(layout.pack(*values))


Encoder = Callable[[_Body, Any], None]
_LENGTH = struct.Struct("<I")


@cache
def _encoder(base: str) -> Encoder:
    if base == "string":
        return _string
    if base in PRIMITIVES:
        layout = struct.Struct("<" + PRIMITIVES[base])
        return lambda body, value: body.pack(layout, layout.size, value)
    return _message(base)


def _string(body: _Body, value: str) -> None:
    data = value.encode()
    body.pack(_LENGTH, 4, len(data) + 1)
    body.append(data + b"\x00")


def _message(name: str) -> Encoder:
    members = [(member.name, _member(member), _zero(member)) for member in fields(name)]
    known = {member for member, _, _ in members}
    flat = _flat(name)
    layout = struct.Struct("<" + "".join(PRIMITIVES[base] for base in flat))

    def encode_message(body: _Body, value: Any) -> None:
        if not isinstance(value, Mapping):
            if len(set(flat)) != 1:
                raise ValueError(f"a {name} must be a mapping of member names to values")
            body.pack(layout, layout.size // len(flat), *value)
            return
        if not value.keys() <= known:
            raise KeyError(f"{name} has no {sorted(value.keys() - known)}")
        for member, encoder, zero in members:
            encoder(body, value.get(member, zero))

    return encode_message


def _member(member: Field) -> Encoder:
    if member.length is None:
        return _encoder(member.base)
    if member.base in PRIMITIVES:
        return _numbers(member)
    return _sequence(member)


def _numbers(member: Field) -> Encoder:
    dtype = np.dtype("<" + PRIMITIVES[member.base])

    def encode_numbers(body: _Body, value: Any) -> None:
        raw = isinstance(value, (bytes, memoryview))
        data = value if raw else np.ascontiguousarray(value, dtype)
        size = data.nbytes if isinstance(data, (np.ndarray, memoryview)) else len(data)
        _count(body, member, size // dtype.itemsize)
        if size:
            body.align(dtype.itemsize)
            body.append(data)

    return encode_numbers


def _sequence(member: Field) -> Encoder:
    encoder = _encoder(member.base)

    def encode_sequence(body: _Body, value: Any) -> None:
        _count(body, member, len(value))
        for element in value:
            encoder(body, element)

    return encode_sequence


def _count(body: _Body, member: Field, count: int) -> None:
    """Append the length of a sequence; check the length of an array."""
    if member.length == 0:
        body.pack(_LENGTH, 4, count)
    elif count != member.length:
        raise ValueError(f"{member.name} has {count} values, wanted {member.length}")


def _zero(member: Field) -> Any:
    if member.length is not None:
        return (0,) * member.length
    if member.base == "string":
        return ""
    return {} if member.base in DEFINITIONS else 0


def _flat(name: str) -> list[str]:
    """Return a message's primitives in wire order. If the message contains a string, an array or a
    sequence, return an empty list.
    """
    primitives: list[str] = []
    for member in fields(name):
        inner = [member.base] if member.base in PRIMITIVES else []
        if member.base in DEFINITIONS:
            inner = _flat(member.base)
        if member.length is not None or not inner:
            return []
        primitives += inner
    return primitives
