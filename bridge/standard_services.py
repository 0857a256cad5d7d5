"""The standard services of simulators in a ROS 2 node; std_srvs where simulation_interfaces is not.

Requests are served on the thread that spins the node. Steps of an action are made between its other
callbacks, so that it can be cancelled.
"""

# rclpy comes with ROS 2 and is on no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Mapping
from importlib import import_module
from typing import Any

from phy124.errors import InputError

from .controls import Controls, Service
from .steering.standard import PACKAGE, Code, result

MISSING = (
    f"{PACKAGE} is not installed: instead of the standard services there are ~/step and ~/reset "
    "(std_srvs/Trigger) beside ~/play and ~/pause."
)
INSTALL = "sudo apt install ros-${ROS_DISTRO}-simulation-interfaces"
TRIGGERS = {"step": "next", "reset": "restart"}
"""Service of std_srvs -> command."""
log = logging.getLogger(__name__)


def offer_standard(node: Any, controls: Controls, ask: Callable[[str], str | None]) -> None:
    """Offer the services of `controls`, if it has any.

    Args:
        node: The node.
        controls: What is offered.
        ask: Carries out a command; returns why it was refused, or None.
    """
    if not controls.services:
        return
    try:
        kinds = import_module(f"{PACKAGE}.srv")
    except ImportError:
        log.warning("%s `%s` brings it.", MISSING, INSTALL)
        trigger = import_module("std_srvs.srv").Trigger
        for name, command in TRIGGERS.items():
            node.create_service(trigger, f"~/{name}", _triggered(ask, command))
        return
    for service in controls.services:
        kind = getattr(kinds, service.type.rsplit("/", 1)[1])
        node.create_service(kind, service.name, _served(service))
    if controls.steps is not None:
        _offer_action(node, controls.steps)


def fill(message: Any, content: Mapping[str, Any]) -> Any:
    """The message with these members, those of inner messages included."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def _served(service: Service) -> Callable[[Any, Any], Any]:
    return lambda request, response: fill(response, service.serve(request))


def _triggered(ask: Callable[[str], str | None], command: str) -> Callable[[Any, Any], Any]:
    def serve(request: Any, response: Any) -> Any:
        del request
        response.message = ask(command) or ""
        response.success = not response.message
        return response

    return serve


def _offer_action(node: Any, steps: Callable[[int], Any]) -> None:
    """The action SimulateSteps; rclpy keeps it as long as the node."""
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

    ActionServer(
        node, kind, "~/simulate_steps", execute,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
    )  # fmt: skip


class _Others:
    """Awaited, it lets the executor serve others before it goes on."""

    def __await__(self) -> Generator[None, None, None]:
        yield
