"""Limit the disk space of visitors' files, and keep uploads whose visitor is unknown."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from phy124.errors import InputError

EACH = 64
"""Largest number of unclaimed uploads per address. If there are more, the oldest are removed."""
ARRIVED = 600.0
"""Longest time between an upload and the request that names it [s]."""


@dataclass(frozen=True)
class Room:
    """Limits on the number, the size and the age of stored files."""

    visitors: int = 64
    clips: int = 3
    """Largest number of results per visitor."""
    grace: float = 900.0
    """Time without requests after which the files of a visitor are removed [s]."""
    each: float = 1e9
    """Largest total size of a visitor's files [bytes]."""
    all: float = 8e9
    """Largest total size of all visitors' files [bytes]."""
    address: int = 32
    """Largest number of visitors per address."""

    @property
    def runs(self) -> float:
        """Largest total size of uploads, runs and exports [bytes]; the rest is for new visitors."""
        return 0.9 * self.all

    @property
    def arrivals(self) -> float:
        """Size limit for uploads whose visitor is not known yet [bytes]."""
        return 0.25 * self.all


def all_taken(size: float, each: float, remedy: str) -> InputError:
    """Return the error for a visitor whose disk space does not suffice for `size` [bytes]."""
    limit = "Your storage on this server is full."
    if size > each:
        sizes = f"{size / 1e6:,.0f} MB; your limit is {each / 1e6:,.0f} MB"
        limit = f"The files would need about {sizes}."
    return InputError("room", "full", limit, remedy)


def is_plain_file(path: Path) -> bool:
    """Return whether the path is a regular file (and not a link)."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except (OSError, ValueError):
        return False


def size_of(folder: Path) -> int:
    """Return the size of all files in a folder [bytes]."""
    return sum(_sizes(folder))


def _sizes(folder: Path) -> Iterator[int]:
    for place, _, names in os.walk(folder):
        for name in names:
            try:
                yield os.lstat(os.path.join(place, name)).st_size
            except OSError:
                continue


def newest_first(folder: Path) -> list[Path]:
    """List the entries of a folder, with the most recently changed entry first."""
    try:
        return sorted(folder.iterdir(), key=change_time, reverse=True)
    except OSError:
        return []


def change_time(path: Path) -> float:
    """Return the time of a file's last change [s]; 0 if the file no longer exists."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def renew(path: Path) -> None:
    """Set the time of a file's last use to the present; the oldest files are removed first."""
    with suppress(OSError):  # the entry no longer exists
        os.utime(path)


def remove(path: Path) -> None:
    """Remove a file, or a folder with its content."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@dataclass(frozen=True)
class _Upload:
    address: str
    size: int
    at: float = field(default_factory=time.monotonic)


class Arrivals:
    """Uploads of programs without cookies. Each upload is kept until a request names it.

    The disk space for such uploads is small, and limited per address. Callers must hold the lock of
    `demo.visitors`.
    """

    def __init__(self, folder: Path, room: Room) -> None:
        self.folder, self._room = folder, room
        self._uploads: dict[str, _Upload] = {}
        """Uploads by file name, with the oldest upload first."""
        folder.mkdir(parents=True, exist_ok=True)

    def __len__(self) -> int:
        return len(self._uploads)

    @property
    def size(self) -> int:
        """Total size of the uploads [bytes]."""
        return sum(upload.size for upload in self._uploads.values())

    def announce(self, address: str, size: int, suffix: str) -> Path:
        """Return the path for a new upload; remove the oldest uploads beyond the limits."""
        of_address = [name for name, u in self._uploads.items() if u.address == address]
        for name in of_address[: len(of_address) + 1 - EACH if len(of_address) >= EACH else 0]:
            self._drop(name)
        while self._uploads and self.size + size > self._room.arrivals:
            self.drop()
        name = f"{secrets.token_urlsafe(18)}{suffix}"
        self._uploads[name] = _Upload(address, size)
        return self.folder / name

    def hand_over(self, path: Path) -> int:
        """Move an upload to `path` in its visitor's folder; return its size."""
        upload = self._uploads.pop(path.name, None)
        with suppress(OSError, ValueError):
            os.rename(self.folder / path.name, path)
        return upload.size if upload else 0

    def drop(self) -> bool:
        """Remove the oldest upload of the address that stores most. Return False if there is no
        upload.
        """
        if not self._uploads:
            return False
        sizes: Counter[str] = Counter()
        for upload in self._uploads.values():
            sizes[upload.address] += upload.size
        most = sizes.most_common(1)[0][0]
        self._drop(next(name for name, u in self._uploads.items() if u.address == most))
        return True

    def sweep(self) -> None:
        """Remove uploads that no request named within the time limit; create a missing folder."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for name in [n for n, u in self._uploads.items() if time.monotonic() - u.at > ARRIVED]:
            self._drop(name)

    def _drop(self, name: str) -> None:
        del self._uploads[name]
        remove(self.folder / name)
