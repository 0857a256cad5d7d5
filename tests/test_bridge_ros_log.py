"""The program's log goes through the node while it lives, with the severity it had."""

import logging

from bridge.ros_node import logged_by


def test_log_levels_keep_severity_and_handlers_return(ros):
    from rclpy.node import Node

    node, root = Node("player", namespace="phy124"), logging.getLogger()
    before, level = root.handlers[:], root.level
    with logged_by(node):
        for severity in ("debug", "info", "warning", "error", "critical"):
            getattr(logging.getLogger("bridge.test"), severity)("said at %s", severity)
    logging.getLogger("bridge.test").error("after the node")
    assert root.handlers == before and root.level == level
    assert [severity for severity, _ in node.logger.lines][-4:] == [
        "INFO",
        "WARN",
        "ERROR",
        "FATAL",
    ]
    assert node.logger.lines[-1][1] == "said at critical"
