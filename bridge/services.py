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
from .sink import Obey, Playback
from .steering.entities import Code, result
from .steering.standard import PACKAGE
from .topics import Controls, Service

TRIGGERS = ("play", "pause", "restart")
Serve = Callable[[Any, Any], Any]
log = logging.getLogger(__name__)
MISSING = (
    f"{PACKAGE} is not installed: ~/step and ~/reset (std_srvs/Trigger) replace its services, "
    "in addition to ~/play and ~/pause."
)
INSTALL = "sudo apt install ros-${ROS_DISTRO}-simulation-interfaces"
FALLBACK = {"step": "next", "reset": "restart"}


def offer_playback(node: Any, ask: Obey, playback: Callable[[], Playback | None]) -> None:
    """Offer services to play and pause, and the services of rosbag2's player.

    `playback` returns the state of playback, or None before the start.
    """

    def attempts(command: Callable[[Any], str]) -> Serve:
        def serve(request: Any, response: Any) -> Any:
            response.success = ask(command(request)) is None
            return response

        return serve

    def toggle_paused(request: Any, response: Any) -> Any:
        del request
        ask("toggle")
        return response

    def is_paused(request: Any, response: Any) -> Any:
        del request
        state = playback()
        response.paused = state is not None and state.paused
        return response

    _offer_triggers(node, ask, {word: word for word in TRIGGERS})
    try:
        rosbag2 = import_module("rosbag2_interfaces.srv")
    except ImportError:
        log.warning(
            "rosbag2_interfaces is not installed: there are no services ~/seek, ~/set_rate, "
            "~/toggle_paused, ~/is_paused and ~/play_next."
        )
        return
    for kind, name, serve in (
        ("Seek", "seek", attempts(lambda r: f"seek {r.time.sec + r.time.nanosec / NANO!r}")),
        # The "rate" of rosbag2 is the playback speed: seconds of the clip per real second.
        ("SetRate", "set_rate", attempts(lambda request: f"speed {request.rate!r}")),
        ("TogglePaused", "toggle_paused", toggle_paused),
        ("IsPaused", "is_paused", is_paused),
        ("PlayNext", "play_next", attempts(lambda request: "next")),
    ):
        node.create_service(getattr(rosbag2, kind), f"~/{name}", serve)


def _offer_triggers(node: Any, ask: Obey, commands: Mapping[str, str]) -> None:
    trigger = import_module("std_srvs.srv").Trigger
    for name, command in commands.items():

        def serve(request: Any, response: Any, command: str = command) -> Any:
            del request
            response.message = ask(command) or ""
            response.success = not response.message
            return response

        node.create_service(trigger, f"~/{name}", serve)


def offer_standard(node: Any, controls: Controls, ask: Obey) -> None:
    """Offer the standard services of simulators that `controls` lists."""
    if not controls.services:
        return
    try:
        kinds = import_module(f"{PACKAGE}.srv")
    except ImportError:
        log.warning("%s `%s` installs it.", MISSING, INSTALL)
        return _offer_triggers(node, ask, FALLBACK)
    for service in controls.services:

        def answer(request: Any, response: Any, service: Service = service) -> Any:
            return fill(response, service.serve(request))

        kind = getattr(kinds, service.type.rsplit("/", 1)[1])
        node.create_service(kind, service.name, answer)
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


def _offer_action(node: Any, steps: Callable[[int], Any]) -> None:
    """rclpy keeps the action server until the node is destroyed."""
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
