"""Messages and service calls that viewers send over Foxglove's websocket, as JSON.

Messages and calls are received in the threads of the server, and executed in the thread that calls
`listen`.
"""

from __future__ import annotations

import json
import reprlib
import struct
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from types import SimpleNamespace
from typing import Any

from phy124.errors import InputError

from ..cdr import PRIMITIVES
from ..messages import DEFINITIONS, Field, fields
from ..sink import Obey
from ..topics import COMMAND, Controls, Hear, Service, Topic, full_name

ENCODING = "json"
BACKLOG = 100
"""Largest number of waiting messages; if there are more, the oldest messages are discarded."""
FLOOD = f"Messages arrive faster than they are read: only the newest {BACKLOG} are kept."
OFTEN = 0.2
"""Interval at which waiting calls check whether the sink was closed [s]."""
Job = Callable[[Obey], object]
INTEGERS = ("byte", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
WORDS = {bool: "boolean", str: "string", int: "integer", float: "number"}
REMEDY = "Send JSON with the members of the message; missing members are zero or empty."


class Clients:
    """Receives the messages and service calls of all viewers."""

    def __init__(self, controls: Controls, post: Callable[[Job], None]) -> None:
        self._post, self._node = post, controls.node
        heard = {full_name(t.name, self._node): (t, hear) for t, hear in controls.heard.items()}
        self._heard: dict[str, tuple[Topic, Hear | None]] = {**heard, COMMAND.name: (COMMAND, None)}
        self._services = controls.services
        self._channels: dict[tuple[int, int], str] = {}
        self._waiting: deque[tuple[str, bytes]] = deque(maxlen=BACKLOG)
        self._refused = controls.refused
        self._flooded = False
        self.closed = False
        """Whether the sink was closed, so that calls of services are no longer answered."""

    def advertise(self, client: int, channel: int, topic: str, encoding: str) -> None:
        """Record that a viewer will publish on a topic.

        Args:
            client: Identifier of the viewer.
            channel: Identifier that the viewer uses for the topic.
            topic: Name of the topic.
            encoding: Encoding of the messages.
        """
        if topic not in self._heard:
            said = (
                f"{topic}: messages on this topic are ignored; the topics "
                f"are {', '.join(sorted(self._heard))}."
            )
            self._post(lambda obey: self._refused(said))
        elif encoding != ENCODING:
            said = f"{topic}: messages must be JSON, not {encoding}."
            self._post(lambda obey: self._refused(said))
        else:
            self._channels[client, channel] = topic

    def unadvertise(self, client: int, channel: int) -> None:
        """Record that a viewer stops publishing on a channel."""
        self._channels.pop((client, channel), None)

    def message(self, client: int, channel: int, data: bytes) -> None:
        """Append to the queue a message that a viewer has published."""
        topic = self._channels.get((client, channel))
        if topic is None:
            return
        first = not self._waiting
        if len(self._waiting) == BACKLOG and not self._flooded:
            self._flooded = True
            self._post(lambda obey: self._refused(FLOOD))
        self._waiting.append((topic, data))
        if first:
            self._post(_wake)

    def list_services(self) -> list[Any]:
        """Return the services as the objects that Foxglove's server expects."""
        from foxglove import MessageSchema, Schema, ServiceSchema
        from foxglove import Service as Offered

        def message(name: str) -> Any:
            text = json.dumps(schema(name)).encode()
            described = Schema(name=name, encoding="jsonschema", data=text)
            return MessageSchema(encoding=ENCODING, schema=described)

        return [
            Offered(
                full_name(service.name, self._node),
                schema=ServiceSchema(
                    service.type,
                    request=message(f"{service.type}_Request"),
                    response=message(f"{service.type}_Response"),
                ),
                handler=self._handler(service),
            )
            for service in self._services
        ]

    def _handler(self, service: Service) -> Callable[[Any], bytes]:
        def handle(request: Any) -> bytes:
            asked = from_json(f"{service.type}_Request", request.payload)
            answer: Future[dict[str, Any]] = Future()
            self._post(lambda obey: answer.set_result(service.serve(asked)))
            while not self.closed:
                try:
                    return json.dumps(answer.result(OFTEN)).encode()
                except NotYet:
                    continue
            raise ValueError("The run has ended.")

        return handle

    def hear(self, obey: Obey) -> None:
        """Pass the waiting messages to the functions that receive them."""
        for _ in range(len(self._waiting)):
            name, data = self._waiting.popleft()
            topic, hear = self._heard[name]
            try:
                message = from_json(topic.type, data)
            except InputError as error:
                self._refused(str(error))
                continue
            if hear is None:
                obey(message.data)
            else:
                hear(message)


def _wake(obey: Obey) -> None:
    """Do nothing; as a job in the queue, this function wakes the waiting thread."""
    del obey


def from_json(name: str, data: bytes) -> Any:
    """Parse a message; its members are attributes, and missing members are zero, empty or false.

    NaN and Infinity, which JSON lacks, are accepted as Python writes them.

    Raises:
        InputError: The data is not JSON, or a member is unknown or of the wrong type.
    """
    try:
        content = json.loads(data or b"{}")
    except (ValueError, RecursionError) as error:
        raise InputError(name, data[:40], f"it is not JSON ({error}).", REMEDY) from None
    return _message(name, content, name)


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of a message."""
    members = {member.name: _schema(member) for member in fields(name)}
    return {"type": "object", "properties": members}


def _message(name: str, content: Any, where: str) -> Any:
    if not isinstance(content, Mapping):
        raise InputError(where, content, "it must be a JSON object.", REMEDY)
    known = fields(name)
    if unknown := sorted(content.keys() - {member.name for member in known}):
        limit = f"{name} has no {', '.join(map(str, unknown))}."
        raise InputError(where, unknown[0], limit, REMEDY)
    return SimpleNamespace(
        **{member.name: _member(member, content, f"{where}.{member.name}") for member in known}
    )


def _member(member: Field, content: Mapping[str, Any], where: str) -> Any:
    value = content.get(member.name)
    if member.length is None:
        return _value(member.base, value, where)
    items = [] if value is None else value
    if not isinstance(items, list):
        raise InputError(where, value, "it must be a list.", REMEDY)
    return [_value(member.base, item, where) for item in items]


def _value(base: str, value: Any, where: str) -> Any:
    if base in DEFINITIONS:
        return _message(base, {} if value is None else value, where)
    kinds, zero = _kind(base)
    if value is None:
        return zero
    if isinstance(value, bool) is not (base == "bool") or not isinstance(value, kinds):
        raise InputError(where, value, f"it must be a {base}.", REMEDY)
    return _round(base, value, where) if base in PRIMITIVES else value


def _round(base: str, value: float, where: str) -> Any:
    """Convert a number to the type in which ROS messages store it, such as an integer to a
    float.
    """
    stored = struct.Struct(f"<{PRIMITIVES[base]}")
    try:
        (number,) = stored.unpack(stored.pack(value))
    except (OverflowError, struct.error):
        limit = f"it is outside the range of {base}."
        raise InputError(where, reprlib.repr(value), limit, REMEDY) from None
    return number


def _kind(base: str) -> tuple[tuple[type, ...], Any]:
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
