"""Sends the program's log to /rosout and ROS's console as long as a node exists."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class RosHandler(logging.Handler):
    """Passes records to the logger of a node, which publishes them on /rosout."""

    def __init__(self, logger: Any) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        """Log one record. Each level has its own call, since rclpy ties a severity to a caller."""
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
    """Within this context, everything logged goes through the node instead of elsewhere."""
    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    root.handlers[:] = [RosHandler(node.get_logger())]
    root.setLevel(min(level, logging.INFO))
    try:
        yield
    finally:
        root.handlers[:] = before
        root.setLevel(level)
