"""Receivers of the DDS sink: ROS 2's environment variables, and default peers in a private
network."""

import json
import os
import sys
import xml.etree.ElementTree as ET

import pytest

from bridge.discovery import Discovery, tuned_cyclone
from phy124.errors import InputError
from support import private_network
from support.processes import run_program

VARIABLES = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DOMAIN_ID",
)


@pytest.fixture(autouse=True)
def no_variables(monkeypatch):
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


def discovery(monkeypatch, *, network=False, **variables):
    for name, value in variables.items():
        monkeypatch.setenv(f"ROS_{name}", value)
    return Discovery.from_environment(network=network)


def settings(result):
    """Paths in the first configuration -> texts, and the peers."""
    root = ET.fromstring(result.configurations()[0])
    texts = {node.tag: node.text for node in root.iter() if node.text}
    return texts, [node.get("address") for node in root.iter("Peer")]


def interfaces(result):
    root = ET.fromstring(result.configurations()[0])
    return [node.get("address") or "autodetermine" for node in root.iter("NetworkInterface")]


def test_subnet_is_the_default_and_stays_on_this_machine(monkeypatch):
    result = discovery(monkeypatch)
    texts, peers = settings(result)
    assert (texts["AllowMulticast"], texts["MulticastTimeToLive"]) == ("spdp", "0")
    assert (texts["ParticipantIndex"], texts["MaxAutoParticipantIndex"]) == ("auto", "32")
    assert peers == ["localhost"]
    assert interfaces(result) == ["127.0.0.1", "autodetermine"]
    assert result.audience() == (
        "Discovery range SUBNET, domain 0: visible to nodes on this machine; "
        "run there `export ROS_DOMAIN_ID=0 ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET`."
    )


def test_network_is_what_a_node_does_by_itself(monkeypatch):
    result = discovery(monkeypatch, network=True, STATIC_PEERS="10.0.0.5;robot<1>", DOMAIN_ID="9")
    texts, peers = settings(result)
    assert "AllowMulticast" not in texts
    assert "MulticastTimeToLive" not in texts
    assert (peers, interfaces(result)) == (["10.0.0.5", "robot<1>"], [])
    assert "this machine and network and 10.0.0.5" in result.audience()
    assert "ROS_DOMAIN_ID=9" in result.export()


def test_localhost_sends_nothing_by_multicast(monkeypatch):
    result = discovery(monkeypatch, AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", STATIC_PEERS=" a ; b;")
    texts, peers = settings(result)
    assert texts["AllowMulticast"] == "false"
    assert peers == ["localhost", "a", "b"]


def test_localhost_only_prevails_and_warns(monkeypatch, caplog):
    options = {"LOCALHOST_ONLY": "1", "AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "STATIC_PEERS": "a"}
    result = discovery(monkeypatch, **options)
    assert (result.range, result.peers) == ("LOCALHOST", ())
    assert "use ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in caplog.text
    assert discovery(monkeypatch, LOCALHOST_ONLY="0").range == "SUBNET"


@pytest.mark.parametrize("reach", ["OFF", "SYSTEM_DEFAULT"])
def test_ranges_without_peers(monkeypatch, caplog, reach):
    result = discovery(monkeypatch, AUTOMATIC_DISCOVERY_RANGE=reach, STATIC_PEERS="a")
    texts, peers = settings(result)
    assert peers == []
    assert ("Tag" in texts) is (reach == "OFF")
    ignored = "ROS_STATIC_PEERS is ignored, because ROS_AUTOMATIC_DISCOVERY_RANGE is"
    assert f"{ignored} {reach}." in caplog.text
    assert ("visible to no other process." in result.audience()) is (reach == "OFF")


def test_an_unknown_range_is_localhost_as_in_ros(monkeypatch, caplog):
    assert discovery(monkeypatch, AUTOMATIC_DISCOVERY_RANGE="subnet").range == "LOCALHOST"
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE=subnet is unknown" in caplog.text


@pytest.mark.parametrize(
    "variables", [{"AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"LOCALHOST_ONLY": "1"}]
)
def test_network_against_the_environment_is_refused(monkeypatch, variables):
    with pytest.raises(InputError, match="restricts discovery to this machine"):
        discovery(monkeypatch, network=True, **variables)


@pytest.mark.parametrize("reach", ["SUBNET", "LOCALHOST"])
def test_every_configuration_fits_every_receive_buffer(monkeypatch, reach):
    for text in discovery(monkeypatch, AUTOMATIC_DISCOVERY_RANGE=reach).configurations():
        assert ET.fromstring(text).find(".//SocketReceiveBufferSize").get("max") == "4MB"


@pytest.fixture(scope="module")
def network():
    pytest.importorskip("cyclonedds")
    if not private_network.is_possible():
        pytest.skip("no private network can be made here (unshare --net)")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reach", "heard"),
    [("SUBNET", ["SUBNET", "SYSTEM_DEFAULT", "LOCALHOST"]), ("LOCALHOST", ["LOCALHOST"])],
)
def test_stock_peers_hear_us(network, reach, heard):
    """Without a word of configuration on their side."""
    script = [sys.executable, private_network.__file__, reach, *heard]
    run = run_program(private_network.inside(script), check=True, timeout=120)
    results = {line["peer"]: line["frames"] for line in map(json.loads, run.stdout.splitlines())}
    assert results == dict.fromkeys(heard, 4)


def test_type_objects_of_fast_dds_are_ignored_only_without_ros(monkeypatch):
    """Cyclone DDS 0.10, which rclpy of Jazzy loads, does not start with a setting it lacks."""
    for reach in ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"):
        for text in discovery(monkeypatch, AUTOMATIC_DISCOVERY_RANGE=reach).configurations():
            assert ET.fromstring(text).find(".//IgnoreTypeInformation").text == "1.15"
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    with tuned_cyclone():
        assert "IgnoreTypeInformation" not in os.environ["CYCLONEDDS_URI"]
