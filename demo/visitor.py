"""One visitor: the folder, the jobs, and what of it is kept."""

from __future__ import annotations

import secrets
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from .room import Room, changed, newest_first, remove, size_of

if TYPE_CHECKING:
    from .line import Job

STAGES = (
    "cutouts", "objects", "gaussians", "clips", "films", "exports", "studies", "fits"
)  # fmt: skip
"""Folders of what is made, in `demo.visitors`."""
UPLOADS = 8
"""Number of uploads kept for one visitor."""


class Visitor:
    """One visitor's folder and jobs."""

    def __init__(self, folder: Path, address: str = "") -> None:
        self.folder, self.address = folder, address
        self.used = 0
        """Size of the files, when it was last measured [bytes]."""
        self.promised = 0.0
        """What is being written [bytes]."""
        self.seen = time.time()
        self.forecasts: dict[str, float] = {}
        """Key of a scene -> time predicted by a probe [s]."""
        self.thickness: dict[str, float | None] = {}
        """File of an object's Gaussians -> its local thickness relative to its size."""
        self.jobs: dict[str, Job] = {}
        """The newest jobs by name, the oldest of them first."""
        self.shared: dict[str, Path] = {}
        """Files that anyone may see who has the link, by its token."""
        for stage in ("uploads", *STAGES):
            (folder / stage).mkdir(parents=True, exist_ok=True)

    @property
    def busy(self) -> bool:
        """Whether a job is running or waiting."""
        return self.unfinished > 0

    @property
    def unfinished(self) -> int:
        """Number of jobs that are running or waiting."""
        return sum(not job.over for job in list(self.jobs.values()))

    @property
    def has_results(self) -> bool:
        """Whether anything was computed for this visitor."""
        return any((self.folder / "clips").glob("*"))

    @property
    def has_begun(self) -> bool:
        """Whether more than an upload was asked for: a picture was chosen, at least."""
        return bool(self.jobs) or self.has_results

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

    def measure(self) -> int:
        """Size of the files now [bytes]."""
        self.used = size_of(self.folder)
        return self.used

    def trim(self, room: Room) -> None:
        """Remove all but the newest results of each stage, and more if there is too little room."""
        for stage in ("uploads", *STAGES):
            entries = newest_first(self.folder / stage)
            # There may be films of several views for a clip, and cut-outs and uploads are small.
            keep = {"uploads": UPLOADS, "clips": room.clips}.get(stage, 3 * room.clips)
            for entry in entries[keep:]:
                remove(entry)
        for folder in newest_first(self.folder / "exports"):
            if not (self.folder / "films" / folder.name).exists():
                remove(folder)
        self.give_up(room.each)

    def give_up(self, most: float, keep: Collection[Path] = ()) -> bool:
        """Remove exports, then results, the oldest first, until the files take no more than `most`.

        The newest of each stage and those in `keep` stay. Returns whether they take no more then.
        """
        for path in self._oldest():
            if self.measure() <= most:
                return True
            if path not in keep:
                remove(path)
        return self.measure() <= most

    def _oldest(self) -> Iterator[Path]:
        """What may be removed, in that order."""
        if not self.busy:
            yield self.folder / "live"
        yield from sorted((self.folder / "exports").glob("*/*"), key=changed)
        for stage in ("fits", "films", "clips", "gaussians"):
            yield from reversed(newest_first(self.folder / stage)[1:])
