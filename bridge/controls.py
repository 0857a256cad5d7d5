"""Controls: what a sink hears and offers besides frames, while a run is steered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .topics import Topic

Hear = Callable[[Any], None]
"""Takes one message, whose members are attributes."""
PLAYER = "player"
"""Name of the node that plays clips."""


@dataclass(frozen=True)
class Service:
    """One service; it is served on the thread that calls the sink's `listen`."""

    name: str
    type: str
    """`package/srv/Name`."""
    serve: Callable[[Any], dict[str, Any]]
    """Takes the request, whose members are attributes; returns the members of the response."""


@dataclass(frozen=True)
class Controls:
    """What a sink offers; by default what a player of clips does."""

    node: str = PLAYER
    published: tuple[Topic, ...] = ()
    """Topics on which messages are sent besides those of the frames."""
    heard: Mapping[Topic, Hear] = field(default_factory=dict)
    services: tuple[Service, ...] = ()
    steps: Callable[[int], Any] | None = None
    """Makes so many steps, one for each item of the iterator that it returns."""
    refused: Callable[[str], object] = lambda sentence: None
    """Takes a sentence on what was refused."""
    clock: bool = False
    """Whether /clock is published."""
    values: Callable[[], Mapping[str, Any]] = dict
    """What the diagnostics say besides the state of playback."""
