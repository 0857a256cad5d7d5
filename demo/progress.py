"""Events of a job, and the progress of a job for the page."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from phy124.scene import Scene, View

from .course import Course

STAGES = {"generate": "Picture to 3D", "simulate": "Physics", "render": "Videos", "save": "Files"}
READING = {"generate": "File to 3D"}
"""Title of the first stage if the visitor sent a file of Gaussians."""
FITTING = {"read": "Video", "fit": "Search"}
MEASURING = {"generate": "Picture to 3D", "measure": "Grids"}


@dataclass
class Progress:
    """Content of the progress panel."""

    state: str = "waiting"
    """State of the job: first waiting or running; at the end done, stopped, refused, full or
    failed.
    """
    message: str = ""
    expected: float = 0.0
    """Predicted duration of the job [s]."""
    course: Course | None = None
    """Predicted course of a run; None for other jobs."""
    first: float = 0.0
    """Time from the start to the first simulated frame [s]; 0 before this frame."""
    unloaded: float = 0.0
    """Predicted duration without load from other programs [s]; 0 if unknown."""
    names: Mapping[str, str] = field(default_factory=lambda: STAGES)
    """Stages of the job, each with its title."""
    start: float = field(default_factory=time.monotonic)
    stages: dict[str, Step] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    glimpses: list[bytes] = field(default_factory=list)
    """Small JPEG pictures of the finished frames."""
    live: list[str] = field(default_factory=list)
    """Files of the finished frames, for the 3D viewer."""
    result: Any = None

    def take(self, event: Any) -> None:
        """Update the progress from an event of the job; None means only that time has passed."""
        if isinstance(event, Step):
            self.stages[event.stage] = event
            if self.course and event.stage == "simulate" and event.done:
                elapsed = time.monotonic() - self.start
                self.first = self.first or elapsed
                self.course = self.course.observe(event.done, elapsed, self.first)
        elif isinstance(event, Reused):
            self.reused.append(event.stage)
        elif isinstance(event, Glimpse):
            self.glimpses.append(event.picture)
        elif isinstance(event, Live):
            self.live.append(event.file)
        elif isinstance(event, Done | Measured):
            self.result, self.state = event, "done"

    def begin(self) -> None:
        """Record that the job has started to run."""
        self.state, self.start = "running", time.monotonic()

    @property
    def whole(self) -> bool:
        """Whether the job is done, and was not shortened by the time limit."""
        return self.state == "done" and not (self.course and self.course.ended)

    def duration(self, slowdowns: Sequence[float]) -> float:
        """Predict the duration of the job [s].

        The `slowdowns` are durations of recent jobs, each divided by the duration predicted without
        other load.
        """
        if self.course and self.course.ended:
            return self.course.seconds
        if slowdowns and self.unloaded:
            return median(slowdowns) * self.unloaded
        return self.expected

    def seconds_left(self, slowdowns: Sequence[float]) -> float:
        """Predict the time until the running job ends [s]."""
        return max(self.duration(slowdowns) - (time.monotonic() - self.start), 0.0)

    def data(self, seen: int = 0) -> dict[str, Any]:
        """Return the progress as plain data for the page, without the first `seen` frames.

        A frame is included only after its picture and its file exist, so that no frame is skipped.
        """
        frames = slice(seen, min(len(self.glimpses), len(self.live)))
        return {
            "state": self.state,
            "message": self.message,
            "elapsed": time.monotonic() - self.start,
            "expected": self.course.seconds if self.course else self.expected,
            "warning": self.course.warning if self.course else "",
            "stages": [self._row(name) for name in self.names],
            "glimpses": [base64.b64encode(picture).decode() for picture in self.glimpses[frames]],
            "live": self.live[frames],
        }

    def _row(self, name: str) -> dict[str, Any]:
        step, reused = self.stages.get(name), name in self.reused
        note = "reused" if reused else step.note if step else ""
        done, total = (step.done, step.total) if step else (0, 0)
        return {
            "name": self.names[name],
            "done": done,
            "total": total,
            "note": note,
            "reused": reused,
        }


@dataclass(frozen=True)
class Step:
    """Event: a job has completed a part of a stage."""

    stage: str
    done: int
    total: int
    note: str = ""


@dataclass(frozen=True)
class Glimpse:
    """Event: a frame was simulated. The event contains a small JPEG picture of the frame."""

    picture: bytes


@dataclass(frozen=True)
class Live:
    """Event: a frame was simulated. The event contains the frame's file for the 3D viewer."""

    file: str


@dataclass(frozen=True)
class Reused:
    """Event: a stage was skipped, because its stored result could be used again."""

    stage: str


@dataclass(frozen=True)
class Done:
    """Event: a run has ended. The event contains the folders of the results."""

    clip: Path
    """Folder of the clip, its Gaussians and the scene of the first run that made the clip."""
    films: Path
    """Folder of the videos, the player's pack, the scene and the report."""
    study: Path
    """File in which the error measured on this scene is stored."""

    @property
    def exports(self) -> Path:
        """Folder for files in further formats, which are created when the visitor requests them."""
        return self.films.parent.parent / "exports" / self.films.name

    @property
    def viewed_clip(self) -> Path:
        """File of the clip with the view of the videos."""
        folders = (folder / "clip.safetensors" for folder in (self.films, self.clip))
        return next(filter(Path.exists, folders), self.clip / "clip.safetensors")

    @property
    def is_stored(self) -> bool:
        """Whether the clip and the videos still exist."""
        return (self.films / "report.json").exists() and (self.clip / "clip.safetensors").exists()

    @property
    def scene(self) -> Scene:
        """The run's scene with the view of the videos, without the paths of uploads."""
        return Scene.from_toml(self.films / "scene.toml")

    @property
    def view(self) -> View:
        """The view of the videos, with the path of its picture."""
        view, uploads = self.scene.view, self.films.parents[1] / "uploads"
        return view.model_copy(update={"picture": view.picture and uploads / view.picture})

    @property
    def report(self) -> dict[str, Any]:
        """The run's report."""
        return json.loads((self.films / "report.json").read_text("utf-8"))


@dataclass(frozen=True)
class Measured:
    """Event: a study that measures the error of a scene has ended."""

    study: Path
    """File that stores a `demo.studies.Measurement`."""


Event = Step | Glimpse | Live | Reused | Done | Measured
Tell = Callable[[Event], None]


def close_now(events: Iterator[Any]) -> None:
    """Close the generator of a job's events immediately, without waiting for garbage collection."""
    close = getattr(events, "close", None)
    if close is not None:
        close()
