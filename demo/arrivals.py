"""Uploads of programs that keep no cookies: they belong to nobody until a request names them."""

from __future__ import annotations

import os
import secrets
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from .room import Room, remove

EACH = 64
"""Number of uploads of one address; of more, the newest stay."""
ARRIVED = 600.0
"""Longest time between an upload and the request that uses it [s]."""


@dataclass(frozen=True)
class _Upload:
    address: str
    size: int
    at: float = field(default_factory=time.time)


class Arrivals:
    """Uploads that nobody has used yet, with little room and a limit for each address.

    Who calls it holds the lock of `demo.visitors`.
    """

    def __init__(self, folder: Path, room: Room) -> None:
        """Make the folder.

        Args:
            folder: Where they lie.
            room: How much room there is for all files.
        """
        self.folder, self._room = folder, room
        self._uploads: dict[str, _Upload] = {}
        """By the name of the file, the oldest first."""
        folder.mkdir(parents=True, exist_ok=True)

    def __len__(self) -> int:
        return len(self._uploads)

    @property
    def size(self) -> int:
        """Size of all [bytes]."""
        return sum(upload.size for upload in self._uploads.values())

    def announce(self, address: str, size: int, suffix: str) -> Path:
        """Where an upload is to be written; older ones go if there are too many or no room."""
        of_address = [name for name, one in self._uploads.items() if one.address == address]
        for name in of_address[: len(of_address) + 1 - EACH if len(of_address) >= EACH else 0]:
            self._drop(name)
        while self._uploads and self.size + size > self._room.arrivals:
            self.drop()
        name = f"{secrets.token_urlsafe(18)}{suffix}"
        self._uploads[name] = _Upload(address, size)
        return self.folder / name

    def hand_over(self, path: Path) -> int:
        """Move an upload to the path of the same name in its visitor's folder; returns its size."""
        upload = self._uploads.pop(path.name, None)
        with suppress(OSError, ValueError):
            os.rename(self.folder / path.name, path)
        return upload.size if upload else 0

    def drop(self) -> bool:
        """Remove the oldest upload of the address that has most; returns False if there is none."""
        if not self._uploads:
            return False
        sizes: Counter[str] = Counter()
        for upload in self._uploads.values():
            sizes[upload.address] += upload.size
        most = sizes.most_common(1)[0][0]
        self._drop(next(name for name, one in self._uploads.items() if one.address == most))
        return True

    def sweep(self) -> None:
        """Remove those that nobody has used in time."""
        for name in [n for n, one in self._uploads.items() if time.time() - one.at > ARRIVED]:
            self._drop(name)

    def _drop(self, name: str) -> None:
        del self._uploads[name]
        remove(self.folder / name)
