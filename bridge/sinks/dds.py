"""DdsSink: ROS 2 topics without ROS 2, through the pip package cyclonedds.

To be compatible with ROS 2 nodes, this sink uses mangled topic and type names and XCDR version 1.
The type hash is in the user data of the endpoints, and a sample on `ros_discovery_info` names the
node (Jazzy's rmw_dds_common). `DdsServices` offers the services.
"""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.runtime.installation import needs_extra

from ..cdr import ENCAPSULATION, encode
from ..delivery import Delivery, wait_for_topics
from ..discovery import URI, Discovery
from ..encoder import FrameEncoder
from ..messages import type_hash
from ..options import Options
from ..reports import Audience, Reports
from ..sink import Obey, Playback
from ..topics import COMMAND, NAMESPACE, Controls, Hear, Message, Service, Topic, full_name

DISCOVERY = Topic("ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo", depth=1)
MANY = 1000
"""Largest number of participants whose nodes are examined."""
log = logging.getLogger(__name__)
DEPTH = 10
AT_ONCE = 16
HEADER = struct.Struct("<Qq")
"""Header of a service request: client and number; 16 bytes, so that the members are aligned."""


class DdsSink:
    """Publishes frames over DDS, by default only to this machine."""

    monotonic = True

    def __init__(
        self,
        options: Options | None = None,
        *,
        network: bool = False,
        controls: Controls | None = None,
    ) -> None:
        """Prepare the sink; it joins the DDS domain when its context is entered.

        Args:
            options: Options that define how frames become messages.
            network: Whether to reach also other machines. CYCLONEDDS_URI overrides this argument
                and ROS's variables.
            controls: Inputs, topics and services in addition to frames; by default, those of a
                player.

        Raises:
            InputError: cyclonedds is missing, or a ROS variable has an invalid value.
        """
        require_cyclonedds()
        self._encoder = FrameEncoder((options or Options()).live())
        self._discovery = Discovery.from_environment(network=network)
        self._controls = controls or Controls()
        self._node = self._controls.node
        self._reports = Reports(self._encoder, self.send, self._audience, self._controls)
        self._delivery = Delivery(
            partial(self._acknowledged_on, self._encoder.main.name),
            self._encoder.main.depth,
            self._reports.send_due,
            patient=self._controls.patient,
        )

    def __enter__(self) -> DdsSink:
        """Join the domain (ROS_DOMAIN_ID) and offer the topics."""
        from cyclonedds.core import DDSException

        domain = self._discovery.domain
        try:
            self._open(domain)
        except DDSException as error:
            limit = f"DDS cannot start in domain {domain} ({error.msg or error})."
            remedy = "Check CYCLONEDDS_URI and the network interfaces, or unset CYCLONEDDS_URI."
            raise InputError("dds", domain, limit, remedy) from error
        for message in self._encoder.static():
            self.send(message)
        return self

    def __exit__(self, *_: object) -> None:
        """Wait until subscribers have received the last frames, then leave the domain."""
        try:
            self._delivery.farewell()
            # In a short run, these messages may be acknowledged after the frames.
            wait_for_topics(self._acknowledged_on, self._writers)
        finally:
            # A DDS entity is deleted with its last reference; children must be deleted before
            # parents.
            self._writers.clear()
            self._heard.clear()
            del self._services, self._waitset, self._nodes, self._participant, self._domain

    def send(self, message: Message) -> None:
        """Publish a message."""
        from ..idl import sample

        self._writers[message.topic.name].write(sample(message.topic.type, message.data))

    @property
    def start(self) -> float:
        """Time at which the clip starts [s since 1970]."""
        return self._encoder.start

    def audience(self) -> str:
        """Describe in a line who receives the frames, and which command the receivers need."""
        if URI in os.environ:
            return (
                f"Domain {self._discovery.domain}; {URI} determines "
                "which machines receive the topics."
            )
        return self._discovery.audience()

    def write(self, frame: Frame) -> None:
        """Publish a frame."""
        messages = self._encoder.encode(frame)
        self._delivery.before_frame(len(messages[0].data))
        for message in messages:
            self.send(message)

    def listen(self, seconds: float, obey: Obey) -> bool:
        """Wait for messages and requests, and carry them out; return whether more may wait."""
        self._obey = obey
        self._reports.send_due()
        wait = min(seconds, self._reports.wait())
        if wait > 0:
            self._waitset.wait(int(wait * 1e9))
        more = False
        for reader, hear in self._heard:
            samples = reader.take(AT_ONCE)
            more = more or len(samples) == AT_ONCE
            for sample in _sound(samples, reader, self._controls.refused):
                hear(sample)
        self._services.serve(self._controls.refused)
        return more

    def show(self, playback: Playback) -> None:
        """Publish the status of playback."""
        self._reports.change(playback)

    def subscribers(self) -> int:
        """Return the number of subscribers that currently read the points."""
        return len(self._writers[self._encoder.main.name].get_matched_subscriptions())

    def _acknowledged_on(self, topic: str, seconds: float) -> bool:
        try:
            return self._writers[topic].wait_for_acks(int(seconds * 1e9))
        except AttributeError:
            # At a timeout, cyclonedds 11.0.1 raises a NameError instead of returning False.
            return False

    def _audience(self) -> Audience:
        return Audience(self.subscribers(), self._delivery.lost, self._namesakes())

    def _open(self, domain: int) -> None:
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.qos import Policy, Qos

        self._domain = None if URI in os.environ else _domain(domain, self._discovery)
        self._participant = DomainParticipant(domain, Qos(Policy.Userdata(b"enclave=/;")))
        topics = [*self._encoder.topics, *self._reports.topics, *self._controls.published]
        self._writers = {topic.name: self._writer(topic) for topic in dict.fromkeys(topics)}
        heard: dict[Topic, Hear] = {COMMAND: lambda message: self._obey(message.data)}
        heard |= self._controls.heard
        self._heard = [(self._reader(topic), hear) for topic, hear in heard.items()]
        # All nodes write to this topic. The topic has no key that distinguishes the nodes.
        self._nodes = self._reader(replace(DISCOVERY, depth=MANY))
        self._waitset = WaitSet(self._participant)
        unread = SampleState.NotRead | ViewState.Any | InstanceState.Any
        self._services = DdsServices(self._participant, self._controls.services, self._node)
        for reader in (*(reader for reader, _ in self._heard), *self._services.readers):
            self._waitset.attach(ReadCondition(reader, unread))
        self._others: dict[int, bool] = {}
        self._introduce()

    def _writer(self, topic: Topic) -> Any:
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic as DdsTopic

        from ..idl import encoded_type

        dds_topic = DdsTopic(self._participant, self._mangle(topic), encoded_type(topic.type))
        return DataWriter(self._participant, dds_topic, qos=quality(topic))

    def _reader(self, topic: Topic) -> Any:
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic as DdsTopic

        from ..idl import idl_type

        dds_topic = DdsTopic(self._participant, self._mangle(topic), idl_type(topic.type))
        return DataReader(self._participant, dds_topic, qos=quality(topic, ignore_own=True))

    def _mangle(self, topic: Topic) -> str:
        name = full_name(topic.name, self._node)
        return name if name == DISCOVERY.name else f"rt{name}"

    def _introduce(self) -> None:
        """Announce the node's name to ROS 2, which otherwise shows _CREATED_BY_BARE_DDS_APP_."""
        readers = [*(reader for reader, _ in self._heard), *self._services.readers]
        node = {
            "node_namespace": f"/{NAMESPACE}",
            "node_name": self._node,
            "reader_gid_seq": [_gid(reader) for reader in readers],
            "writer_gid_seq": [
                _gid(writer) for writer in (*self._writers.values(), *self._services.writers)
            ],
        }
        info = {"gid": _gid(self._participant), "node_entities_info_seq": [node]}
        self._writers[DISCOVERY.name] = self._writer(DISCOVERY)
        self.send(Message(DISCOVERY, 0, encode(DISCOVERY.type, info)))

    def _namesakes(self) -> int:
        identity = self._participant.guid.bytes
        for sample in _sound(self._nodes.take(MANY), self._nodes, log.debug):
            if bytes(sample.gid.data) != identity:
                names = {(n.node_namespace, n.node_name) for n in sample.node_entities_info_seq}
                writer = sample.sample_info.publication_handle
                self._others[writer] = (f"/{NAMESPACE}", self._node) in names
        # cyclonedds returns some handles as signed and others as unsigned numbers.
        here = {handle % 2**64 for handle in self._nodes.get_matched_publications()}
        return sum(named for writer, named in self._others.items() if writer in here)


def require_cyclonedds() -> None:
    """Check that cyclonedds can be imported.

    Raises:
        InputError: cyclonedds is not installed.
    """
    limit = "Publishing without ROS 2 needs the package cyclonedds, which is not installed."
    more = "; it exists for x86-64 Linux, Windows and macOS"
    with needs_extra("dds", "backend", "dds", limit, more):
        import cyclonedds.domain  # noqa: F401


def _domain(domain: int, discovery: Discovery) -> Any:
    from cyclonedds.core import DDSException
    from cyclonedds.domain import Domain

    *others, last = discovery.configurations()
    for configuration in others:
        try:
            return Domain(domain, configuration)
        except DDSException:
            log.debug("DDS cannot start with %s", configuration)
    return Domain(domain, last)


def _gid(entity: Any) -> dict[str, bytes]:
    return {"data": entity.guid.bytes}


class _Offered(NamedTuple):
    service: Service
    reader: Any
    writer: Any


class DdsServices:
    """The services that the node of a DDS sink offers to ROS 2."""

    def __init__(self, participant: Any, services: Sequence[Service], node: str) -> None:
        self._offered = [_offer(participant, service, node) for service in services]

    @property
    def readers(self) -> list[Any]:
        """Readers of the requests."""
        return [offered.reader for offered in self._offered]

    @property
    def writers(self) -> list[Any]:
        """Writers of the replies."""
        return [offered.writer for offered in self._offered]

    def serve(self, refused: Callable[[str], object]) -> None:
        """Answer the service requests that are waiting; `refused` receives error messages."""
        for offered in self._offered:
            for request in _sound(offered.reader.take(AT_ONCE), offered.reader, refused):
                _answer(offered, request)


def _sound(samples: Sequence[Any], reader: Any, refused: Callable[[str], object]) -> Iterator[Any]:
    from ..idl import Undecoded

    for sample in samples:
        if isinstance(sample, Undecoded):
            refused(f"{reader.topic.name}: a message cannot be decoded ({sample.error}).")
        elif sample.sample_info.valid_data:
            # An invalid sample means that a publisher has disconnected.
            yield sample


def _answer(offered: _Offered, request: Any) -> None:
    from ..idl import sample

    name = f"{offered.service.type}_Response"
    body = encode(name, offered.service.serve(request))[len(ENCAPSULATION) :]
    header = HEADER.pack(request.client, request.number)
    offered.writer.write(sample(name, ENCAPSULATION + header + body))


def _offer(participant: Any, service: Service, node: str) -> _Offered:
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic as DdsTopic

    from ..idl import encoded_type, service_type

    name = full_name(service.name, node)
    asked, answered = f"{service.type}_Request", f"{service.type}_Response"
    # A waiting client uses this identity to match the reader and the writer.
    identity = ".".join(f"{byte:x}" for byte in participant.guid.bytes[:12])
    topics = {kind: Topic(name, kind, DEPTH, transient_local=False) for kind in (asked, answered)}
    qos = {kind: quality(topic, also=f"serviceid={identity};") for kind, topic in topics.items()}
    requests = DdsTopic(participant, f"rq{name}Request", service_type(asked))
    replies = DdsTopic(participant, f"rr{name}Reply", encoded_type(answered))
    return _Offered(
        service,
        DataReader(participant, requests, qos=qos[asked]),
        DataWriter(participant, replies, qos=qos[answered]),
    )


def quality(topic: Topic, *, also: str = "", ignore_own: bool = False) -> Any:
    """Return the DDS quality of service of a topic, including the type hash.

    Args:
        topic: The topic.
        also: Additional user data.
        ignore_own: Whether to ignore messages from this program.
    """
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
        Policy.Userdata(f"typehash={type_hash(topic.type)};{also}".encode()),
        *([Policy.IgnoreLocal.Participant] if ignore_own else []),
    )
