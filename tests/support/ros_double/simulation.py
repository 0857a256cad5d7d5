"""The action of simulation_interfaces and its server."""

from types import SimpleNamespace
from typing import Any


def simulation_result() -> SimpleNamespace:
    return SimpleNamespace(result=0, error_message="")


class SimulateSteps:
    """simulation_interfaces.action.SimulateSteps."""

    class Result:
        def __init__(self) -> None:
            self.result = simulation_result()

    class Feedback:
        def __init__(self) -> None:
            self.completed_steps = self.remaining_steps = 0


class GoalHandle:
    """rclpy.action.server.ServerGoalHandle."""

    def __init__(self, steps: int) -> None:
        self.request = SimpleNamespace(steps=steps)
        self.is_cancel_requested, self.ended = False, ""
        self.feedback: list[tuple[int, int]] = []

    def publish_feedback(self, feedback: Any) -> None:
        assert isinstance(feedback, SimulateSteps.Feedback)
        self.feedback.append((feedback.completed_steps, feedback.remaining_steps))

    def succeed(self) -> None:
        self.ended = "succeeded"

    def abort(self) -> None:
        self.ended = "aborted"

    def canceled(self) -> None:
        assert self.is_cancel_requested
        self.ended = "canceled"


class ActionServer:
    """rclpy.action.ActionServer, whose callback is a coroutine that tests drive."""

    def __init__(self, node, kind, name, execute_callback, *, cancel_callback) -> None:
        node.context_must_be_ok("context is invalid")
        node.actions[name] = (kind, execute_callback, cancel_callback)
