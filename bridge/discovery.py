"""Translate ROS 2's environment variables for discovery into settings of Cyclone DDS.

ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_STATIC_PEERS and ROS_DOMAIN_ID have the same meaning as for a ROS
2 node ("improved dynamic discovery", ROS 2 Iron and later). In the range SUBNET, the publisher is
stricter than a node: it reaches other machines only if `network` is set. The older variable
ROS_LOCALHOST_ONLY is used with a warning, as in Jazzy and Kilted; Lyrical ignores it.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, get_args
from xml.sax.saxutils import quoteattr

from phy124.errors import InputError

Range = Literal["SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"]
RANGE, PEERS, LOCALHOST_ONLY, DOMAIN = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DOMAIN_ID",
)
URI = "CYCLONEDDS_URI"
"""Environment variable with the settings of Cyclone DDS: XML text, or the address of a file."""
LAST_DOMAIN = 232
"""Largest DDS domain number, which follows from the range of port numbers."""
# Only `max` is set, because with `min` the publisher would not start on hosts with a small
# rmem_max. Heartbeats request acknowledgements; their default interval of 100 ms is too long for 30
# Hz.
BUFFERS = (
    '<Internal><SocketReceiveBufferSize max="4MB"/>'
    "<HeartbeatInterval>10 ms</HeartbeatInterval></Internal>"
)
# Cyclone DDS 11 rejects type objects of Fast DDS (vendor 1.15) and then does not connect. Without
# type objects, types are matched by name. Cyclone DDS 0.10, which Jazzy uses, does not have this
# setting.
FAST_DDS = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
LOOPBACK = '<NetworkInterface address="127.0.0.1" multicast="false"/>'
# ROS 2 nodes announce themselves on the default interface, and may not listen on loopback.
INTERFACES = f'<Interfaces>{LOOPBACK}<NetworkInterface autodetermine="true"/></Interfaces>'
ON_THIS_MACHINE = (
    "<AllowMulticast>spdp</AllowMulticast><MulticastTimeToLive>0</MulticastTimeToLive>"
)
NO_MULTICAST = "<AllowMulticast>false</AllowMulticast>"
# The same value as in rmw_cyclonedds_cpp. The index limits the number of processes that can find
# each other.
INDEX = (
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
)
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Discovery:
    """The machines on which a publisher looks for other participants."""

    range: Range = "SUBNET"
    peers: tuple[str, ...] = ()
    """Other machines on which to look for participants, by name or address."""
    domain: int = 0
    network: bool = False
    """Whether other machines of the same subnet are reached (the range SUBNET of ROS)."""

    @classmethod
    def from_environment(cls, *, network: bool = False) -> Discovery:
        """Read the settings from ROS 2's environment variables.

        Raises:
            InputError: `network` contradicts the variables, or a variable has an invalid value.
        """
        reach, peers = _range(), _peers()
        if os.environ.get(LOCALHOST_ONLY) == "1":
            log.warning(
                "%s is removed in ROS 2 Lyrical: use %s.", LOCALHOST_ONLY, f"{RANGE}=LOCALHOST"
            )
            reach, peers = "LOCALHOST", ()
        if network and reach in ("LOCALHOST", "OFF"):
            limit = f"The environment restricts discovery to this machine (range {reach})."
            remedy = f"`unset {LOCALHOST_ONLY}` and `export {RANGE}=SUBNET`, or remove network."
            raise InputError("network", network, limit, remedy)
        if peers and reach in ("OFF", "SYSTEM_DEFAULT"):
            log.warning("%s is ignored, because %s is %s.", PEERS, RANGE, reach)
            peers = ()
        return cls(reach, peers, domain_id(), network)

    def configurations(self) -> tuple[str, ...]:
        """Return Cyclone DDS configurations; the second is for machines with only loopback."""
        if self.range == "SYSTEM_DEFAULT":
            return (_xml(FAST_DDS),)
        if self.range == "OFF":
            # The tag is unique, so no participant of another process answers.
            alone = f"<ParticipantIndex>none</ParticipantIndex><Tag>phy124_{os.getpid()}</Tag>"
            return (_xml(self._general(NO_MULTICAST) + self._discovery(alone) + FAST_DDS),)
        if self.network:
            return (_xml(self._discovery(INDEX, *self.peers) + FAST_DDS),)
        multicast = ON_THIS_MACHINE if self.range == "SUBNET" else NO_MULTICAST
        discovery = self._discovery(INDEX, "localhost", *self.peers) + FAST_DDS
        return (
            _xml(self._general(INTERFACES + multicast) + discovery),
            _xml(self._general(multicast) + discovery),
        )

    def audience(self) -> str:
        """Describe in a line who receives the frames, and which settings the receivers need."""
        who = {
            "SUBNET": "nodes on this machine and network"
            if self.network
            else "nodes on this machine",
            "LOCALHOST": "nodes on this machine",
            "OFF": "no other process",
            "SYSTEM_DEFAULT": "participants that Cyclone DDS finds by its own settings",
        }[self.range]
        also = f" and {', '.join(self.peers)}" if self.peers else ""
        need = "" if self.range == "OFF" else f"; run there `{self.export()}`"
        return f"Discovery range {self.range}, domain {self.domain}: visible to {who}{also}{need}."

    def export(self) -> str:
        """Return the shell command to run on the receiving machine."""
        return f"export {DOMAIN}={self.domain} {RANGE}={self.range}"

    def _general(self, inner: str) -> str:
        return f"<General>{inner}</General>"

    def _discovery(self, index: str, *peers: str) -> str:
        named = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers)
        return f"<Discovery>{index}{f'<Peers>{named}</Peers>' if named else ''}</Discovery>"


def domain_id() -> int:
    """Return the domain number in ROS_DOMAIN_ID; 0 if the variable is not set.

    Raises:
        InputError: The variable is not a domain number.
    """
    text = os.environ.get(DOMAIN) or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        limit = f"A domain is a whole number from 0 to {LAST_DOMAIN}."
        raise InputError(DOMAIN, text, limit, "Set the variable to such a number, or unset it.")
    return int(text)


def _range() -> Range:
    text = os.environ.get(RANGE) or "SUBNET"
    for known in get_args(Range):
        if text == known:
            return known
    log.warning(
        "%s=%s is unknown; as in ROS, only this machine is reached (LOCALHOST).", RANGE, text
    )
    return "LOCALHOST"


def _peers() -> tuple[str, ...]:
    return tuple(filter(None, map(str.strip, os.environ.get(PEERS, "").split(";"))))


@contextmanager
def tuned_cyclone() -> Iterator[None]:
    """Apply the settings `BUFFERS` to domains of Cyclone DDS that rclpy creates in this context.

    If the user has set CYCLONEDDS_URI, it takes precedence. Other middlewares ignore the variable.
    """
    if URI in os.environ:
        yield
        return
    os.environ[URI] = _xml()
    try:
        yield
    finally:
        del os.environ[URI]


def _xml(settings: str = "") -> str:
    return f'<CycloneDDS><Domain id="any">{settings}{BUFFERS}</Domain></CycloneDDS>'
