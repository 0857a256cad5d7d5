"""The managed node under launch, from configure to shutdown; needs ROS 2."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import tempfile
import time
import unittest
from pathlib import Path

import pytest

pytest.importorskip("launch_testing", reason="launch_testing comes with ROS 2")

import launch
import launch_testing.actions
import launch_testing.asserts
import rclpy
from launch_ros.actions import Node
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from sensor_msgs.msg import PointCloud2

from test_recording import POINTS, save_clip

TIMEOUT = 20.0
"""Time after which an answer or a message is assumed to be missing [s]."""


@pytest.mark.launch_test
def generate_test_description():
    """Start the managed node; it plays a clip in a loop."""
    clip = save_clip(Path(tempfile.mkdtemp()))
    node = Node(
        package="phy124_bridge",
        executable="managed",
        name="player",
        namespace="phy124",
        parameters=[{"clip": str(clip), "loop": True}],
    )
    return launch.LaunchDescription([node, launch_testing.actions.ReadyToTest()])


class TestManagedNode(unittest.TestCase):
    def setUp(self):
        rclpy.init()
        self.node = rclpy.create_node("manager")
        self.clouds = []
        self.node.create_subscription(PointCloud2, "/phy124/points", self.clouds.append, 5)
        self.client = self.node.create_client(ChangeState, "/phy124/player/change_state")
        assert self.client.wait_for_service(timeout_sec=TIMEOUT)

    def tearDown(self):
        self.node.destroy_node()
        rclpy.shutdown()

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        answer = self.client.call_async(request)
        rclpy.spin_until_future_complete(self.node, answer, timeout_sec=TIMEOUT)
        assert answer.result() is not None and answer.result().success

    def test_activated_node_publishes_until_it_is_shut_down(self):
        self.change(Transition.TRANSITION_CONFIGURE)
        self.change(Transition.TRANSITION_ACTIVATE)
        until = time.monotonic() + TIMEOUT
        while not self.clouds and time.monotonic() < until:
            rclpy.spin_once(self.node, timeout_sec=0.1)
        assert self.clouds and self.clouds[0].width == POINTS
        self.change(Transition.TRANSITION_DEACTIVATE)
        self.change(Transition.TRANSITION_CLEANUP)
        self.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)


@launch_testing.post_shutdown_test()
class TestAfterShutdown(unittest.TestCase):
    def test_exit_status_is_zero(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info)
