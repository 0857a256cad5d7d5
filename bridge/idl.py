"""Cyclone DDS types of the ROS 2 messages, built from the same definitions as the CDR encoder."""

from __future__ import annotations

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


@cache
def idl_type(name: str) -> type[IdlStruct]:
    """The final, keyless DDS type of a ROS message, with the name that ROS 2 uses."""
    return _struct(name, {})


@cache
def service_type(name: str) -> type[IdlStruct]:
    """The type of a service's request or response behind the header of rmw_cyclonedds_cpp."""
    return _struct(name, {"client": types.uint64, "number": types.int64})


def _struct(name: str, before: dict[str, Any]) -> type[IdlStruct]:
    package, kind, base = name.split("/")
    members = {member.name: _member(member) for member in fields(name)}
    mangled = f"{package}::{kind}::dds_::{base}_"
    return annotations.final(make_idl_struct(base, mangled, {**before, **members}))


@cache
def encoded_type(name: str) -> type[IdlStruct]:
    """The same type for writers whose samples are CDR payloads already; see `sample`.

    That of a response has the header, too.
    """
    kind = (service_type if name.endswith("_Response") else idl_type).__wrapped__(name)
    # DataWriter.write calls serialize(); this skips the field-by-field encoder, which is slow.
    setattr(kind, "serialize", _payload)  # noqa: B010
    return kind


def sample(name: str, payload: bytes) -> IdlStruct:
    """A sample of `encoded_type(name)` that is written as `payload`."""
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
