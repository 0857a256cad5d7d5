"""Cyclone DDS types of the ROS 2 messages, built from the definitions that the CDR encoder uses."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, annotations, make_idl_struct, types

from .messages import Field, fields

SCALARS: dict[str, Any] = {
    "bool": bool,
    "string": str,
    "byte": types.byte,
    "int8": types.int8,
    "uint8": types.uint8,
    "int16": types.int16,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64,
    "float32": types.float32,
    "float64": types.float64,
}

Decode = Callable[..., Any]
"""Function that returns a sample from its bytes, as `IdlStruct.deserialize` does."""

LATER: dict[str, dict[str, Any]] = {
    "simulation_interfaces/srv/SetEntityState_Request": {
        "set_pose": bool,
        "set_twist": bool,
        "set_acceleration": bool,
    }
}
"""Members that version 2 of a package (in Lyrical) appends to requests, by the type of the request.
"""


class Undecoded:
    """A sample that could not be decoded, for example because a text is not UTF-8."""

    def __init__(self, error: Exception) -> None:
        self.error = error


@cache
def idl_type(name: str) -> type[IdlStruct]:
    """Return the final, keyless DDS type of a ROS message, with the name that ROS 2 uses.

    If a sample cannot be decoded, readers take an `Undecoded` instead of raising an error, which
    would also lose the other samples.
    """
    kind = _struct(name, {})
    return _decoded_by(kind, _refuse(kind.deserialize))


@cache
def service_type(name: str) -> type[IdlStruct]:
    """Return a service's request or response type, with the header of rmw_cyclonedds_cpp.

    Requests may also contain the flags in `LATER`. As with `idl_type`, a sample that cannot be
    decoded becomes an `Undecoded`.
    """
    header = {"client": types.uint64, "number": types.int64}
    kind = _struct(name, header)
    decode = kind.deserialize
    if name in LATER:
        later, only_earlier = _struct(name, header, LATER[name]), decode

        def decode(data: bytes, *args: Any, **options: Any) -> Any:
            try:
                return later.deserialize(data, *args, **options)
            except struct.error:  # The message does not contain these flags.
                return only_earlier(data, *args, **options)

    return _decoded_by(kind, _refuse(decode))


def _refuse(decode: Decode) -> Decode:
    def decode_or_refuse(data: bytes, *args: Any, **options: Any) -> Any:
        try:
            return decode(data, *args, **options)
        except Exception as error:
            # Other programs send these bytes, and cyclonedds raises many kinds of errors.
            return Undecoded(error)

    return decode_or_refuse


def _decoded_by(kind: type[IdlStruct], decode: Decode) -> type[IdlStruct]:
    setattr(kind, "deserialize", staticmethod(decode))  # noqa: B010
    return kind


def _struct(
    name: str, before: dict[str, Any], after: dict[str, Any] | None = None
) -> type[IdlStruct]:
    package, kind, base = name.split("/")
    members = {member.name: _member(member) for member in fields(name)}
    mangled = f"{package}::{kind}::dds_::{base}_"
    return annotations.final(make_idl_struct(base, mangled, {**before, **members, **(after or {})}))


@cache
def encoded_type(name: str) -> type[IdlStruct]:
    """Return the type for writers whose samples are already CDR payloads; see `sample`.

    The type of a service's response begins with the header of the request.
    """
    kind = (service_type if name.endswith("_Response") else idl_type).__wrapped__(name)
    # DataWriter.write calls serialize(), which here avoids the slow encoder of single fields.
    setattr(kind, "serialize", _payload)  # noqa: B010
    return kind


def sample(name: str, payload: bytes) -> IdlStruct:
    """Return a sample of `encoded_type(name)` whose serialised form is `payload`."""
    made = object.__new__(encoded_type(name))
    vars(made)["payload"] = payload
    return made


def _payload(
    made: Any, buffer: Any = None, endianness: Any = None, use_version_2: Any = None
) -> bytes:
    del buffer, endianness, use_version_2
    return made.payload


def _member(member: Field) -> Any:
    kind = SCALARS.get(member.base) or idl_type(member.base)
    if member.bound:
        kind = types.bounded_str[member.bound]
    if member.length is None:
        return kind
    return types.array[kind, member.length] if member.length else types.sequence[kind]
