"""A mock of a node whose states are changed by a manager."""

import enum
from typing import Any

from support.ros_double.node import Node


class TransitionCallbackReturn(enum.Enum):
    """rclpy.lifecycle.TransitionCallbackReturn."""

    SUCCESS = "transition_success"
    FAILURE = "transition_failure"
    ERROR = "transition_error"


STATES = {
    "configure": ("unconfigured", "inactive", "unconfigured"),
    "activate": ("inactive", "active", "inactive"),
    "deactivate": ("active", "inactive", "active"),
    "cleanup": ("inactive", "unconfigured", "inactive"),
}
"""State before each transition, after its success, and after its failure."""


class LifecycleNode(Node):
    """rclpy.lifecycle.LifecycleNode: its states, and the state after a failed transition."""

    def __init__(self, name: str, *, namespace: str) -> None:
        super().__init__(name, namespace=namespace)
        self.state = "unconfigured"
        # Destroying this service would end the node's remote control.
        self.create_service(object, "~/change_state", lambda request, response: None)

    def change_state(self, transition: str) -> bool:
        """`ros2 lifecycle set`; returns whether the transition succeeded."""
        if transition == "shutdown":
            assert self.state != "finalized"
            before, after, failed = self.state, "finalized", "finalized"
        else:
            before, after, failed = STATES[transition]
        if self.state != before:
            return False
        result: Any = getattr(self, f"on_{transition}")(None)
        assert result in (TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE)
        succeeded = result is TransitionCallbackReturn.SUCCESS
        self.state = after if succeeded else failed
        return succeeded
