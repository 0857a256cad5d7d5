"""FoxgloveSink: a websocket that Foxglove and Lichtblick open directly, with playback control.

It sends the same CDR messages and ros2msg schemas as the other sinks; the package is foxglove-sdk.
"""

from __future__ import annotations

import queue
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.runtime.installation import install_command

from ..bag import ENCODING
from ..cdr import NANO
from ..encoder import FrameEncoder
from ..messages import definition
from ..options import Options
from ..playback import Playback
from ..sink import Obey
from ..topics import Message

PORT = 8765
"""Port that Foxglove tries first."""


class FoxgloveSink:
    """Serves frames on ws://host:port."""

    def __init__(
        self,
        options: Options | None = None,
        *,
        duration: float | None = None,
        host: str = "127.0.0.1",
        port: int = PORT,
    ) -> None:
        """Ready to enter.

        Args:
            options: How frames become messages.
            duration: Length of the clip [s], with which viewers show play, pause, seek and speed;
                None for a running simulation.
            host: Address to listen on; the default is this machine only.
            port: Port to listen on; 0 picks a free one.

        Raises:
            InputError: foxglove-sdk is missing.
        """
        require_foxglove()
        self.monotonic = duration is None
        self.port = port
        self._encoder = FrameEncoder((options or Options()).live())
        self._duration, self._host = duration, host
        self._requests: queue.Queue[list[str]] = queue.Queue()
        self._latest: list[Message] = []
        self._answers: str | None = None  # the request that the next state answers
        self._sought = False

    def __enter__(self) -> FoxgloveSink:
        """Listen. Raises InputError if the port is taken."""
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
            )
        except RuntimeError as error:
            limit = f"The websocket cannot be opened ({error})."
            remedy = "Another viewer server may be running; choose another port."
            raise InputError("port", self.port, limit, remedy) from error
        self.port = self._server.port
        self._channels = {topic.name: self._channel(topic) for topic in self._encoder.topics}
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect all viewers."""
        for channel in self._channels.values():
            channel.close()
        self._server.stop()

    def write(self, frame: Frame) -> None:
        """Send one frame to all viewers."""
        self._latest = self._encoder.encode(frame)
        self._log(self._latest)

    def listen(self, seconds: float, obey: Obey) -> None:
        """Carry out the viewers' commands; new viewers get the transform and the latest frame."""
        try:
            orders = self._requests.get(timeout=seconds) if seconds else self._requests.get_nowait()
        except queue.Empty:
            return
        if not orders:
            self._log([*self._encoder.static(), *self._latest])
        for order in orders:
            obey(order)

    def show(self, playback: Playback) -> None:
        """Send the state of playback to the viewers."""
        from foxglove.websocket import PlaybackState, PlaybackStatus

        if self._duration is None:
            return
        status = PlaybackStatus.Paused if playback.paused else PlaybackStatus.Playing
        if playback.finished:
            status = PlaybackStatus.Ended
        now = self._encoder.stamp(playback.position)
        state = PlaybackState(status, now, playback.speed, self._sought, self._answers)
        self._answers, self._sought = None, False
        self._server.broadcast_playback_state(state)

    def send(self, message: Message) -> None:
        """Send one message to all viewers."""
        self._log([message])

    def audience(self) -> str:
        """One line: the address to open."""
        there = self._host if self._host != "0.0.0.0" else "this machine's name"
        return f"Open ws://{there}:{self.port} in Foxglove."

    def newcomer(self) -> None:
        """Called by the server's thread when a viewer subscribes."""
        self._requests.put([])

    def control(self, playing: bool, speed: float, seek: int | None, request: str) -> None:
        """Called by the server's thread when a viewer uses the playback controls.

        Args:
            playing: Whether to play or to pause.
            speed: Clip seconds per second.
            seek: Time to go to [ns since 1970]; None: stay.
            request: Identifier that the next state has to carry.
        """
        orders = [f"speed {speed!r}"]
        if seek is not None:
            orders.append(f"seek {(seek - self._encoder.epoch) / NANO!r}")
            self._sought = True
        self._answers = request
        self._requests.put([*orders, "play" if playing else "pause"])

    def _range(self) -> tuple[int, int] | None:
        if self._duration is None:
            return None
        return self._encoder.epoch, self._encoder.stamp(self._duration)

    def _channel(self, topic: Any) -> Any:
        from foxglove import Channel, Schema

        text = definition(topic.type).encode()
        schema = Schema(name=topic.type, encoding="ros2msg", data=text)
        return Channel(topic.name, message_encoding=ENCODING, schema=schema, context=self._context)

    def _log(self, messages: list[Message]) -> None:
        for message in messages:
            self._channels[message.topic.name].log(message.data, log_time=message.stamp)


def _listener(sink: FoxgloveSink) -> Any:
    """The listener that the server calls from its own thread; its base class does the rest."""
    from foxglove.websocket import PlaybackCommand, ServerListener

    class Listener(ServerListener):
        def on_subscribe(self, client: Any, channel: Any) -> None:
            del client, channel
            sink.newcomer()

        def on_playback_control_request(self, playback_control_request: Any) -> None:
            asked = playback_control_request
            playing = asked.playback_command == PlaybackCommand.Play
            sink.control(playing, asked.playback_speed, asked.seek_time, asked.request_id)

    return Listener()


def require_foxglove() -> None:
    """Check that foxglove-sdk can be imported.

    Raises:
        InputError: It cannot.
    """
    try:
        import foxglove  # noqa: F401
    except ImportError as error:
        limit = "Serving Foxglove needs the package foxglove-sdk, which is not installed."
        remedy = f"Run `{install_command('foxglove')}`."
        raise InputError("backend", "foxglove", limit, remedy) from error
