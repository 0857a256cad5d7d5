"""A ROS 2 node of rclpy, from its start to its clean shutdown."""

# rclpy comes with ROS 2 and is in no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from phy124.errors import InputError

from .discovery import tuned_cyclone
from .topics import NAMESPACE, PLAYER


@contextmanager
def ros_node(
    args: list[str] | None = None, name: str = PLAYER, make: Callable[..., Any] | None = None
) -> Iterator[Any]:
    """Run the node /phy124/NAME within this context, and shut it down cleanly at the end.

    Args:
        args: `--ros-args` and the arguments after it.
        name: Name of the node.
        make: Function that makes the node from its name and namespace. If None, a plain node is
            made.
    """
    require_rclpy()
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    try:
        # ROS's signal handlers would end its context before the last frames have arrived.
        no_handlers = SignalHandlerOptions.NO
        with tuned_cyclone():
            _start(lambda: rclpy.init(args=args, signal_handler_options=no_handlers))
            node = _start(lambda: (make or Node)(name, namespace=NAMESPACE))
        try:
            with logged_by(node):
                yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def require_rclpy() -> None:
    """Check that rclpy can be imported.

    Raises:
        InputError: rclpy cannot be imported.
    """
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        limit = f"rclpy cannot be imported ({error}); it comes with ROS 2, not from PyPI."
        remedy = "Source your ROS 2 installation (`source /opt/ros/jazzy/setup.bash`)."
        raise InputError("backend", "rclpy", limit, remedy) from error


def _start(start: Callable[[], Any]) -> Any:
    try:
        return start()
    except InputError:
        raise
    except (RuntimeError, ValueError) as error:
        said = " ".join(str(error).split())
        limit = f"ROS 2 refuses it ({said})."
        remedy = (
            "A parameter is -p NAME:=VALUE. Put a list in quotation marks, and write either all "
            "or none of its numbers with a decimal point: -p 'translation:=[1.0, 0.0, 0.0]'."
        )
        raise InputError("--ros-args", " ".join(sys.argv[1:]), limit, remedy) from error


@contextmanager
def temporary_entities(node: Any) -> Iterator[None]:
    """Destroy the publishers, subscriptions and services that were created within this context."""
    kinds = ("publisher", "subscription", "service")
    before = {kind: list(getattr(node, f"{kind}s")) for kind in kinds}
    try:
        yield
    finally:
        for kind in kinds:
            for entity in list(getattr(node, f"{kind}s")):
                if not any(entity is each for each in before[kind]):
                    getattr(node, f"destroy_{kind}")(entity)


class RosHandler(logging.Handler):
    """Passes log records to a node's logger, so that ROS publishes them on /rosout."""

    def __init__(self, logger: Any) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        """Pass a log record to the node's logger.

        Each level has a separate call, because rclpy allows one level per line of code.
        """
        text = self.format(record)
        if record.levelno >= logging.CRITICAL:
            self._logger.fatal(text)
        elif record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)


@contextmanager
def logged_by(node: Any) -> Iterator[None]:
    """Send all log records only to the node's logger within this context."""
    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    root.handlers[:] = [RosHandler(node.get_logger())]
    root.setLevel(min(level, logging.INFO))
    try:
        yield
    finally:
        root.handlers[:] = before
        root.setLevel(level)
