"""Which outlet `auto` picks, and what is said when there is none."""

import re
import sys

import pytest

from bridge.backends import choose, missing, open_sink
from bridge.options import Options
from bridge.sinks.dds import DdsSink
from bridge.sinks.foxglove import FoxgloveSink
from phy124.errors import InputError
from phy124.runtime.installation import install_command


def hide(monkeypatch, *modules):
    """Make imports of these fail."""
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)


def test_auto_prefers_ros(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", sys)
    assert choose("auto") == "rclpy"


def test_auto_falls_back_to_dds(monkeypatch):
    pytest.importorskip("cyclonedds")
    hide(monkeypatch, "rclpy")
    assert choose("auto") == "dds"


def test_auto_says_what_remains_and_how_to_get_more(monkeypatch):
    hide(monkeypatch, "rclpy", "cyclonedds.domain")
    with pytest.raises(InputError) as caught:
        choose("auto")
    sentence = str(caught.value)
    assert "only MCAP files are possible" in sentence
    for way in ("python -m bridge record", "source ROS 2", install_command("dds"), "foxglove"):
        assert way in sentence


@pytest.mark.parametrize(
    ("outlet", "module", "remedy"),
    [
        ("rclpy", "rclpy", "source /opt/ros/jazzy/setup.bash"),
        ("dds", "cyclonedds.domain", re.escape(install_command("dds"))),
        ("foxglove", "foxglove", re.escape(install_command("foxglove"))),
        ("mcap", "mcap.writer", re.escape(install_command("bridge"))),
    ],
)
def test_each_missing_package_names_its_remedy(monkeypatch, outlet, module, remedy):
    hide(monkeypatch, module)
    error = missing(outlet)
    assert error is not None
    with pytest.raises(InputError, match=remedy):
        raise error


def test_a_named_backend_is_not_replaced(monkeypatch):
    hide(monkeypatch, "rclpy")
    assert choose("rclpy") == "rclpy"
    with pytest.raises(InputError, match="rclpy cannot be imported"):
        open_sink("rclpy", Options())


def test_sinks_by_name():
    assert isinstance(open_sink("foxglove", Options(), duration=1.0), FoxgloveSink)
    pytest.importorskip("cyclonedds")
    assert isinstance(open_sink("dds", Options()), DdsSink)


def test_clock_needs_rclpy():
    with pytest.raises(InputError, match=r"does not publish /clock. Use rclpy"):
        open_sink("dds", Options(), clock=True)
