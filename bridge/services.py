"""Services of a ROS 2 node: triggers, and the standard services of players and simulators.

The thread that spins the node serves the requests. The steps of an action are computed between
other callbacks, so that the action can be cancelled.
"""

# rclpy comes with ROS 2 and is in no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Mapping
from importlib import import_module
from typing import Any

from phy124.errors import InputError

from .cdr import NANO
from .sink import Playback
from .steering.entities import Code, result
from .steering.standard import PACKAGE
from .topics import Controls, Service

TRIGGERS = ("play", "pause", "restart")
log = logging.getLogger(__name__)
MISSING = (
    f"{PACKAGE} is not installed: ~/step and ~/reset (std_srvs/Trigger) replace its services, "
    "in addition to ~/play and ~/pause."
)
INSTALL = "sudo apt install ros-${ROS_DISTRO}-simulation-interfaces"
FALLBACK = {"step": "next", "reset": "restart"}
"""Commands that the services send, by the name of the service."""


class Services:
    """Offers services; `ask(command)` executes a command and returns the reason of a refusal."""

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
        # The "rate" of rosbag2 is the playback speed: seconds of the clip per real second.
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


def offer_standard(node: Any, controls: Controls, ask: Callable[[str], str | None]) -> None:
    """Offer the services of `controls`, if there are any.

    Args:
        node: The node.
        controls: The services.
        ask: Function that executes a command and returns the reason of a refusal, or None.
    """
    if not controls.services:
        return
    try:
        kinds = import_module(f"{PACKAGE}.srv")
    except ImportError:
        log.warning("%s `%s` installs it.", MISSING, INSTALL)
        trigger = import_module("std_srvs.srv").Trigger
        for name, command in FALLBACK.items():
            node.create_service(trigger, f"~/{name}", _serve_trigger(ask, command))
        return
    for service in controls.services:
        kind = getattr(kinds, service.type.rsplit("/", 1)[1])
        node.create_service(kind, service.name, _serve_with(service))
    if controls.steps is not None:
        _offer_action(node, controls.steps)


def fill(message: Any, content: Mapping[str, Any]) -> Any:
    """Set the members of a message, recursively."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def _serve_with(service: Service) -> Callable[[Any, Any], Any]:
    return lambda request, response: fill(response, service.serve(request))


def _serve_trigger(ask: Callable[[str], str | None], command: str) -> Callable[[Any, Any], Any]:
    def serve(request: Any, response: Any) -> Any:
        del request
        response.message = ask(command) or ""
        response.success = not response.message
        return response

    return serve


def _offer_action(node: Any, steps: Callable[[int], Any]) -> None:
    """Offer the action SimulateSteps; rclpy keeps the action server until the node is destroyed."""
    from rclpy.action import ActionServer, CancelResponse

    kind = import_module(f"{PACKAGE}.action").SimulateSteps

    async def execute(goal: Any) -> Any:
        asked, answer = goal.request.steps, kind.Result()
        try:
            for done in steps(asked):
                if goal.is_cancel_requested:
                    goal.canceled()
                    said = f"Cancelled after {done} of {asked} steps."
                    return fill(answer, {"result": result(Code.OPERATION_FAILED, said)})
                feedback = {"completed_steps": done, "remaining_steps": asked - done}
                goal.publish_feedback(fill(kind.Feedback(), feedback))
                await _Others()
        except InputError as error:
            goal.abort()
            return fill(answer, {"result": result(Code.OPERATION_FAILED, str(error))})
        goal.succeed()
        return fill(answer, {"result": result(Code.OK)})

    cancel: Any = lambda goal: CancelResponse.ACCEPT  # noqa: E731
    ActionServer(node, kind, "~/simulate_steps", execute, cancel_callback=cancel)


class _Others:
    """An awaitable that lets the executor run other callbacks first."""

    def __await__(self) -> Generator[None, None, None]:
        yield
