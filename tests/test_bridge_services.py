"""Services: what each request asks of the player, and what is answered."""

from types import SimpleNamespace

import pytest

from bridge.services import offer_playback


@pytest.fixture
def offered(ros):
    """Service -> a function that sends a request and returns what was asked and the answer."""
    from rclpy.node import Node

    node, asked = Node("player", namespace="phy124"), []
    refusal = {"play": "there is nothing to play"}

    def ask(command):
        asked.append(command)
        return refusal.get(command)

    offer_playback(node, ask, lambda: SimpleNamespace(paused=True))

    def request(name, **content):
        asked.clear()
        answer = node.services[f"~/{name}"][1](SimpleNamespace(**content), SimpleNamespace())
        return list(asked), vars(answer)

    return request


def test_triggers_ask_and_pass_on_the_reason_of_a_refusal(offered):
    assert offered("pause") == (["pause"], {"message": "", "success": True})
    options = {"message": "there is nothing to play", "success": False}
    assert offered("play") == (["play"], options)


def test_seek_takes_ros_time_and_rate_is_the_speed(offered):
    time = SimpleNamespace(sec=2, nanosec=250_000_000)
    assert offered("seek", time=time) == (["seek 2.25"], {"success": True})
    assert offered("set_rate", rate=0.5) == (["speed 0.5"], {"success": True})


def test_the_others_of_rosbag2(offered):
    assert offered("toggle_paused") == (["toggle"], {})
    assert offered("is_paused") == ([], {"paused": True})
    assert offered("play_next") == (["next"], {"success": True})
