"""What each visitor has on disk: one folder with an unguessable name, a cache by content inside.

A stage's result lies under a key made of everything it depends on, so a stage runs again exactly
when something it depends on has changed:

    uploads/NAME                  pictures as they were sent
    cutouts/KEY.png               picture, brush strokes
    gaussians/KEY.safetensors     cut-out, generator, seed
    clips/KEY/                    Gaussians and the scene without its view
    films/KEY/                    clip and view
    studies/KEY.json              Gaussians and the scene without its view and grid

A folder is kept while its visitor gives signs of life, which an open page does every minute, and
for a time of grace after the last one. It then goes with everything that is in it.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
import stat
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phy124.errors import InputError

if TYPE_CHECKING:
    from .line import Job

STAGES = ("cutouts", "gaussians", "clips", "films", "studies")
UPLOADS = 8
"""Pictures kept of one visitor."""
AWAY = 150.0
"""Silence after which a page is taken to be closed, s: an open one speaks up every minute."""
ARRIVED = 600.0
"""For so long an upload may wait for the request that uses it, s."""
FULL = "Too many visitors are here at once."


@dataclass(frozen=True)
class Room:
    """How much may be kept, and for how long."""

    visitors: int = 64
    clips: int = 3
    """Results of one visitor."""
    grace: float = 900.0
    """Time for which silent visitors are kept, s."""
    each: float = 1e9
    """Bytes of one visitor."""
    all: float = 8e9
    """Bytes of all visitors."""


class Visitor:
    """One visitor's folder and jobs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seen = time.time()
        self.forecasts: dict[str, float] = {}
        """Seconds that a probe has found, by scene."""
        self.jobs: dict[str, Job] = {}
        """The newest pieces of work by name, oldest first."""
        for stage in ("uploads", *STAGES):
            (folder / stage).mkdir(parents=True, exist_ok=True)

    @property
    def busy(self) -> bool:
        """Whether work is in hand or waits for its turn."""
        return any(not job.over for job in list(self.jobs.values()))

    @property
    def has_results(self) -> bool:
        """Whether anything was computed for this visitor."""
        return any((self.folder / "clips").glob("*"))

    @property
    def silence(self) -> float:
        """Seconds since the last sign of life."""
        return time.time() - self.seen

    def remember(self, job: Job, most: int = 8) -> None:
        """Keep a piece of work so that the page finds it again, and forget the oldest."""
        self.jobs[job.name] = job
        for name in [n for n, j in self.jobs.items() if j.over][: max(0, len(self.jobs) - most)]:
            del self.jobs[name]

    def latest(self, kind: str) -> Job | None:
        """The newest piece of work of a kind."""
        return next((j for j in reversed(list(self.jobs.values())) if j.kind == kind), None)

    def stop(self) -> None:
        """Call off whatever is in hand or waits."""
        for job in list(self.jobs.values()):
            job.cancel()

    def touch(self) -> None:
        """Take note of a sign of life."""
        self.seen = time.time()

    def new_stop_file(self) -> Path:
        """A file that, once it exists, asks a piece of work to stop.

        A file, because the work may run in another process (ZeroGPU forks one).
        """
        return self.folder / f"stop-{secrets.token_hex(8)}"

    def size(self) -> int:
        """Bytes on disk."""
        return sum(_sizes(self.folder))

    def trim(self, room: Room) -> None:
        """Forget all but the newest results of each stage, and more of them for want of room."""
        for stage in ("uploads", *STAGES):
            entries = _newest_first(self.folder / stage)
            # A clip has films of several views, and the pictures behind them are small.
            keep = {"uploads": UPLOADS, "clips": room.clips}.get(stage, 3 * room.clips)
            for entry in entries[keep:]:
                _remove(entry)
        for stage in ("films", "clips", "gaussians"):
            for entry in reversed(_newest_first(self.folder / stage)[1:]):
                if self.size() <= room.each:
                    return
                _remove(entry)


class Visitors:
    """All visitors by name; safe to use from several threads."""

    def __init__(self, root: Path, room: Room | None = None) -> None:
        self.root, self.room = root, room or Room()
        # Uploads of programs that have not said yet who they are.
        self.arrivals = root / "arrivals"
        self.arrivals.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        self._known: dict[str, Visitor] = {}
        self._leaving: list[Visitor] = []
        """Removed, but for the files that ask their work to stop."""

    def __len__(self) -> int:
        return len(self._known)

    def known(self, name: str) -> Visitor | None:
        """The visitor of that name if there is one; it counts as a sign of life."""
        with self._lock:
            visitor = self._known.get(name)
            if visitor is not None:
                visitor.touch()
            return visitor

    def job(self, name: str) -> Job | None:
        """Anybody's piece of work by its name, which cannot be guessed; a sign of life, too."""
        with self._lock:
            visitor = next((v for v in self._known.values() if name in v.jobs), None)
            if visitor is None:
                return None
            visitor.touch()
            return visitor.jobs[name]

    def get(self, name: str) -> Visitor:
        """The visitor of a name, new if it was not known; raises InputError if all is taken."""
        with self._lock:
            visitor = self.known(name)
            if visitor is None:
                while len(self._known) >= self.room.visitors:
                    self._make_room()
                visitor = self._known[name] = Visitor(self.root / secrets.token_urlsafe(24))
            return visitor

    def store(self, name: str | None, data: bytes, suffix: str) -> Path:
        """Keep an upload, of nobody yet if no name is given; raises InputError for want of room."""
        with self._lock:
            while sum(_sizes(self.root)) + len(data) > self.room.all:
                self._make_room()
        if name is None:
            folder = self.arrivals
        else:
            visitor = self.get(name)
            visitor.trim(self.room)
            if visitor.size() + len(data) > self.room.each:
                raise InputError(
                    "picture", "full", "Your pictures fill the room here.", "Send a smaller one."
                )
            folder = visitor.folder / "uploads"
        path = folder / f"{secrets.token_urlsafe(18)}{suffix}"
        path.write_bytes(data)
        return path

    def own(self, name: str, given: Any) -> Path:
        """The visitor's own upload that a request names; raises InputError for anything else.

        The answer is the same whether such a file exists or not.
        """
        folder = self.get(name).folder / "uploads"
        path = folder / Path(str(given)).name
        if str(given) == str(self.arrivals / path.name):
            try:
                os.rename(given, path)
            except (OSError, ValueError):
                path = folder
        elif str(given) != str(path):
            path = folder
        if not is_plain_file(path):
            raise InputError(
                "picture", "unknown", "This picture is not here.", "Choose it once more."
            )
        return path

    def remove(self, name: str) -> None:
        """Stop a visitor's work and remove the folder."""
        with self._lock:
            visitor = self._known.pop(name, None)
        if visitor is not None:
            visitor.stop()
            for stage in ("uploads", *STAGES, "live"):
                _remove(visitor.folder / stage)
            with self._lock:
                self._leaving.append(visitor)
            self._clear()

    def _clear(self) -> None:
        """Remove the folders of those who have left, once no work looks for a stop file there."""
        with self._lock:
            ended = [visitor for visitor in self._leaving if not visitor.busy]
            self._leaving = [visitor for visitor in self._leaving if visitor.busy]
        for visitor in ended:
            _remove(visitor.folder)

    def sweep(self) -> None:
        """Remove who has been silent for too long, and what is nobody's."""
        with self._lock:
            silent = [n for n, v in self._known.items() if v.silence > self.room.grace]
        for name in silent:
            self.remove(name)
        self._clear()
        with self._lock:
            here = [*self._known.values(), *self._leaving]
            kept = {visitor.folder for visitor in here} | {self.arrivals}
            for folder in self.root.iterdir():
                if folder not in kept:
                    _remove(folder)
        for path in self.arrivals.iterdir():
            if time.time() - _changed(path) > ARRIVED:
                _remove(path)

    def close(self) -> None:
        """Stop all work and remove everything."""
        for name in list(self._known):
            self.remove(name)
        _remove(self.root)

    def _make_room(self) -> None:
        """Remove whoever loses least by it: never the results of a page that is open."""
        idle = [(n, v) for n, v in self._known.items() if not v.busy and v.silence > 1]
        empty = [(n, v) for n, v in idle if not v.has_results]
        away = [(n, v) for n, v in idle if v.silence > AWAY]
        for group in (empty, away):
            if group:
                return self.remove(max(group, key=lambda entry: entry[1].silence)[0])
        raise InputError("visitors", len(self._known), FULL, "Try again in a few minutes.")


def key(*parts: Any) -> str:
    """A name for whatever depends on these parts alone: bytes, or JSON-like data."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()[:32]


def is_plain_file(path: Path) -> bool:
    """Whether a regular file lies there itself, not a link to one."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except (OSError, ValueError):
        return False


def _sizes(folder: Path) -> Iterator[int]:
    for place, _, names in os.walk(folder):
        for name in names:
            try:
                yield os.lstat(os.path.join(place, name)).st_size
            except OSError:
                continue


def _newest_first(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir(), key=_changed, reverse=True)
    except OSError:
        return []


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
