"""Events of a job, sent while it runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Step:
    """The progress of a stage."""

    stage: str
    done: int
    total: int
    note: str = ""


@dataclass(frozen=True)
class Glimpse:
    """A small JPEG of the frame just simulated."""

    picture: bytes


@dataclass(frozen=True)
class Live:
    """A file with the frame just simulated, for the viewer."""

    file: str


@dataclass(frozen=True)
class Reused:
    """A stage that was not run again, since nothing it depends on has changed."""

    stage: str


@dataclass(frozen=True)
class Done:
    """Everything is finished."""

    clip: Path
    """Folder of the clip, its Gaussians and its scene."""
    films: Path
    """Folder of the videos, the player's pack and the report."""
    study: Path
    """The file with the error of this scene, once it has been measured."""

    @property
    def exports(self) -> Path:
        """Folder of the formats that are made on demand."""
        return self.films.parent.parent / "exports" / self.films.name

    @property
    def report(self) -> dict[str, Any]:
        """What the run says of itself."""
        return json.loads((self.films / "report.json").read_text("utf-8"))


@dataclass(frozen=True)
class Measured:
    """The error of the scene has been measured."""

    study: Path
    """File of a `demo.studies.Measurement`."""


Event = Step | Glimpse | Live | Reused | Done | Measured
Tell = Callable[[Event], None]


def close_now(events: Iterator[Any]) -> None:
    """Close the generator of a job's events now, not when it is garbage collected."""
    close = getattr(events, "close", None)
    if close is not None:
        close()
