"""Publishes the state of a publisher on the topics ~/status, /diagnostics and /clock."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .cdr import message
from .cdr import time as ros_time
from .encoder import FrameEncoder
from .sink import Playback
from .topics import CLOCK, DIAGNOSTICS, NAMESPACE, STATUS, Controls, Message, Topic

CLOCK_RATE = 40.0
"""Rate of /clock [Hz], even while paused; `ros2 bag play --clock` has the same rate."""
DIAGNOSTICS_EVERY = 1.0
"""Time between two messages on /diagnostics [s]."""
log = logging.getLogger(__name__)
OK, WARN = 0, 1
"""Levels of `diagnostic_msgs/msg/DiagnosticStatus`."""


@dataclass(frozen=True)
class Audience:
    """Numbers of subscribers, of frames that may be lost, and of nodes with the same name."""

    subscribers: int
    lost: int
    namesakes: int = 0


class Reports:
    """Publishes each change of the state of playback, diagnostics every second, and the clock."""

    def __init__(
        self,
        encoder: FrameEncoder,
        send: Callable[[Message], None],
        audience: Callable[[], Audience],
        controls: Controls,
        *,
        node: str | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare the reports; no report is due before the first call of `change`.

        Args:
            encoder: Converts times in the clip to time stamps.
            send: Function that publishes a message.
            audience: Function that returns the current audience, called once a second.
            controls: Name of the node, additional entries of /diagnostics, and whether /clock is
                published.
            node: Full name of the node; by default, its name in the namespace of the bridge.
            now: Function that returns the time on the clock of playback [s].
        """
        self._encoder, self._send, self._audience = encoder, send, audience
        self._node, self._now = node or f"/{NAMESPACE}/{controls.node}", now
        self._playback: Playback | None = None
        self._due = {"diagnostics": math.inf, "clock": math.inf}
        self._clock, self._more = controls.clock, controls.values
        self._namesakes = 0
        self._lock = threading.Lock()
        self._before: tuple[float, float, int] | None = (
            None  # reading of the clock, time stamp, number of frames that may be lost
        )

    @property
    def topics(self) -> list[Topic]:
        """Topics of the reports."""
        return [STATUS, DIAGNOSTICS, *([CLOCK] if self._clock else [])]

    def change(self, playback: Playback) -> None:
        """Publish the status and due reports; the first call starts diagnostics and the clock."""
        if self._playback is None:
            self._due["diagnostics"] = self._now()
            self._due["clock"] = self._now() if self._clock else math.inf
        self._playback = playback
        self._publish(STATUS, self._status(OK, self._values(playback)))
        self.send_due()

    def wait(self) -> float:
        """Return the time until the next report is due [s]."""
        return max(min(self._due.values()) - self._now(), 0.0)

    def send_due(self) -> None:
        """Publish the reports that are due; any thread should call this method often."""
        with self._lock:
            self._send_due(self._now())

    def _send_due(self, now: float) -> None:
        if self._playback is None:
            return
        if now >= self._due["clock"]:
            self._due["clock"] = max(self._due["clock"] + 1 / CLOCK_RATE, now)
            stamp = self._encoder.stamp(self._playback.stamp_at(now))
            self._publish(CLOCK, {"clock": ros_time(stamp)})
        if now >= self._due["diagnostics"]:
            self._due["diagnostics"] = now + DIAGNOSTICS_EVERY
            self._diagnose(self._playback, now)

    def _diagnose(self, playback: Playback, now: float) -> None:
        audience = self._audience()
        if audience.namesakes > self._namesakes:
            log.warning(
                "There is another node %s: both publish on the same topics. "
                "Give one of them a name, namespace or ROS_DOMAIN_ID of its own.",
                self._node,
            )
        self._namesakes = audience.namesakes
        stamp, trouble = playback.stamp_at(now), playback.dropped + audience.lost
        then, start, known = self._before or (now, stamp, 0)
        self._before = now, stamp, trouble
        # If a reset of the run has set the time back, at least the time since then was simulated.
        seconds = stamp - start if stamp >= start else stamp
        factor = seconds / (now - then) if now > then else 0.0
        values = {
            **self._values(playback),
            "subscribers": audience.subscribers,
            "frames lost": audience.lost,
            "other nodes of this name": audience.namesakes,
            "real-time factor": f"{factor:.3f}",
            **self._more(),
        }
        level = WARN if trouble > known or audience.namesakes else OK
        header = {"stamp": ros_time(self._encoder.stamp(stamp))}
        self._publish(DIAGNOSTICS, {"header": header, "status": [self._status(level, values)]})

    def _status(self, level: int, values: dict[str, Any]) -> dict[str, Any]:
        pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
        return {
            "level": level,
            "name": f"{self._node}: playback",
            "message": str(values["state"]),
            "hardware_id": "phy124",
            "values": pairs,
        }

    def _values(self, playback: Playback) -> dict[str, Any]:
        held = "paused" if playback.paused else "playing"
        return {
            "state": "finished" if playback.finished else held,
            "position [s]": f"{playback.position:.6g}",
            "speed": f"{playback.speed:g}",
            "rate [Hz]": f"{playback.rate:g}" if playback.rate else "every frame",
            "loop": playback.loop,
            "frames shown": playback.shown,
            "frames dropped": playback.dropped,
        }

    def _publish(self, topic: Topic, content: dict[str, Any]) -> None:
        self._send(message(topic, 0, content))
