"""The files of each visitor: one folder with a name that cannot be guessed, and caches inside.

The result of a stage is stored under a key made of everything it depends on, so a stage runs again
exactly when something it depends on has changed:

    uploads/NAME                  pictures, videos and files of Gaussians as they were sent
    cutouts/KEY.png               picture, brush strokes
    objects/NAME/                 file of Gaussians
    gaussians/KEY.safetensors     cut-out or file, generator, seed
    clips/KEY/                    Gaussians and the scene without its view
    films/KEY/                    clip and view
    studies/KEY.json              Gaussians and the scene without its view and grid
    fits/CLIP-KEY/                clip, video, and what is said of it

A folder is kept while its visitor gives signs of life, which an open page does every minute, and
for a grace period after the last one. It is then removed with everything in it.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import secrets
import shutil
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from phy124.errors import InputError

if TYPE_CHECKING:
    from .line import Job

STAGES = ("cutouts", "objects", "gaussians", "clips", "films", "studies", "fits")
UPLOADS = 8
"""Number of uploads kept for one visitor."""
AWAY = 150.0
"""Silence after which a page counts as closed [s]; an open one reports every minute."""
ARRIVED = 600.0
"""Longest time between an upload and the request that uses it [s]."""
FULL = "Too many visitors are here at once."


@dataclass(frozen=True)
class Room:
    """How many files may be kept, and for how long."""

    visitors: int = 64
    clips: int = 3
    """Number of results of one visitor."""
    grace: float = 900.0
    """Time for which silent visitors are kept [s]."""
    each: float = 1e9
    """Files of one visitor [bytes]."""
    all: float = 8e9
    """Files of all visitors [bytes]."""


class Visitor:
    """One visitor's folder and jobs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seen = time.time()
        self.forecasts: dict[str, float] = {}
        """Key of a scene -> time predicted by a probe [s]."""
        self.jobs: dict[str, Job] = {}
        """The newest jobs by name, the oldest of them first."""
        self.shared: dict[str, Path] = {}
        """Files that anyone may see who has the link, by its token."""
        for stage in ("uploads", *STAGES):
            (folder / stage).mkdir(parents=True, exist_ok=True)

    @property
    def busy(self) -> bool:
        """Whether a job is running or waiting."""
        return any(not job.over for job in list(self.jobs.values()))

    @property
    def has_results(self) -> bool:
        """Whether anything was computed for this visitor."""
        return any((self.folder / "clips").glob("*"))

    @property
    def silence(self) -> float:
        """Time since the last sign of life [s]."""
        return time.time() - self.seen

    def remember(self, job: Job, most: int = 8) -> None:
        """Keep a job so that the page can find it, and forget the oldest beyond `most`."""
        self.jobs[job.name] = job
        for name in [n for n, j in self.jobs.items() if j.over][: max(0, len(self.jobs) - most)]:
            del self.jobs[name]

    def latest(self, *kinds: str) -> Job | None:
        """The newest job of these kinds."""
        return next((j for j in reversed(list(self.jobs.values())) if j.kind in kinds), None)

    def stop(self) -> None:
        """Cancel all jobs that are running or waiting."""
        for job in list(self.jobs.values()):
            job.cancel()

    def touch(self) -> None:
        """Note a sign of life."""
        self.seen = time.time()

    def share(self, path: Path) -> str:
        """The token of a link to a file, which cannot be guessed; the same each time."""
        for token, known in self.shared.items():
            if known == path:
                return token
        token = secrets.token_urlsafe(16)
        self.shared[token] = path
        return token

    def new_stop_file(self) -> Path:
        """The path of a file whose existence asks a job to stop.

        It is a file because the job may run in another process (ZeroGPU forks one).
        """
        return self.folder / f"stop-{secrets.token_hex(8)}"

    def size(self) -> int:
        """Size of the folder [bytes]."""
        return sum(_sizes(self.folder))

    def trim(self, room: Room) -> None:
        """Remove all but the newest results of each stage, and more if there is too little room."""
        for stage in ("uploads", *STAGES):
            entries = _newest_first(self.folder / stage)
            # There may be films of several views for a clip, and cut-outs and uploads are small.
            keep = {"uploads": UPLOADS, "clips": room.clips}.get(stage, 3 * room.clips)
            for entry in entries[keep:]:
                _remove(entry)
        for stage in ("fits", "films", "clips", "gaussians"):
            for entry in reversed(_newest_first(self.folder / stage)[1:]):
                if self.size() <= room.each:
                    return
                _remove(entry)


class Visitors:
    """All visitors by name; thread-safe."""

    def __init__(self, root: Path, room: Room | None = None) -> None:
        self.root, self.room = root, room or Room()
        # Uploads of programs whose session is not known yet.
        self.arrivals = root / "arrivals"
        self.arrivals.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        self._known: dict[str, Visitor] = {}
        self._leaving: list[Visitor] = []
        """Visitors who are removed except for the files that ask their jobs to stop."""

    def __len__(self) -> int:
        return len(self._known)

    def known(self, name: str) -> Visitor | None:
        """The visitor of that name if there is one; this counts as a sign of life."""
        with self._lock:
            visitor = self._known.get(name)
            if visitor is not None:
                visitor.touch()
            return visitor

    def is_here(self, name: str | None) -> bool:
        """Whether the page of a visitor is open; asking is no sign of life."""
        visitor = self._known.get(name or "")
        return visitor is not None and visitor.silence < AWAY

    def job(self, name: str) -> Job | None:
        """The job of that name, which cannot be guessed; this counts as a sign of life."""
        with self._lock:
            visitor = next((v for v in self._known.values() if name in v.jobs), None)
            if visitor is None:
                return None
            visitor.touch()
            return visitor.jobs[name]

    def shared(self, token: str) -> Path | None:
        """The file of a link, as long as its visitor's files are kept; looking keeps nothing."""
        with self._lock:
            found = (v.shared[token] for v in self._known.values() if token in v.shared)
            path = next(found, None)
        return path if path is not None and path.exists() else None

    def get(self, name: str) -> Visitor:
        """The visitor of that name, a new one if it is not known.

        Raises:
            InputError: There are too many visitors.
        """
        with self._lock:
            visitor = self.known(name)
            if visitor is None:
                while len(self._known) >= self.room.visitors:
                    self._make_room()
                visitor = self._known[name] = Visitor(self.root / secrets.token_urlsafe(24))
            return visitor

    def store(self, name: str | None, data: bytes | BinaryIO, suffix: str) -> Path:
        """Store an upload.

        Args:
            name: The visitor's name; None: it belongs to nobody yet.
            data: The content, or a file with it.
            suffix: The suffix of the file's name.

        Raises:
            InputError: There is no room for it.
        """
        file = io.BytesIO(data) if isinstance(data, bytes) else data
        size = file.seek(0, os.SEEK_END)
        with self._lock:
            while sum(_sizes(self.root)) + size > self.room.all:
                self._make_room()
        if name is None:
            folder = self.arrivals
        else:
            visitor = self.get(name)
            visitor.trim(self.room)
            if visitor.size() + size > self.room.each:
                raise InputError(
                    "picture", "full", "Your files take all the room here.", "Send a smaller one."
                )
            folder = visitor.folder / "uploads"
        path = folder / f"{secrets.token_urlsafe(18)}{suffix}"
        file.seek(0)
        with open(path, "wb") as stored:
            shutil.copyfileobj(file, stored)
        return path

    def own(self, name: str, given: Any) -> Path:
        """The visitor's own upload that a request names.

        Raises:
            InputError: It names anything else; the message is the same whether that exists or not.
        """
        folder = self.get(name).folder / "uploads"
        path = folder / Path(str(given)).name
        if str(given) == str(self.arrivals / path.name):
            # Of what one request names several times, the first time has moved it here.
            with suppress(OSError, ValueError):
                os.rename(given, path)
        elif str(given) != str(path):
            path = folder
        if not is_plain_file(path):
            raise InputError(
                "picture", "unknown", "This picture is not here.", "Choose it once more."
            )
        return path

    def remove(self, name: str) -> None:
        """Stop a visitor's jobs and remove the folder."""
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
        """Remove the folders of those who have left, once no job looks for a stop file there."""
        with self._lock:
            ended = [visitor for visitor in self._leaving if not visitor.busy]
            self._leaving = [visitor for visitor in self._leaving if visitor.busy]
        for visitor in ended:
            _remove(visitor.folder)

    def sweep(self) -> None:
        """Remove visitors who have been silent for too long, and uploads that belong to nobody."""
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
        """Stop all jobs and remove everything."""
        for name in list(self._known):
            self.remove(name)
        _remove(self.root)

    def _make_room(self) -> None:
        """Remove the visitor who loses least, never one with results and an open page."""
        idle = [(n, v) for n, v in self._known.items() if not v.busy and v.silence > 1]
        empty = [(n, v) for n, v in idle if not v.has_results]
        away = [(n, v) for n, v in idle if v.silence > AWAY]
        for group in (empty, away):
            if group:
                return self.remove(max(group, key=lambda entry: entry[1].silence)[0])
        raise InputError("visitors", len(self._known), FULL, "Try again in a few minutes.")


def key(*parts: Any) -> str:
    """A name for something that depends only on these parts, which are bytes or JSON-like data."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()[:32]


def is_plain_file(path: Path) -> bool:
    """Whether the path is a regular file and not a link to one."""
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
