"""The files of each visitor: one folder with a name that cannot be guessed, and caches inside.

The result of a stage is stored under a key made of everything it depends on, so a stage runs again
exactly when something it depends on has changed:

    uploads/NAME                  pictures, videos and files of Gaussians as they were sent
    cutouts/KEY.png               picture, brush strokes
    objects/NAME/                 file of Gaussians
    gaussians/KEY.safetensors     cut-out or file, generator, seed
    clips/KEY/                    Gaussians and the scene without its view
    films/KEY/                    clip and view
    exports/KEY/                  formats made on demand, of the films of that name
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
import threading
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from phy124.errors import InputError

from .arrivals import Arrivals
from .room import Room, all_taken, is_plain_file, remove
from .visitor import STAGES, Visitor

if TYPE_CHECKING:
    from .line import Job

AWAY = 150.0
"""Silence after which a page counts as closed [s]; an open one reports every minute."""
UNUSED = 16
"""Visitors of one address who have begun nothing; of more, who has been silent longest goes."""
UNFINISHED = 3
"""Largest number of unfinished jobs of one visitor."""
FULL = "Too many visitors are here at once."
OF_ADDRESS = "Too many visitors from your address are here at once."


class Visitors:
    """All visitors by name; thread-safe."""

    def __init__(self, root: Path, room: Room | None = None) -> None:
        self.root, self.room = root, room or Room()
        self.arrivals = Arrivals(root / "arrivals", self.room)
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

    def has(self, name: str) -> bool:
        """Whether a visitor is known; asking is no sign of life."""
        return name in self._known

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

    def get(self, name: str, address: str = "") -> Visitor:
        """The visitor of that name, a new one if it is not known.

        Args:
            name: The visitor's name.
            address: Where the request comes from; empty: it is not known.

        Raises:
            InputError: There are too many visitors.
        """
        with self._lock:
            visitor = self.known(name)
            if visitor is None:
                self._admit(address)
                folder = self.root / secrets.token_urlsafe(24)
                visitor = self._known[name] = Visitor(folder, address)
            return visitor

    @property
    def used(self) -> float:
        """Size of everybody's files, with what is being written [bytes]; nothing is looked at."""
        with self._lock:
            each = sum(one.used + one.promised for one in [*self._known.values(), *self._leaving])
            return each + self.arrivals.size

    def store(
        self, name: str | None, data: bytes | BinaryIO, suffix: str, address: str = ""
    ) -> Path:
        """Store an upload.

        Args:
            name: The visitor's name; None: it belongs to nobody yet.
            data: The content, or a file with it.
            suffix: The suffix of the file's name.
            address: Where it comes from; empty: that is not known.

        Raises:
            InputError: There is no room for it.
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
                # Another visitor has needed the room meanwhile, and the folder is gone.
                raise _full(len(self)) from None
        return path

    @contextmanager
    def writing(
        self, visitor: Visitor, size: float, keep: Collection[Path] = (), most: float | None = None
    ) -> Iterator[None]:
        """Room for files of a visitor while they are written; older ones of the same visitor go.

        Args:
            visitor: Whose they are.
            size: How large they will be, about [bytes].
            keep: Files and folders that must stay.
            most: What everybody's files may take [bytes]; None: what runs leave to newcomers.

        Raises:
            InputError: There is too little room for them.
        """
        each = self.room.each
        fits = size <= each and visitor.give_up(each - size - visitor.promised, keep)
        if not fits:
            raise all_taken(size, each, "Send or ask for less.")
        with self._lock:
            self._claim(size, self.room.runs if most is None else most)
            visitor.promised += size
        try:
            yield
        finally:
            visitor.measure()
            with self._lock:
                visitor.promised -= size

    def own(self, name: str, given: Any) -> Path:
        """The visitor's own upload that a request names.

        Raises:
            InputError: It names anything else; the message is the same whether that exists or not.
        """
        visitor = self.get(name)
        path = visitor.folder / "uploads" / Path(str(given)).name
        if str(given) == str(self.arrivals.folder / path.name):
            # Of what one request names several times, the first time has moved it here.
            with self._lock:
                visitor.used += self.arrivals.hand_over(path)
        elif str(given) != str(path):
            path = path.parent
        if not is_plain_file(path):
            raise InputError(
                "picture", "unknown", "This picture is not here.", "Choose it once more."
            )
        return path

    def check_work(self, visitor: Visitor, most: int) -> None:
        """Check that a visitor may have another job, and so may all from the same address.

        Args:
            visitor: Who asks.
            most: Number of jobs that may wait in the queue; one address may have half of them.

        Raises:
            InputError: There are too many unfinished ones.
        """
        if visitor.unfinished >= UNFINISHED:
            raise InputError("queue", "yours", "You have work waiting.", "Let it end or cancel it.")
        with self._lock:
            beside = [one for one in self._known.values() if one.address == visitor.address]
        if visitor.address and sum(one.unfinished for one in beside) >= max(most // 2, UNFINISHED):
            limit = "Too much work from your address is waiting: the queue is full for it."
            raise InputError("queue", "full", limit, "Try again soon.")

    def remove(self, name: str) -> None:
        """Stop a visitor's jobs and remove the folder."""
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
        """Remove the folders of those who have left, once no job looks for a stop file there."""
        with self._lock:
            ended = [visitor for visitor in self._leaving if not visitor.busy]
            self._leaving = [visitor for visitor in self._leaving if visitor.busy]
        for visitor in ended:
            remove(visitor.folder)

    def sweep(self) -> None:
        """Remove who has been silent for too long and what nobody has claimed, and measure."""
        with self._lock:
            silent = [n for n, v in self._known.items() if v.silence > self.room.grace]
        for name in silent:
            self.remove(name)
        self._clear()
        with self._lock:
            here = [*self._known.values(), *self._leaving]
            kept = {visitor.folder for visitor in here} | {self.arrivals.folder}
            for folder in self.root.iterdir():
                if folder not in kept:
                    remove(folder)
            self.arrivals.sweep()
        for visitor in here:
            visitor.measure()

    def close(self) -> None:
        """Stop all jobs and remove everything."""
        for name in list(self._known):
            self.remove(name)
        remove(self.root)

    def _admit(self, address: str) -> None:
        """Make sure that there is a place for a newcomer.

        Raises:
            InputError: There is none, here or for this address.
        """
        beside = [one for one in self._known.items() if address and one[1].address == address]
        unused = [one for one in beside if not one[1].has_begun]
        if len(unused) >= UNUSED or (len(beside) >= self.room.address and unused):
            self.remove(_most_silent(unused))
        elif len(beside) >= self.room.address:
            raise InputError("visitors", len(beside), OF_ADDRESS, "Try again in a few minutes.")
        while len(self._known) >= self.room.visitors:
            self._make_room()

    def _claim(self, size: float, most: float) -> None:
        """Make sure that so many bytes more fit; uploads that nobody has used go.

        Raises:
            InputError: They do not fit.
        """
        while self.used + size > most:
            if not self.arrivals.drop():
                self._make_room()

    def _make_room(self) -> None:
        """Remove a visitor who has begun nothing, of the address that has most of them.

        Raises:
            InputError: There is none.
        """
        idle = [(n, v) for n, v in self._known.items() if not v.has_begun and v.silence > 1]
        if not idle:
            raise _full(len(self))
        count = Counter(visitor.address for _, visitor in idle)
        most = max(count.values())
        self.remove(_most_silent([one for one in idle if count[one[1].address] == most]))


def _most_silent(visitors: list[tuple[str, Visitor]]) -> str:
    return max(visitors, key=lambda entry: entry[1].silence)[0]


def _full(count: int) -> InputError:
    return InputError("visitors", count, FULL, "Try again in a few minutes.")


def _write(path: Path, file: BinaryIO) -> None:
    with open(path, "wb") as stored:
        shutil.copyfileobj(file, stored)


def key(*parts: Any) -> str:
    """A name for something that depends only on these parts, which are bytes or JSON-like data."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else json.dumps(part, sort_keys=True).encode()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()[:32]
