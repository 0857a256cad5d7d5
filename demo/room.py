"""Room for visitors' files: how much there is, and what lies in a folder."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from phy124.errors import InputError


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
    address: int = 32
    """Number of visitors of one address."""

    @property
    def runs(self) -> float:
        """What uploads, runs and exports may take together; the rest is for newcomers' pictures."""
        return 0.9 * self.all

    @property
    def arrivals(self) -> float:
        """What uploads may take whose visitor is not known yet."""
        return 0.25 * self.all


def all_taken(size: float, each: float, remedy: str) -> InputError:
    """The error of a visitor whose own files take all the room there is for one."""
    limit = "Your files take all the room here."
    if size > each:
        sizes = f"{size / 1e6:,.0f} MB; your files may take {each / 1e6:,.0f} MB"
        limit = f"It would take about {sizes} here."
    return InputError("room", "full", limit, remedy)


def is_plain_file(path: Path) -> bool:
    """Whether the path is a regular file and not a link to one."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except (OSError, ValueError):
        return False


def size_of(folder: Path) -> int:
    """Size of all files in a folder [bytes]."""
    return sum(_sizes(folder))


def _sizes(folder: Path) -> Iterator[int]:
    for place, _, names in os.walk(folder):
        for name in names:
            try:
                yield os.lstat(os.path.join(place, name)).st_size
            except OSError:
                continue


def newest_first(folder: Path) -> list[Path]:
    """What lies in a folder, what was changed last first."""
    try:
        return sorted(folder.iterdir(), key=changed, reverse=True)
    except OSError:
        return []


def changed(path: Path) -> float:
    """When a file was changed [s]; 0 if it is gone."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def remove(path: Path) -> None:
    """Remove a file, or a folder with all that is in it."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
