"""The CDR encoder, byte for byte against rosbags and against cyclonedds."""

import struct

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bridge.cdr import encode, time
from bridge.messages import DEFINITIONS, fields

TYPES = list(DEFINITIONS)
CASES = 64
"""Number of messages of each type."""
RANGES = {
    "bool": (0, 1),
    "byte": (0, 2**7 - 1),  # cyclonedds takes it for signed
    "uint8": (0, 2**8 - 1),
    "uint16": (0, 2**16 - 1),
    "uint64": (0, 2**63 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
}
ARRAYS = ("uint16", "float32", "float64")
"""Numbers of which rosbags wants arrays."""
STORE = get_typestore(Stores.EMPTY)
for _name, _text in DEFINITIONS.items():
    _types = get_types_from_msg(_text, _name)
    # rosbags takes the halves of a service for messages in a folder more.
    STORE.register({_key.replace("/srv/msg/", "/srv/"): _kind for _key, _kind in _types.items()})


def random_value(rng, base, size):
    """A value of a type; `size` 0 is the emptiest one, 1 the largest, between them random."""
    if base in RANGES:
        low, high = RANGES[base]
        value = {0: 0, 1: high}.get(size, int(rng.integers(low, high, endpoint=True)))
        return bool(value) if base == "bool" else value
    if base == "string":
        letters = list("abcäß漢/_ ")
        return "".join(rng.choice(letters, {0: 0, 1: 85}.get(size, int(rng.integers(12)))))
    if base in ("float32", "float64"):
        kind = np.float32 if base == "float32" else np.float64
        extreme = {0: 0.0, 1: np.finfo(kind).max}
        return float(kind(extreme.get(size, rng.normal() * 10.0 ** rng.integers(-30, 30))))
    return {member.name: random_member(rng, member, size) for member in fields(base)}


def random_member(rng, member, size):
    if member.length is None:
        return random_value(rng, member.base, size)
    count = member.length or {0: 0, 1: 9}.get(size, int(rng.integers(5)))
    if member.base == "uint8":
        length = count if member.length else 17 * count
        return np.zeros(length, np.uint8) if size == 0 else rng.integers(0, 256, length, np.uint8)
    values = [random_value(rng, member.base, size) for _ in range(count)]
    return np.array(values, member.base) if member.base in ARRAYS else values


def rosbags_bytes(name, value):
    return bytes(STORE.serialize_cdr(rosbags_message(name, value), name))


def rosbags_message(name, value):
    def convert(member):
        inner = value[member.name]
        if member.base not in DEFINITIONS:
            return inner
        if member.length is None:
            return rosbags_message(member.base, inner)
        return [rosbags_message(member.base, element) for element in inner]

    return STORE.types[name](**{member.name: convert(member) for member in fields(name)})


def cyclone_bytes(name, value):
    return cyclone_message(name, value).serialize(use_version_2=False)


def cyclone_message(name, value):
    pytest.importorskip("cyclonedds")
    from bridge.idl import idl_type

    def convert(member):
        inner = value[member.name]
        if isinstance(inner, np.ndarray):
            return inner.tolist()
        if member.base not in DEFINITIONS:
            return inner
        if member.length is None:
            return cyclone_message(member.base, inner)
        return [cyclone_message(member.base, element) for element in inner]

    return idl_type(name)(**{member.name: convert(member) for member in fields(name)})


@pytest.mark.parametrize("name", TYPES)
def test_fuzz_against_rosbags_and_cyclonedds(name):
    rng = np.random.default_rng(len(name))
    for case in range(CASES):
        value = random_value(rng, name, {0: 0, 1: 1}.get(case, 0.5))
        ours = encode(name, value)
        assert ours == rosbags_bytes(name, value), value
        assert ours == cyclone_bytes(name, value), value


def test_largest_cloud_against_both():
    rng = np.random.default_rng(0)
    value = random_value(rng, "sensor_msgs/msg/PointCloud2", 1)
    value |= {"data": rng.integers(0, 256, 65536 * 60, dtype=np.uint8), "width": 65536}
    ours = encode("sensor_msgs/msg/PointCloud2", value)
    assert ours == rosbags_bytes("sensor_msgs/msg/PointCloud2", value)
    assert ours == cyclone_bytes("sensor_msgs/msg/PointCloud2", value)


def test_absent_members_are_zero():
    rng = np.random.default_rng(0)
    for name in TYPES:
        assert encode(name, {}) == rosbags_bytes(name, random_value(rng, name, 0))


@pytest.mark.parametrize("wrap", [bytes, memoryview, np.array, list])
def test_bulk_data_may_be_any_buffer(wrap):
    data = bytes(range(7))
    value = random_value(np.random.default_rng(0), "sensor_msgs/msg/PointCloud2", 0)
    expected = rosbags_bytes(
        "sensor_msgs/msg/PointCloud2", value | {"data": np.arange(7, dtype=np.uint8)}
    )
    inputs = list(data) if wrap in (np.array, list) else data
    assert encode("sensor_msgs/msg/PointCloud2", {"data": wrap(inputs)}) == expected


def test_points_may_be_plain_sequences():
    named = {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 4, "y": 5, "z": 6, "w": 7}}
    assert encode("geometry_msgs/msg/Pose", range(1, 8)) == encode("geometry_msgs/msg/Pose", named)


def test_wrong_content_is_refused():
    with pytest.raises(KeyError, match="has no \\['stmap'\\]"):
        encode("std_msgs/msg/Header", {"stmap": {}})
    with pytest.raises(struct.error):
        encode("std_msgs/msg/Header", {"stamp": {"sec": 2**31}})
    with pytest.raises(ValueError, match="data has 3 values, wanted 16"):
        encode("rmw_dds_common/msg/Gid", {"data": bytes(3)})
    with pytest.raises(ValueError, match="must be a mapping of member names"):
        encode("builtin_interfaces/msg/Time", (1, 2))


def test_time_splits_nanoseconds():
    assert time(1_700_000_000_123_456_789) == {"sec": 1_700_000_000, "nanosec": 123_456_789}
