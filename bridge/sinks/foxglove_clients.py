"""What viewers send over Foxglove's websocket: messages on topics, and calls of services, as JSON.

Both come on the server's threads; they are carried out on the thread that listens to the sink.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotYet
from typing import Any

from phy124.errors import InputError

from ..controls import Controls, Hear, Service
from ..json_messages import from_json, schema
from ..sink import Obey
from ..topics import COMMAND, Topic, full_name

ENCODING = "json"
BACKLOG = 100
"""Messages that wait; older ones are dropped."""
FLOOD = f"Messages come faster than they are heard: of more than {BACKLOG} the newest count."
OFTEN = 0.2
"""Time between two looks whether the sink has been closed [s]."""
Job = Callable[[Obey], object]


class Clients:
    """Messages and calls of all viewers."""

    def __init__(self, controls: Controls, post: Callable[[Job], None]) -> None:
        """Ready for viewers.

        Args:
            controls: What is heard and offered.
            post: Takes a job for the thread that listens.
        """
        self._post, self._node = post, controls.node
        heard = {full_name(t.name, self._node): (t, hear) for t, hear in controls.heard.items()}
        self._heard: dict[str, tuple[Topic, Hear | None]] = {**heard, COMMAND.name: (COMMAND, None)}
        self._services = controls.services
        self._channels: dict[tuple[int, int], str] = {}
        self._waiting: deque[tuple[str, bytes]] = deque(maxlen=BACKLOG)
        self._refused = controls.refused
        self._flooded = False
        """Whether it was said that messages are left out."""
        self.closed = False
        """Whether calls are answered no more."""

    def advertise(self, client: int, channel: int, topic: str, encoding: str) -> None:
        """A viewer is going to publish on a topic.

        Args:
            client: Number of the viewer.
            channel: Number by which it calls the topic.
            topic: The topic's name.
            encoding: How it writes messages.
        """
        if topic not in self._heard:
            said = f"{topic}: nothing is heard there; topics are {', '.join(sorted(self._heard))}."
            self._post(lambda obey: self._refused(said))
        elif encoding != ENCODING:
            said = f"{topic}: messages are JSON here, not {encoding}."
            self._post(lambda obey: self._refused(said))
        else:
            self._channels[client, channel] = topic

    def unadvertise(self, client: int, channel: int) -> None:
        """A viewer is not going to publish any more."""
        self._channels.pop((client, channel), None)

    def message(self, client: int, channel: int, data: bytes) -> None:
        """A viewer has published a message."""
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

    def offered(self) -> list[Any]:
        """The services, for the server."""
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
        """Pass on the messages that wait."""
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
    """Nothing, so that who waits for a job hears the messages."""
    del obey
