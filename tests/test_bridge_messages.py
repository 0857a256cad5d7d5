"""Definitions and hashes against rosbags, which has those of ROS 2 Jazzy."""

import hashlib
import re

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bridge.messages import DEFINITIONS, definition, type_hash

JAZZY = get_typestore(Stores.ROS2_JAZZY)
ELSEWHERE = (
    "foxglove_msgs/",
    "point_cloud_interfaces/",
    "simulation_interfaces/",
    "splat_interfaces/",
)
"""Packages that are not among those of ROS 2 itself."""
OWN = [name for name in DEFINITIONS if not name.startswith(ELSEWHERE)]
RECORDED = [name for name in OWN if not name.startswith("rmw_dds_common/")]


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


@pytest.mark.parametrize("name", DEFINITIONS)
def test_hash_follows_from_the_definition(ours, name):
    assert ours.hash_rihs01(name) == type_hash(name)


def test_definitions_of_other_packages_are_unchanged():
    hashes = "".join(type_hash(name) for name in sorted(DEFINITIONS) if name.startswith(ELSEWHERE))
    assert hashlib.sha256(hashes.encode()).hexdigest()[:16] == "818aae481aa02795"


@pytest.mark.parametrize("distro", ["JAZZY", "KILTED", "LYRICAL"])
def test_hashes_are_those_of_ros(distro):
    store = get_typestore(Stores[f"ROS2_{distro}"])
    assert {name: store.hash_rihs01(name) for name in RECORDED} == {
        name: type_hash(name) for name in RECORDED
    }
