"""Translates ROS 2's environment variables for discovery to settings of Cyclone DDS.

ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_STATIC_PEERS, ROS_LOCALHOST_ONLY and ROS_DOMAIN_ID have the same
meaning as for a ROS 2 node ("improved dynamic discovery", ROS 2 Iron and later). With SUBNET the
publisher is stricter than a node: without `network` it stays on this machine.
"""

from __future__ import annotations

import logging
import os
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
LAST_DOMAIN = 232
"""Largest DDS domain whose ports fit."""
# `max`, never `min`: hosts with a small rmem_max would refuse to start.
# A heartbeat asks for acknowledgements; one every 100 ms, the default, is late at 30 Hz.
BUFFERS = (
    '<Internal><SocketReceiveBufferSize max="4MB"/>'
    "<HeartbeatInterval>10 ms</HeartbeatInterval></Internal>"
)
LOOPBACK = '<NetworkInterface address="127.0.0.1" multicast="false"/>'
# ROS 2's own nodes announce themselves on the default interface and may not listen on loopback.
INTERFACES = f'<Interfaces>{LOOPBACK}<NetworkInterface autodetermine="true"/></Interfaces>'
ON_THIS_MACHINE = (
    "<AllowMulticast>spdp</AllowMulticast><MulticastTimeToLive>0</MulticastTimeToLive>"
)
NO_MULTICAST = "<AllowMulticast>false</AllowMulticast>"
# The same two numbers as rmw_cyclonedds_cpp: the number of processes that can find each other.
INDEX = (
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
)
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Discovery:
    """The participants that a publisher looks for."""

    range: Range = "SUBNET"
    peers: tuple[str, ...] = ()
    """Other machines to look for, by name or address."""
    domain: int = 0
    network: bool = False
    """With SUBNET: also reach other machines."""

    @classmethod
    def from_environment(cls, *, network: bool = False) -> Discovery:
        """The settings of ROS 2's variables.

        Raises:
            InputError: `network` contradicts them, or a variable is wrong.
        """
        reach, peers = _range(), _peers()
        if os.environ.get(LOCALHOST_ONLY) == "1":
            reach, peers = "LOCALHOST", ()
        if network and reach in ("LOCALHOST", "OFF"):
            limit = f"The environment allows no other machine (range {reach})."
            remedy = f"`unset {LOCALHOST_ONLY}` and `export {RANGE}=SUBNET`, or leave it out."
            raise InputError("network", network, limit, remedy)
        if peers and reach in ("OFF", "SYSTEM_DEFAULT"):
            log.warning("%s is ignored in the range %s.", PEERS, reach)
            peers = ()
        return cls(reach, peers, domain_id(), network)

    def configurations(self) -> tuple[str, ...]:
        """Cyclone's XML, followed by what to try if loopback is the only interface."""
        if self.range == "SYSTEM_DEFAULT":
            return (_xml(BUFFERS),)
        if self.range == "OFF":
            # With a unique tag, no participant outside this process answers.
            alone = f"<ParticipantIndex>none</ParticipantIndex><Tag>phy124_{os.getpid()}</Tag>"
            return (_xml(self._general(NO_MULTICAST) + self._discovery(alone)),)
        if self.network:
            return (_xml(self._discovery(INDEX, *self.peers)),)
        multicast = ON_THIS_MACHINE if self.range == "SUBNET" else NO_MULTICAST
        discovery = self._discovery(INDEX, "localhost", *self.peers)
        return (
            _xml(self._general(INTERFACES + multicast) + discovery),
            _xml(self._general(multicast) + discovery),
        )

    def audience(self) -> str:
        """One line: who receives the frames, and what they need."""
        who = {
            "SUBNET": "nodes on this machine and network"
            if self.network
            else "nodes on this machine",
            "LOCALHOST": "nodes on this machine",
            "OFF": "nobody",
            "SYSTEM_DEFAULT": "whomever Cyclone DDS finds by its own settings",
        }[self.range]
        also = f" and {', '.join(self.peers)}" if self.peers else ""
        need = "" if self.range == "OFF" else f"; there: `{self.export()}`"
        return f"Discovery range {self.range}, domain {self.domain}: heard by {who}{also}{need}."

    def export(self) -> str:
        """The shell command for the receiving side."""
        return f"export {DOMAIN}={self.domain} {RANGE}={self.range}"

    def _general(self, inner: str) -> str:
        return f"<General>{inner}</General>"

    def _discovery(self, index: str, *peers: str) -> str:
        named = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers)
        return f"<Discovery>{index}{f'<Peers>{named}</Peers>' if named else ''}</Discovery>"


def domain_id() -> int:
    """The domain given by ROS_DOMAIN_ID, otherwise 0.

    Raises:
        InputError: It is not a domain.
    """
    text = os.environ.get(DOMAIN) or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        limit = f"A domain is a whole number from 0 to {LAST_DOMAIN}."
        raise InputError(DOMAIN, text, limit, "Set it to one, or unset it.")
    return int(text)


def _range() -> Range:
    text = os.environ.get(RANGE) or "SUBNET"
    for known in get_args(Range):
        if text == known:
            return known
    log.warning(
        "%s=%s is unknown; this machine only (LOCALHOST) is assumed, as ROS does.", RANGE, text
    )
    return "LOCALHOST"


def _peers() -> tuple[str, ...]:
    return tuple(filter(None, map(str.strip, os.environ.get(PEERS, "").split(";"))))


def _xml(inner: str) -> str:
    settings = inner if BUFFERS in inner else inner + BUFFERS
    return f'<CycloneDDS><Domain id="any">{settings}</Domain></CycloneDDS>'
