"""The progress of a job, as the page shows it."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .events import Done, Glimpse, Live, Measured, Reused, Step

STAGES = {"generate": "Picture to 3D", "simulate": "Physics", "render": "Videos", "save": "Files"}
READING = {"generate": "File to 3D"}
"""The first stage of an object from a file of Gaussians."""
FITTING = {"read": "Video", "fit": "Search"}
MEASURING = {"generate": "Picture to 3D", "measure": "Grids"}


@dataclass
class Progress:
    """What the progress panel shows."""

    state: str = "waiting"
    """waiting or running, then done, stopped, refused, full or failed."""
    message: str = ""
    expected: float = 0.0
    names: Mapping[str, str] = field(default_factory=lambda: STAGES)
    """The stages to come, and their titles."""
    start: float = field(default_factory=time.monotonic)
    stages: dict[str, Step] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    glimpses: list[bytes] = field(default_factory=list)
    """Small pictures of all frames so far."""
    live: list[str] = field(default_factory=list)
    """Files of all frames so far, for the viewer."""
    result: Any = None
    """What the job has made."""

    def take(self, event: Any) -> None:
        """Process an event of the job; None means that only time has passed."""
        if isinstance(event, Step):
            self.stages[event.stage] = event
        elif isinstance(event, Reused):
            self.reused.append(event.stage)
        elif isinstance(event, Glimpse):
            self.glimpses.append(event.picture)
        elif isinstance(event, Live):
            self.live.append(event.file)
        elif isinstance(event, Done | Measured):
            self.result, self.state = event, "done"

    def begin(self) -> None:
        """The job has started."""
        self.state, self.start = "running", time.monotonic()

    def data(self, seen: int = 0) -> dict[str, Any]:
        """Plain data for the page, with the pictures from number `seen` on."""
        return {
            "state": self.state,
            "message": self.message,
            "elapsed": time.monotonic() - self.start,
            "expected": self.expected,
            "stages": [self._row(name) for name in self.names],
            "glimpses": [base64.b64encode(picture).decode() for picture in self.glimpses[seen:]],
            "live": self.live[seen:],
        }

    def _row(self, name: str) -> dict[str, Any]:
        step, reused = self.stages.get(name), name in self.reused
        note = "as before" if reused else step.note if step else ""
        done, total = (step.done, step.total) if step else (0, 0)
        return {
            "name": self.names[name],
            "done": done,
            "total": total,
            "note": note,
            "reused": reused,
        }
