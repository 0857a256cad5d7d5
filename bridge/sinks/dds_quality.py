"""The DDS quality of service of a topic."""

from __future__ import annotations

from typing import Any

from ..messages import HASHES
from ..topics import Topic


def quality(topic: Topic, *, also: str = "", ignore_own: bool = False) -> Any:
    """The DDS quality of service of a topic, including the type hash.

    Args:
        topic: The topic.
        also: What the user data say besides.
        ignore_own: Whether what this program itself sends is not read.
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
        Policy.Userdata(f"typehash={HASHES[topic.type]};{also}".encode()),
        *([Policy.IgnoreLocal.Participant] if ignore_own else []),
    )
