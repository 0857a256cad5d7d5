"""Limits of the control groups of Linux that this process is in, as containers set them.

Versions 1 and 2 are read, also where both are mounted. A group's limit holds for all below it, so
the smallest on the way up counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

ROOT = Path("/")
"""Where the system's files are; tests choose a folder."""
RECLAIMED = ("inactive_file", "active_file", "total_inactive_file", "total_active_file")
"""Parts of a group's use that are copies of files, which the system gives back when asked."""


class Mount(NamedTuple):
    """A hierarchy of groups."""

    folder: Path
    """Where it is mounted."""
    top: str
    """The group that is mounted there; a container sees only its own."""
    version: int
    controllers: frozenset[str]
    """Those of version 1; version 2 has all in one hierarchy."""


def memory_left(root: Path = ROOT) -> float:
    """What the groups let this process take in addition [bytes]; infinity without a limit."""
    return min((_left(group) for group in _groups("memory", root)), default=math.inf)


def cpu_quota(root: Path = ROOT) -> float:
    """How many processors' time the groups let this process use; infinity without a limit."""
    return min((_quota(group) for group in _groups("cpu", root)), default=math.inf)


def _left(group: Path) -> float:
    """Limit minus use of one group [bytes], with what can be reclaimed counted as free."""
    for limit, use in (
        ("memory.max", "memory.current"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes"),
    ):
        most, taken = _number(group / limit), _number(group / use)
        if math.isfinite(most) and math.isfinite(taken):
            return max(0.0, most - max(0.0, taken - _reclaimable(group)))
    return math.inf


def _reclaimable(group: Path) -> float:
    """Copies of files in a group's use [bytes]; version 1 adds those of groups below as total_."""
    parts = dict(line.split() for line in _text(group / "memory.stat").splitlines())
    kept = {name: float(value) for name, value in parts.items() if name in RECLAIMED}
    totals = [value for name, value in kept.items() if name.startswith("total_")]
    return sum(totals or kept.values())


def _quota(group: Path) -> float:
    """Quota over period of one group."""
    quota, _, period = _text(group / "cpu.max").strip().partition(" ")
    if not period:
        quota, period = (_text(group / f"cpu.cfs_{name}_us") for name in ("quota", "period"))
    with suppress(ValueError, ZeroDivisionError):
        share = float(quota) / float(period)  # "max" and "-1" mean none
        return share if share > 0 else math.inf
    return math.inf


def _groups(controller: str, root: Path) -> Iterator[Path]:
    """Folders of the groups that control this process, each followed by the one above it."""
    own = dict(_own_groups(root))
    for mount in _mounts(root):
        if mount.version == 1 and controller not in mount.controllers:
            continue
        path = own.get(controller if mount.version == 1 else "")
        if path is None:
            continue
        folder = mount.folder / _below(path, mount.top)
        # A container may read its host's name of the group, which does not exist in there.
        folder = folder if folder.is_dir() and ".." not in folder.parts else mount.folder
        yield folder
        yield from (above for above in folder.parents if above.is_relative_to(mount.folder))


def _below(path: str, top: str) -> str:
    """The path of a group from the one that is mounted."""
    inside = path.removeprefix(top.rstrip("/")) if f"{path}/".startswith(f"{top}/") else path
    return inside.lstrip("/")


def _own_groups(root: Path) -> Iterator[tuple[str, str]]:
    """Each controller of version 1, and "" for version 2, with the path of this process's group."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        yield from ((one, path) for one in controllers.split(","))


def _mounts(root: Path) -> Iterator[Mount]:
    """All hierarchies that this process sees."""
    for line in _text(root / "proc/self/mountinfo").splitlines():
        fields, _, kind = line.partition(" - ")
        found = kind.split()
        if not found or found[0] not in ("cgroup", "cgroup2"):
            continue
        top, place = (part.replace("\\040", " ") for part in fields.split()[3:5])
        folder, version = root / place.lstrip("/"), 2 if found[0] == "cgroup2" else 1
        yield Mount(folder, top, version, frozenset(found[-1].split(",")))


def _number(path: Path) -> float:
    """The number in a file; infinity for "max" or without one."""
    with suppress(ValueError):
        return float(_text(path).replace("max", "inf"))
    return math.inf


def _text(path: Path) -> str:
    """The text of a file, or nothing."""
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""
