"""DdsSink: ROS 2 topics without ROS 2, through the pip package cyclonedds.

What makes real ROS 2 nodes accept it: mangled topic and type names, XCDR version 1, the type hash
in the endpoints' user data, and a sample on `ros_discovery_info` that names the node (Jazzy's
rmw_dds_common). Services are not offered: their headers differ from one middleware to the next.
"""

from __future__ import annotations

import os
import time
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.installation import install_command

from ..cdr import encode
from ..encoder import FrameEncoder
from ..messages import HASHES
from ..options import Options
from ..player import Player
from ..topics import COMMAND, POINTS, Message, Topic
from . import Obey

NAMESPACE, NODE = "/phy124", "player"
LAST_DOMAIN = 232
"""Largest DDS domain whose ports fit."""
DISCOVERY = Topic("ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo", depth=1)
LOOPBACK = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers>"
    '<Peer address="127.0.0.1"/></Peers></Discovery>'
)
# `max`, never `min`: hosts with a small rmem_max would refuse to start.
BUFFERS = '<Internal><SocketReceiveBufferSize max="4MB"/></Internal>'
FAREWELL = 2.0
"""Seconds a leaving sink waits for subscribers to acknowledge the last frames."""


class DdsSink:
    """Publishes frames over DDS; on this machine only, unless `network` is set."""

    monotonic = True

    def __init__(self, options: Options | None = None, *, network: bool = False) -> None:
        """Ready to enter. Raises InputError if cyclonedds is missing.

        Args:
            options: How frames become messages.
            network: Publish on all interfaces. A CYCLONEDDS_URI overrides both choices.
        """
        require_cyclonedds()
        self._encoder = FrameEncoder((options or Options()).live())
        self._network = network

    def __enter__(self) -> DdsSink:
        """Join the domain (ROS_DOMAIN_ID) and offer the topics."""
        from cyclonedds.core import DDSException

        domain = domain_id()
        try:
            self._open(domain)
        except DDSException as error:
            limit = f"DDS cannot start in domain {domain} ({error.msg or error})."
            remedy = "Check CYCLONEDDS_URI and the network interfaces, or unset CYCLONEDDS_URI."
            raise InputError("dds", domain, limit, remedy) from error
        for message in self._encoder.static():
            self._send(message)
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for subscribers to get the last frames, then leave the domain."""
        deadline = time.monotonic() + FAREWELL
        for writer in self._writers.values():
            left = max(deadline - time.monotonic(), 0.0)
            writer.wait_for_acks(int(left * 1e9))
        # DDS entities end with their last reference, children before parents.
        self._writers.clear()
        del self._waitset, self._reader, self._participant, self._domain

    def write(self, frame: Frame) -> None:
        """Publish one frame."""
        for message in self._encoder.encode(frame):
            self._send(message)

    def listen(self, seconds: float, obey: Obey) -> None:
        """Obey messages on /phy124/command."""
        if seconds > 0:
            self._waitset.wait(int(seconds * 1e9))
        for sample in self._reader.take(16):
            # A sample without data says that a publisher has left.
            if hasattr(sample, "data"):
                obey(sample.data)

    def show(self, player: Player) -> None:
        """Nothing: there is no ROS topic for it."""
        del player

    def subscribers(self) -> int:
        """How many readers the points have now."""
        return len(self._writers[POINTS.name].get_matched_subscriptions())

    def _open(self, domain: int) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.qos import Policy, Qos

        own = "CYCLONEDDS_URI" in os.environ
        self._domain = None if own else Domain(domain, _configuration(self._network))
        self._participant = DomainParticipant(domain, Qos(Policy.Userdata(b"enclave=/;")))
        self._writers = {topic.name: self._writer(topic) for topic in self._encoder.topics}
        self._reader = self._command_reader()
        self._waitset = WaitSet(self._participant)
        unread = SampleState.NotRead | ViewState.Any | InstanceState.Any
        self._waitset.attach(ReadCondition(self._reader, unread))
        self._introduce()

    def _writer(self, topic: Topic) -> Any:
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic as DdsTopic

        from ..idl import encoded_type

        name = topic.name if topic is DISCOVERY else f"rt{topic.name}"
        dds_topic = DdsTopic(self._participant, name, encoded_type(topic.type))
        return DataWriter(self._participant, dds_topic, qos=quality(topic))

    def _command_reader(self) -> Any:
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic as DdsTopic

        from ..idl import idl_type

        topic = DdsTopic(self._participant, f"rt{COMMAND.name}", idl_type(COMMAND.type))
        return DataReader(self._participant, topic, qos=quality(COMMAND))

    def _introduce(self) -> None:
        """Tell ROS 2 the node's name; else it shows as _CREATED_BY_BARE_DDS_APP_."""
        gids = [_gid(writer) for writer in self._writers.values()]
        node = {
            "node_namespace": NAMESPACE,
            "node_name": NODE,
            "reader_gid_seq": [_gid(self._reader)],
            "writer_gid_seq": gids,
        }
        info = {"gid": _gid(self._participant), "node_entities_info_seq": [node]}
        self._writers[DISCOVERY.name] = self._writer(DISCOVERY)
        self._send(Message(DISCOVERY, 0, encode(DISCOVERY.type, info)))

    def _send(self, message: Message) -> None:
        from ..idl import sample

        self._writers[message.topic.name].write(sample(message.topic.type, message.data))


def quality(topic: Topic) -> Any:
    """The DDS quality of service of a topic, type hash included."""
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.util import duration

    last = Policy.History.KeepLast(topic.depth)
    kept = Policy.DurabilityService(0, last, -1, -1, -1)
    reliable = Policy.Reliability.Reliable(duration(milliseconds=100))
    transient = [Policy.Durability.TransientLocal, kept]
    return Qos(
        reliable if topic.reliable else Policy.Reliability.BestEffort,
        *(transient if topic.transient_local else [Policy.Durability.Volatile]),
        last,
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"typehash={HASHES[topic.type]};".encode()),
    )


def domain_id() -> int:
    """The domain of ROS_DOMAIN_ID, else 0. Raises InputError if it is no domain."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        limit = f"A domain is a whole number from 0 to {LAST_DOMAIN}."
        raise InputError("ROS_DOMAIN_ID", text, limit, "Set it to one, or unset it.")
    return int(text)


def require_cyclonedds() -> None:
    """Raise InputError if cyclonedds cannot be imported."""
    try:
        import cyclonedds.domain  # noqa: F401
    except ImportError as error:
        limit = "Publishing without ROS 2 needs the package cyclonedds, which is not installed."
        remedy = f"Run `{install_command('dds')}`; it exists for x86-64 Linux, Windows and macOS."
        raise InputError("backend", "dds", limit, remedy) from error


def _configuration(network: bool) -> str:
    inner = BUFFERS if network else LOOPBACK + BUFFERS
    return f'<CycloneDDS><Domain id="any">{inner}</Domain></CycloneDDS>'


def _gid(entity: Any) -> dict[str, bytes]:
    return {"data": entity.guid.bytes}
