"""Files of visitors: each visitor has a folder whose name cannot be guessed.

The folder stores the result of a stage under a key, which is a hash of the stage's inputs. A stage
therefore runs again only if an input has changed. Each line shows a path and the inputs that its
key depends on:

    uploads/NAME                  pictures, videos and files of Gaussians, as sent
    cutouts/KEY.png               picture, brush strokes
    objects/NAME/                 file of Gaussians
    gaussians/KEY.safetensors     cut-out or file, generator, seed
    clips/KEY/                    Gaussians and the scene without its view
    films/KEY/                    clip and view
    exports/KEY/                  formats made on demand from the clip of films/KEY
    studies/KEY.json              Gaussians and the scene without its view and grid
    fits/CLIP-KEY/                clip, view, video, and options of the fit

A folder is kept while its visitor sends requests (an open page sends one every minute), and for a
grace period after the last request.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import secrets
import shutil
import threading
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from phy124.errors import InputError
from phy124.runtime.failures import Kind, failure

from .room import Arrivals, Room, all_taken, is_plain_file, remove, renew
from .visitor import STAGES, Visitor

if TYPE_CHECKING:
    from .line import Job

AWAY = 150.0
"""Time without requests after which a page counts as closed [s]; pages send one every minute."""
UNUSED = 16
"""Largest number of idle visitors per address; visitors that have been idle longest are removed."""
UNFINISHED = 3
FULL = "Too many visitors use this server at the moment."
OF_ADDRESS = "Too many visitors from your address are here at once."


class Visitors:
    """All visitors by name; thread-safe."""

    def __init__(self, root: Path, room: Room | None = None) -> None:
        self.root, self.room = root, room or Room()
        self.arrivals = Arrivals(root / "arrivals", self.room)
        self._lock = threading.RLock()
        self._known: dict[str, Visitor] = {}
        self._leaving: list[Visitor] = []
        """Removed visitors whose jobs are still running."""
        self._asking: Counter[str] = Counter()
        """Number of requests that are being processed, by the visitor's name."""

    def __len__(self) -> int:
        return len(self._known)

    def find(self, name: str) -> Visitor | None:
        """Return the visitor with a name, or None; the call counts as a request of the visitor."""
        with self._lock:
            visitor = self._known.get(name)
            if visitor is not None:
                visitor.touch()
            return visitor

    @contextmanager
    def asking(self, name: str) -> Iterator[None]:
        """Keep a visitor's files while a request of the visitor waits or is processed."""
        with self._lock:
            self._asking[name] += 1
        try:
            yield
        finally:
            with self._lock:
                self._asking[name] -= 1
                if not self._asking[name]:
                    del self._asking[name]
            self.find(name)

    def has(self, name: str) -> bool:
        """Return whether a visitor with this name is known; this does not count as a request."""
        return name in self._known

    def is_here(self, name: str | None) -> bool:
        """Return whether a visitor's page is open; this does not count as a request."""
        visitor = self._known.get(name or "")
        return visitor is not None and visitor.silence < AWAY

    def job(self, name: str) -> Job | None:
        """Return the job with a secret name; the call counts as a request of the job's visitor."""
        with self._lock:
            visitor = next((v for v in self._known.values() if name in v.jobs), None)
            if visitor is None:
                return None
            visitor.touch()
            return visitor.jobs[name]

    def find_shared(self, token: str) -> Path | None:
        """Return the file of a public link, or None; this does not count as a request."""
        with self._lock:
            paths = (v.shared[token] for v in self._known.values() if token in v.shared)
            path = next(paths, None)
        return path if path is not None and path.exists() else None

    def get(self, name: str, address: str = "") -> Visitor:
        """Return the visitor with a name; create the visitor if necessary.

        `address` is the address that sent the request; empty if it is unknown.

        Raises:
            InputError: There are too many visitors.
        """
        with self._lock:
            visitor = self.find(name)
            if visitor is None:
                self._admit(address)
                folder = self.root / secrets.token_urlsafe(24)
                visitor = self._known[name] = Visitor(folder, address)
            return visitor

    def expect(self, name: str) -> Visitor:
        """Return the visitor with a name; the call counts as a request of the visitor.

        Raises:
            InputError: There is no such visitor, for example because the visitor was removed.
        """
        visitor = self.find(name)
        if visitor is None:
            raise _unknown()
        return visitor

    @property
    def used(self) -> float:
        """Size of all files at the last measurement, including files being written [bytes]."""
        with self._lock:
            visitors = [*self._known.values(), *self._leaving]
            return sum(v.used + v.promised for v in visitors) + self.arrivals.size

    def store(
        self, name: str | None, data: bytes | BinaryIO, suffix: str, address: str = ""
    ) -> Path:
        """Store an upload.

        Args:
            name: The visitor's name; None if the visitor is not known yet.
            data: The content, or a file that contains it.
            suffix: The suffix of the file's name.
            address: Address that sent the request; empty if it is unknown.

        Raises:
            InputError: The upload does not fit into the disk space.
        """
        file = io.BytesIO(data) if isinstance(data, bytes) else data
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        if name is None:
            with self._lock:
                self._claim(size, self.room.all)
                path = self.arrivals.announce(address, size, suffix)
            _write(path, file)
            return path
        visitor = self.get(name, address)
        visitor.trim(self.room)
        with self.writing(visitor, size, most=self.room.all):
            path = visitor.folder / "uploads" / f"{secrets.token_urlsafe(18)}{suffix}"
            try:
                _write(path, file)
            except FileNotFoundError:
                # The folder was removed in the meantime to free disk space for another visitor.
                raise _full(len(self)) from None
        return path

    @contextmanager
    def writing(
        self, visitor: Visitor, size: float, keep: Collection[Path] = (), most: float | None = None
    ) -> Iterator[None]:
        """Reserve disk space for files while they are written; if necessary, remove older files.

        Args:
            visitor: The visitor.
            size: Approximate size of the files [bytes].
            keep: Files and folders that must not be removed.
            most: Limit on the size of all files [bytes]. If None, the limit for runs applies.

        Raises:
            InputError: The files do not fit into the disk space.
        """
        each = self.room.each
        fits = size <= each and visitor.give_up(each - size - visitor.promised, keep)
        if not fits:
            raise all_taken(size, each, "Send or request less data.")
        with self._lock:
            self._claim(size, self.room.runs if most is None else most)
            visitor.promised += size
        try:
            yield
        finally:
            visitor.measure()
            with self._lock:
                visitor.promised -= size

    def find_upload(self, name: str, requested: Any) -> Path:
        """Return the upload of a visitor at a requested path.

        Raises:
            InputError: The path is not an upload of the visitor (the message does not reveal
                whether the path exists), or the upload does not fit into the disk space.
        """
        visitor = self.expect(name)
        path = visitor.folder / "uploads" / Path(str(requested)).name
        if str(requested) == str(self.arrivals.folder / path.name):
            # The first request that names an upload moves the upload to this path.
            with self._lock:
                size = self.arrivals.hand_over(path)
                visitor.used += size
            renew(path)
            visitor.trim(self.room)
            if visitor.used > self.room.each:
                remove(path)
                visitor.measure()
                raise all_taken(size, self.room.each, "Send or request less data.")
        elif str(requested) != str(path):
            path = path.parent
        if not is_plain_file(path):
            raise _unknown()
        renew(path)
        return path

    def check_work(self, visitor: Visitor, most: int) -> None:
        """Check that neither the visitor nor the visitor's address has reached the limit of jobs.

        `most` is the largest number of waiting jobs of all addresses. A single address may have up
        to half of this number.

        Raises:
            InputError: There are too many unfinished jobs.
        """
        if visitor.unfinished >= UNFINISHED:
            raise InputError("queue", "yours", "You have work waiting.", "Let it end or cancel it.")
        with self._lock:
            unfinished = sum(
                v.unfinished for v in self._known.values() if v.address == visitor.address
            )
        if visitor.address and unfinished >= max(most // 2, UNFINISHED):
            limit = "Too many requests from your network are waiting."
            raise InputError("queue", "full", limit, "Try again soon.")

    def remove(self, name: str) -> None:
        """Stop a visitor's jobs, and remove the visitor's folder."""
        with self._lock:
            visitor = self._known.pop(name, None)
        if visitor is not None:
            visitor.stop()
            for stage in ("uploads", *STAGES, "live"):
                remove(visitor.folder / stage)
            with self._lock:
                self._leaving.append(visitor)
            self._clear()

    def _clear(self) -> None:
        with self._lock:
            ended = [visitor for visitor in self._leaving if not visitor.busy]
            self._leaving = [visitor for visitor in self._leaving if visitor.busy]
        for visitor in ended:
            remove(visitor.folder)

    def sweep(self, late: float = 0.0) -> None:
        """Remove idle visitors and unclaimed files, and measure the files of all other visitors.

        If another program has removed a visitor's folder, the visitor is also removed; the
        visitor's page then uploads the files again. For `late` seconds since the last call, the
        server could not process requests, for example because it was suspended; this time does not
        count as idle time.
        """
        with self._lock:
            for visitor in self._known.values():
                visitor.seen += late
            absent = {n: v for n, v in self._known.items() if not self._asking[n]}
            ended = [n for n, v in absent.items() if v.silence > self.room.grace]
            ended += [n for n, v in self._known.items() if not v.folder.is_dir()]
        for name in ended:
            self.remove(name)
        self._clear()
        with self._lock:
            here = [*self._known.values(), *self._leaving]
            kept = {visitor.folder for visitor in here} | {self.arrivals.folder}
            self.arrivals.sweep()
            for folder in self.root.iterdir():
                if folder not in kept:
                    remove(folder)
        for visitor in here:
            visitor.measure()

    def close(self) -> None:
        """Stop all jobs and remove all files."""
        for name in list(self._known):
            self.remove(name)
        remove(self.root)

    def _admit(self, address: str) -> None:
        present = [(n, v) for n, v in self._known.items() if address and v.address == address]
        idle = [(n, v) for n, v in present if not v.has_begun]
        if len(idle) >= UNUSED or (len(present) >= self.room.address and idle):
            self.remove(_most_silent(idle))
        elif len(present) >= self.room.address:
            raise InputError("visitors", len(present), OF_ADDRESS, "Try again in a few minutes.")
        while len(self._known) >= self.room.visitors:
            self._make_room()

    def _claim(self, size: float, most: float) -> None:
        """Free disk space: remove unclaimed uploads first, then idle visitors."""
        while self.used + size > most:
            if not self.arrivals.drop():
                self._make_room()

    def _make_room(self) -> None:
        """Remove the visitor who has been idle longest at the address with most idle visitors."""
        idle = [(n, v) for n, v in self._known.items() if not v.has_begun and v.silence > 1]
        if not idle:
            raise _full(len(self))
        count = Counter(visitor.address for _, visitor in idle)
        most = max(count.values())
        self.remove(_most_silent([(n, v) for n, v in idle if count[v.address] == most]))


def _most_silent(visitors: list[tuple[str, Visitor]]) -> str:
    return max(visitors, key=lambda entry: entry[1].silence)[0]


def _unknown() -> InputError:
    limit = "The server does not have this picture."
    return InputError("picture", "unknown", limit, "Choose it again.")


def _full(count: int) -> InputError:
    return InputError("visitors", count, FULL, "Try again in a few minutes.")


def _write(path: Path, file: BinaryIO) -> None:
    try:
        with open(path, "wb") as stored:
            shutil.copyfileobj(file, stored)
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        if failure(error).kind is Kind.DISK:
            limit = "The disk of this server is full."
            raise InputError("room", "full", limit, "Try again later.") from error
        raise


def key(*parts: Any) -> str:
    """Return a hash of the parts (bytes or JSON-like data), for use as a file name."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()[:32]
