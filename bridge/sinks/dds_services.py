"""DdsServices: services of a ROS 2 node without ROS 2, in the form of rmw_cyclonedds_cpp.

A request on `rq/NAMERequest` and its reply on `rr/NAMEReply` begin with the client's identity and
the request's number. Other middlewares carry these elsewhere, so their clients get no answer.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from ..cdr import ENCAPSULATION, encode
from ..controls import Service
from ..topics import Topic, full_name
from .dds_quality import quality

DEPTH = 10
AT_ONCE = 4
"""Requests of one service that are served before others are listened to."""
HEADER = struct.Struct("<Qq")
"""Identity of the client, number of the request; 16 bytes, so what follows stays aligned."""


class _Offered(NamedTuple):
    service: Service
    reader: Any
    writer: Any


class DdsServices:
    """The services of one node."""

    def __init__(self, participant: Any, services: Sequence[Service], node: str) -> None:
        """Offer services.

        Args:
            participant: The participant in the DDS domain.
            services: What is offered.
            node: Name of the node.
        """
        self._offered = [_offer(participant, service, node) for service in services]

    @property
    def readers(self) -> list[Any]:
        """Of the requests."""
        return [one.reader for one in self._offered]

    @property
    def writers(self) -> list[Any]:
        """Of the replies."""
        return [one.writer for one in self._offered]

    def serve(self) -> None:
        """Answer the requests that have come."""
        for one in self._offered:
            for request in one.reader.take(AT_ONCE):
                if request.sample_info.valid_data:
                    _answer(one, request)


def _answer(one: _Offered, request: Any) -> None:
    from ..idl import sample

    name = f"{one.service.type}_Response"
    body = encode(name, one.service.serve(request))[len(ENCAPSULATION) :]
    header = HEADER.pack(request.client, request.number)
    one.writer.write(sample(name, ENCAPSULATION + header + body))


def _offer(participant: Any, service: Service, node: str) -> _Offered:
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic as DdsTopic

    from ..idl import encoded_type, service_type

    name = full_name(service.name, node)
    asked, told = f"{service.type}_Request", f"{service.type}_Response"
    # By it a client that waits for the service knows which reader and writer belong together.
    identity = ".".join(f"{byte:x}" for byte in participant.guid.bytes[:12])
    topics = {kind: Topic(name, kind, DEPTH, transient_local=False) for kind in (asked, told)}
    qos = {kind: quality(topic, also=f"serviceid={identity};") for kind, topic in topics.items()}
    requests = DdsTopic(participant, f"rq{name}Request", service_type(asked))
    replies = DdsTopic(participant, f"rr{name}Reply", encoded_type(told))
    return _Offered(
        service,
        DataReader(participant, requests, qos=qos[asked]),
        DataWriter(participant, replies, qos=qos[told]),
    )
