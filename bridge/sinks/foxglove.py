"""FoxgloveSink: a websocket that Foxglove and Lichtblick open directly, with playback control.

The messages (CDR) and schemas (ros2msg) are the same as in the other sinks. Foxglove's package
foxglove-sdk sends the messages. Messages and service calls that steer a run are received by
`foxglove_clients`.
"""

from __future__ import annotations

import queue
from contextlib import suppress
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.runtime.installation import needs_extra

from ..bag import ENCODING
from ..cdr import NANO
from ..encoder import FrameEncoder
from ..messages import definition
from ..options import Options
from ..reports import Audience, Reports
from ..sink import Obey, Playback
from ..topics import Controls, Message, Topic, full_name
from .foxglove_clients import ENCODING as JSON
from .foxglove_clients import Clients, Job

PORT, PORTS = 8765, 65535
"""Default port of Foxglove, and largest valid port number."""


class FoxgloveSink:
    """Serves frames on ws://host:port."""

    def __init__(
        self,
        options: Options | None = None,
        *,
        duration: float | None = None,
        host: str = "127.0.0.1",
        port: int = PORT,
        controls: Controls | None = None,
    ) -> None:
        """Prepare the sink; the server starts when the sink's context is entered.

        Args:
            options: Options that define how frames become messages.
            duration: Length of the clip [s], so that viewers show controls to play, pause and seek.
                None for a running simulation.
            host: Address to listen on. By default, only this machine can connect.
            port: Port to listen on. If the port is 0, a free port is chosen.
            controls: Inputs, topics and services in addition to frames; by default, those of a
                player.

        Raises:
            InputError: foxglove-sdk is missing, or the port number is invalid.
        """
        require_foxglove()
        if not 0 <= port <= PORTS:
            limit = f"it must be a whole number up to {PORTS}."
            raise InputError("port", port, limit, f"The default is {PORT}.")
        self.monotonic = duration is None
        self.port = port
        self._encoder = FrameEncoder((options or Options()).live())
        self._duration, self._host = duration, host
        self._controls = controls
        self.clients = Clients(controls or Controls(), self.post)
        self._node = (controls or Controls()).node
        self._viewers = 0
        self._reports: Reports | None = None
        if controls is not None:
            audience = lambda: Audience(self._viewers, 0)  # noqa: E731
            self._reports = Reports(self._encoder, self.send, audience, controls)
        self._jobs: queue.Queue[Job] = queue.Queue()
        self._latest: list[Message] = []
        self._playback: Playback | None = None
        self._obeying = False  # whether a request is carried out, whose answer is the next state

    def __enter__(self) -> FoxgloveSink:
        """Start the server; raise InputError if the port is in use."""
        import foxglove

        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="phy124",
                host=self._host,
                port=self.port,
                context=self._context,
                server_listener=_listener(self),
                playback_time_range=self._range(),
                **self._steering_options(),
            )
        except RuntimeError as error:
            limit = f"The websocket cannot be opened ({error})."
            remedy = "Another program may use this port; choose another one."
            raise InputError("port", self.port, limit, remedy) from error
        self.port = self._server.port
        topics = [*self._encoder.topics]
        if self._controls and self._reports:
            topics += [*self._reports.topics, *self._controls.published]
        self._channels = {topic.name: self._channel(topic) for topic in dict.fromkeys(topics)}
        return self

    def __exit__(self, *_: object) -> None:
        self.clients.closed = True
        for channel in self._channels.values():
            channel.close()
        self._server.stop()

    def write(self, frame: Frame) -> None:
        """Send a frame to all viewers."""
        self._latest = self._encoder.encode(frame)
        self._log(self._latest)

    def listen(self, seconds: float, obey: Obey) -> bool:
        """Carry out the viewers' commands, and send new viewers the transform and the latest frame.

        Return whether more commands are waiting.
        """
        if self._reports:
            self._reports.send_due()
            seconds = min(seconds, self._reports.wait())
        with suppress(queue.Empty):
            job = self._jobs.get(timeout=seconds) if seconds else self._jobs.get_nowait()
            job(obey)
        self.clients.hear(obey)
        return not self._jobs.empty()

    def show(self, playback: Playback) -> None:
        """Send the state of playback to the viewers."""
        if self._reports:
            self._reports.change(playback)
        self._playback = playback
        if self._duration is not None and not self._obeying:
            self._broadcast(playback)

    def _broadcast(self, playback: Playback, sought: bool = False, request: str = "") -> None:
        from foxglove.websocket import PlaybackState, PlaybackStatus

        status = PlaybackStatus.Paused if playback.paused else PlaybackStatus.Playing
        if playback.finished:
            status = PlaybackStatus.Ended
        now = self._encoder.stamp(playback.position)
        state = PlaybackState(status, now, playback.speed, sought, request or None)
        self._server.broadcast_playback_state(state)

    def send(self, message: Message) -> None:
        """Send a message to all viewers."""
        self._log([message])

    @property
    def start(self) -> float:
        """Time at which the clip starts [s since 1970]."""
        return self._encoder.start

    def audience(self) -> str:
        """Return a line with the address that viewers open."""
        there = self._host if self._host != "0.0.0.0" else "this machine's name"
        return f"Open ws://{there}:{self.port} in Foxglove."

    def post(self, job: Job) -> None:
        """Append a job of a server thread to the queue of the thread that calls `listen`."""
        self._jobs.put(job)

    def forget(self, topic: str) -> None:
        """Record that a viewer has unsubscribed from a topic; a server thread calls this method."""
        self._viewers -= topic == self._encoder.main.name

    def newcomer(self, topic: str) -> None:
        """Record a new subscriber in a server thread, and send it the latest message."""
        self._viewers += topic == self._encoder.main.name
        names = {t.name for t in self._encoder.topics if full_name(t.name, self._node) == topic}
        self.post(
            lambda obey: self._log(
                [*self._encoder.static(), *(m for m in self._latest if m.topic.name in names)]
            )
        )

    def control(self, playing: bool, speed: float, seek: int | None, request: str) -> None:
        """Carry out a viewer's command from the playback controls, in a server thread.

        Args:
            playing: True to play, False to pause.
            speed: Playback speed: seconds of the clip per real second.
            seek: Time to seek [ns since 1970]. If None, the time does not change.
            request: Identifier of the request; the state after the request contains it.
        """

        def carry_out(obey: Obey) -> None:
            sought, self._obeying = False, True
            try:
                obey(f"speed {speed!r}")
                if seek is not None:
                    sought = obey(f"seek {(seek - self._encoder.epoch) / NANO!r}") is None
                obey("play" if playing else "pause")
            finally:
                self._obeying = False
            if self._playback is not None:
                self._broadcast(self._playback, sought, request)

        self.post(carry_out)

    def _range(self) -> tuple[int, int] | None:
        if self._duration is None:
            return None
        return self._encoder.epoch, self._encoder.stamp(self._duration)

    def _steering_options(self) -> dict[str, Any]:
        from foxglove.websocket import Capability

        if self._controls is None:
            return {}
        return {
            "capabilities": [Capability.ClientPublish, Capability.Services],
            "supported_encodings": [JSON],
            "services": self.clients.list_services(),
        }

    def _channel(self, topic: Topic) -> Any:
        from foxglove import Channel, Schema

        text = definition(topic.type).encode()
        schema = Schema(name=topic.type, encoding="ros2msg", data=text)
        name = full_name(topic.name, self._node)
        return Channel(name, message_encoding=ENCODING, schema=schema, context=self._context)

    def _log(self, messages: list[Message]) -> None:
        # Reports contain no time stamp.
        now = self._latest[0].stamp if self._latest else self._encoder.epoch
        for message in messages:
            when = message.stamp or now
            self._channels[message.topic.name].log(message.data, log_time=when)


def _listener(sink: FoxgloveSink) -> Any:
    from foxglove.websocket import PlaybackCommand, ServerListener

    class Listener(ServerListener):
        def on_subscribe(self, client: Any, channel: Any) -> None:
            del client
            sink.newcomer(channel.topic)

        def on_unsubscribe(self, client: Any, channel: Any) -> None:
            del client
            sink.forget(channel.topic)

        def on_client_advertise(self, client: Any, channel: Any) -> None:
            sink.clients.advertise(client.id, channel.id, channel.topic, channel.encoding)

        def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
            sink.clients.unadvertise(client.id, client_channel_id)

        def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
            sink.clients.message(client.id, client_channel_id, data)

        def on_playback_control_request(self, playback_control_request: Any) -> None:
            asked = playback_control_request
            playing = asked.playback_command == PlaybackCommand.Play
            sink.control(playing, asked.playback_speed, asked.seek_time, asked.request_id)

    return Listener()


def require_foxglove() -> None:
    """Check that foxglove-sdk can be imported.

    Raises:
        InputError: foxglove-sdk is not installed.
    """
    limit = "Serving Foxglove needs the package foxglove-sdk, which is not installed."
    with needs_extra("foxglove", "backend", "foxglove", limit):
        import foxglove  # noqa: F401
