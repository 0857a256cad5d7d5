"""The services of the node: those of rosbag2's player, and three triggers."""

from __future__ import annotations

import logging
from collections.abc import Callable
from importlib import import_module
from typing import Any

from .cdr import NANO
from .playback import Playback

TRIGGERS = ("play", "pause", "restart")
log = logging.getLogger(__name__)


class Services:
    """Offers services; requests go to `ask(command)`, which returns why it refuses, or None."""

    def __init__(
        self, node: Any, ask: Callable[[str], str | None], playback: Callable[[], Playback | None]
    ) -> None:
        self._ask, self._playback = ask, playback
        trigger = import_module("std_srvs.srv").Trigger
        for word in TRIGGERS:
            node.create_service(trigger, f"~/{word}", self._trigger(word))
        try:
            rosbag2 = import_module("rosbag2_interfaces.srv")
        except ImportError:
            log.warning(
                "rosbag2_interfaces is not installed: there are no services ~/seek, ~/set_rate, "
                "~/toggle_paused, ~/is_paused and ~/play_next."
            )
            return
        for kind, name, serve in (
            ("Seek", "seek", self._seek),
            ("SetRate", "set_rate", self._set_rate),
            ("TogglePaused", "toggle_paused", self._toggle_paused),
            ("IsPaused", "is_paused", self._is_paused),
            ("PlayNext", "play_next", self._play_next),
        ):
            node.create_service(getattr(rosbag2, kind), f"~/{name}", serve)

    def _trigger(self, word: str) -> Callable[[Any, Any], Any]:
        def serve(request: Any, response: Any) -> Any:
            del request
            response.message = self._ask(word) or ""
            response.success = not response.message
            return response

        return serve

    def _seek(self, request: Any, response: Any) -> Any:
        seconds = request.time.sec + request.time.nanosec / NANO
        response.success = self._ask(f"seek {seconds!r}") is None
        return response

    def _set_rate(self, request: Any, response: Any) -> Any:
        # What rosbag2 calls the rate is called speed here: clip seconds per second.
        response.success = self._ask(f"speed {request.rate!r}") is None
        return response

    def _toggle_paused(self, request: Any, response: Any) -> Any:
        del request
        self._ask("toggle")
        return response

    def _is_paused(self, request: Any, response: Any) -> Any:
        del request
        playback = self._playback()
        response.paused = playback is not None and playback.paused
        return response

    def _play_next(self, request: Any, response: Any) -> Any:
        del request
        response.success = self._ask("next") is None
        return response
