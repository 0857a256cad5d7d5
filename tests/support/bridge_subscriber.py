"""A subscriber in a separate process, which prints one JSON line per message received over DDS.

It does not use the bridge's encoder: types come from cyclonedds, and rosbags decodes messages.
"""

import argparse
import json
import sys
import time
import zlib
from dataclasses import dataclass

import numpy as np
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from rosbags.typesys import Stores, get_typestore

CONFIG = """<CycloneDDS><Domain id="any"><General><Interfaces>
<NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast>
</General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32
</MaxAutoParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery>
<Internal><SocketReceiveBufferSize max="4MB"/></Internal></Domain></CycloneDDS>"""
CLOUD = "sensor_msgs/msg/PointCloud2"


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@final
@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@final
@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Raw:
    """The received bytes; cyclonedds would need 50 ms to convert them to a list."""

    data: bytes
    sample_info: object = None


@final
@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


def reliable(depth: int) -> Qos:
    return Qos(
        Policy.Reliability.Reliable(100_000_000),
        Policy.Durability.TransientLocal,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def describe(raw: bytes, received: int, store: object) -> dict[str, object]:
    cloud = store.deserialize_cdr(raw, CLOUD)
    stamp = cloud.header.stamp
    return {
        "stamp": stamp.sec * 10**9 + stamp.nanosec,
        "width": cloud.width,
        "fields": [field.name for field in cloud.fields],
        "crc": zlib.crc32(np.ascontiguousarray(cloud.data)),
        "received": received,
    }


def say(line: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--domain", type=int, required=True)
    parser.add_argument("--count", type=int, default=10**9, help="leave after so many messages")
    parser.add_argument("--quiet", type=float, default=60, help="leave after so many idle seconds")
    parser.add_argument("--first", type=float, default=300, help="wait so long for the first")
    parser.add_argument("--say", default="", help="AFTER:COMMAND[,...] on /phy124/command")
    parser.add_argument("--config", default=CONFIG, help="Cyclone DDS settings, as XML")
    args = parser.parse_args()
    store = get_typestore(Stores.ROS2_JAZZY)
    domain = Domain(args.domain, args.config)
    participant = DomainParticipant(args.domain)
    PointCloud2.deserialize = classmethod(lambda cls, data, **_: Raw(data))
    topic = Topic(participant, "rt/phy124/points", PointCloud2)
    reader = DataReader(participant, topic, qos=reliable(100))
    speaker = DataWriter(
        participant, Topic(participant, "rt/phy124/command", String), qos=reliable(5)
    )
    waitset = WaitSet(participant)
    mask = SampleState.NotRead | ViewState.Any | InstanceState.Any
    waitset.attach(ReadCondition(reader, mask))
    orders = [order.split(":") for order in args.say.split(",") if order]
    say({"ready": True})
    count, last, is_matched = 0, time.monotonic() + args.first - args.quiet, False
    while count < args.count and (orders or time.monotonic() - last < args.quiet):
        if not is_matched and reader.get_matched_publications():
            is_matched = True
            say({"matched": True})
        waitset.wait(50_000_000)
        samples = [sample for sample in reader.take(100) if isinstance(sample, Raw)]
        received = time.time_ns()
        for sample in samples:
            count, last = count + 1, time.monotonic()
            say(describe(sample.data, received, store))
        while orders and count >= int(orders[0][0]):
            speaker.write(String(orders.pop(0)[1]))
            say({"said": True, "at": count})
    del domain


if __name__ == "__main__":
    main()
