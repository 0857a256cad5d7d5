"""Definitions and hashes against rosbags, which carries those of ROS 2 Jazzy."""

import re

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bridge.messages import DEFINITIONS, HASHES, definition

JAZZY = get_typestore(Stores.ROS2_JAZZY)
DDS_ONLY = "rmw_dds_common/msg/ParticipantEntitiesInfo"
ELSEWHERE = (
    "foxglove_msgs/",
    "point_cloud_interfaces/",
    "simulation_interfaces/",
    "splat_interfaces/",
)
"""Packages that are not among those of ROS 2 itself."""
OWN = [name for name in HASHES if not name.startswith(ELSEWHERE)]
RECORDED = [name for name in OWN if name != DDS_ONLY]


@pytest.mark.parametrize("name", OWN)
def test_definition_is_that_of_jazzy(name):
    theirs = JAZZY.generate_msgdef(name, ros_version=2)[0]
    plain = [line for line in theirs.splitlines() if not re.match(r"\w+ \w+=", line)]
    # ROS calls a byte of a GID `char`, which its own IDL maps to uint8.
    assert definition(name) == "\n".join(plain).replace("char[", "uint8[") + "\n"


@pytest.fixture(scope="module")
def ours():
    """Every definition of ours in the type store of rosbags."""
    store = get_typestore(Stores.EMPTY)
    for inner, text in DEFINITIONS.items():
        types = get_types_from_msg(text, inner)
        # rosbags takes the halves of a service for messages in a folder more.
        store.register({key.replace("/srv/msg/", "/srv/"): kind for key, kind in types.items()})
    return store


@pytest.mark.parametrize("name", HASHES)
def test_hash_follows_from_the_definition(ours, name):
    assert ours.hash_rihs01(name) == HASHES[name]


@pytest.mark.parametrize("distro", ["JAZZY", "KILTED", "LYRICAL"])
def test_hashes_are_those_of_ros(distro):
    store = get_typestore(Stores[f"ROS2_{distro}"])
    assert {name: store.hash_rihs01(name) for name in RECORDED} == {
        name: HASHES[name] for name in RECORDED
    }
