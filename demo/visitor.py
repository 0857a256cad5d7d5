"""The folder and the jobs of a visitor, and the rules for removing old results."""

from __future__ import annotations

import secrets
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from .room import Room, change_time, newest_first, remove, size_of

if TYPE_CHECKING:
    from phy124.particles.thickness import Proportions

    from .line import Job

STAGES = ("cutouts", "objects", "gaussians", "clips", "films", "exports", "studies", "fits")
"""Folders that contain the results of stages (see `demo.visitors`)."""
JOBS = 8
"""Number of jobs of each kind that are kept per visitor."""
PICTURES, FEW = 32, 8
"""Number of uploads and number of cut-outs that are kept per visitor, and the number that are kept
until results are removed if disk space is short.
"""


class Visitor:
    """The folder and the jobs of a visitor."""

    def __init__(self, folder: Path, address: str = "") -> None:
        self.folder, self.address = folder, address
        self.used = 0
        """Size of the visitor's files at the last measurement [bytes]."""
        self.promised = 0.0
        """Size of files that are being written [bytes]."""
        self.seen = time.monotonic()
        """Time of the visitor's last request [s]."""
        self.forecasts: dict[str, float] = {}
        """Run time predicted by a trial run [s], by `demo.work.trial_key`."""
        self.proportions: dict[str, Proportions | None] = {}
        """Proportions of the visitor's objects, by the file of the object's Gaussians."""
        self.jobs: dict[str, Job] = {}
        """The latest jobs by name, in the order in which they started."""
        self.shared: dict[str, Path] = {}
        """Files with a public link, by the token in the link."""
        for stage in ("uploads", *STAGES):
            (folder / stage).mkdir(parents=True, exist_ok=True)

    @property
    def busy(self) -> bool:
        """Whether a job of the visitor is running or waiting."""
        return self.unfinished > 0

    @property
    def unfinished(self) -> int:
        """Number of the visitor's jobs that are running or waiting."""
        return sum(not job.over for job in list(self.jobs.values()))

    @property
    def has_results(self) -> bool:
        """Whether this visitor has a clip."""
        return any((self.folder / "clips").glob("*"))

    @property
    def has_begun(self) -> bool:
        """Whether this visitor has done more than upload a file."""
        return bool(self.jobs) or self.has_results

    @property
    def silence(self) -> float:
        """Time since the visitor's last request [s]."""
        return time.monotonic() - self.seen

    def remember(self, job: Job) -> None:
        """Store a job, and remove finished jobs if there are more than `JOBS` of its kind.

        Jobs without a result are removed first, then the oldest jobs. Cancelled runs therefore do
        not displace results.
        """
        self.jobs[job.name] = job
        alike = [each for each in self.jobs.values() if each.kind == job.kind]
        over = sorted((j for j in alike if j.over), key=lambda j: j.progress.result is not None)
        for each in over[: max(0, len(alike) - JOBS)]:
            del self.jobs[each.name]

    def latest(self, *kinds: str) -> Job | None:
        """Return the latest job of the named kinds, or None if there is none."""
        return next((j for j in reversed(list(self.jobs.values())) if j.kind in kinds), None)

    def run_of(self, result: object) -> Job | None:
        """Return the latest run that produced this result, or None if there is none."""
        runs = [job for job in self.jobs.values() if job.kind == "run"]
        return next((j for j in reversed(runs) if result and j.progress.result == result), None)

    def stop(self, *kinds: str) -> None:
        """Cancel the jobs of the named kinds that are running or waiting; by default, all jobs."""
        for job in list(self.jobs.values()):
            if not kinds or job.kind in kinds:
                job.cancel()

    def touch(self) -> None:
        """Record that the visitor is still present."""
        self.seen = time.monotonic()

    def share(self, path: Path) -> str:
        """Return the unguessable token in the link to a file."""
        for token, known in self.shared.items():
            if known == path:
                return token
        token = secrets.token_urlsafe(16)
        self.shared[token] = path
        return token

    def new_stop_file(self) -> Path:
        """Return the path of a file whose existence tells a job to stop.

        On ZeroGPU, the job runs in another process.
        """
        return self.folder / f"stop-{secrets.token_hex(8)}"

    def measure(self) -> int:
        """Measure and return the size of the visitor's files [bytes]."""
        self.used = size_of(self.folder)
        return self.used

    def trim(self, room: Room) -> None:
        """Remove all but the latest results of each stage; if disk space is short, remove more."""
        for stage in ("uploads", *STAGES):
            entries = newest_first(self.folder / stage)
            # A clip may have videos of several views. A scene may need many pictures.
            most = {"uploads": PICTURES, "cutouts": PICTURES, "clips": room.clips}
            keep = most.get(stage, 3 * room.clips)
            for entry in entries[keep:]:
                remove(entry)
        for folder in newest_first(self.folder / "exports"):
            if not (self.folder / "films" / folder.name).exists():
                remove(folder)
        self.give_up(room.each)

    def give_up(self, most: float, keep: Collection[Path] = ()) -> bool:
        """Remove exports, pictures and results until at most `most` bytes are left.

        The oldest are removed first. The latest upload, the latest result of each stage and the
        paths in `keep` are not removed. Return whether the limit is met.
        """
        for path in self._oldest():
            if self.measure() <= most:
                return True
            if path not in keep:
                remove(path)
        return self.measure() <= most

    def _oldest(self) -> Iterator[Path]:
        if not self.busy:
            yield self.folder / "live"
        yield from sorted((self.folder / "exports").glob("*/*"), key=change_time)
        pictures = ("uploads", "cutouts")
        stages = [(stage, FEW) for stage in pictures]
        stages += [
            (stage, 1) for stage in ("fits", "films", "clips", "gaussians", "objects", *pictures)
        ]
        for stage, kept in stages:
            yield from reversed(newest_first(self.folder / stage)[kept:])
