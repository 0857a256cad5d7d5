"""Reads the memory and CPU limits that Linux control groups (containers) set for this process.

A group's limit applies to all groups below it, so the effective limit is the smallest limit on the
path to the root group.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

ROOT = Path("/")
"""Root of the file system; tests replace the root by a temporary folder."""
RECLAIMED = ("inactive_file", "active_file", "total_inactive_file", "total_active_file")
"""Entries of memory.stat that count memory of cached files, which the system can reclaim."""


class Mount(NamedTuple):
    """A mounted hierarchy of control groups."""

    folder: Path
    """Mount point."""
    top: str
    """The group at the mount point; in a container, this is the container's group."""
    version: int
    controllers: frozenset[str]
    """Controllers of a hierarchy of version 1; in version 2, a single hierarchy has all
    controllers.
    """


def memory_left(root: Path = ROOT) -> float:
    """Return the memory this process may use according to its groups [bytes]; inf: unlimited."""
    return min((_left(group) for group in _groups("memory", root)), default=math.inf)


def cpu_quota(root: Path = ROOT) -> float:
    """Return the number of CPUs this process may use according to its groups; inf: unlimited."""
    return min((_quota(group) for group in _groups("cpu", root)), default=math.inf)


def _left(group: Path) -> float:
    """Return the memory that a group may still use [bytes]; reclaimable memory counts as free."""
    for limit, use in (
        ("memory.max", "memory.current"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes"),
    ):
        most, taken = _number(group / limit), _number(group / use)
        if math.isfinite(most) and math.isfinite(taken):
            return max(0.0, most - max(0.0, taken - _reclaimable(group)))
    return math.inf


def _reclaimable(group: Path) -> float:
    """Return the memory of cached files in a group [bytes].

    In version 1, entries with the prefix total_ include the subgroups.
    """
    parts = dict(line.split() for line in _text(group / "memory.stat").splitlines())
    kept = {name: float(value) for name, value in parts.items() if name in RECLAIMED}
    totals = [value for name, value in kept.items() if name.startswith("total_")]
    return sum(totals or kept.values())


def _quota(group: Path) -> float:
    quota, _, period = _text(group / "cpu.max").strip().partition(" ")
    if not period:
        quota, period = (_text(group / f"cpu.cfs_{name}_us") for name in ("quota", "period"))
    with suppress(ValueError, ZeroDivisionError):
        share = float(quota) / float(period)  # "max" and "-1" mean no limit
        return share if share > 0 else math.inf
    return math.inf


def _groups(controller: str, root: Path) -> Iterator[Path]:
    """Yield the folders of this process's groups, each followed by its parent folders."""
    paths = dict(_own_groups(root))
    for mount in _mounts(root):
        if mount.version == 1 and controller not in mount.controllers:
            continue
        path = paths.get(controller if mount.version == 1 else "")
        if path is None:
            continue
        folder = mount.folder / _below(path, mount.top)
        # In a container, /proc may show the host's path, which does not exist in the container.
        folder = folder if folder.is_dir() and ".." not in folder.parts else mount.folder
        yield folder
        yield from (above for above in folder.parents if above.is_relative_to(mount.folder))


def _below(path: str, top: str) -> str:
    inside = path.removeprefix(top.rstrip("/")) if f"{path}/".startswith(f"{top}/") else path
    return inside.lstrip("/")


def _own_groups(root: Path) -> Iterator[tuple[str, str]]:
    """Yield each controller with this process's group; in version 2, the controller is ""."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        yield from ((controller, path) for controller in controllers.split(","))


def _mounts(root: Path) -> Iterator[Mount]:
    for line in _text(root / "proc/self/mountinfo").splitlines():
        fields, _, kind = line.partition(" - ")
        words = kind.split()
        if not words or words[0] not in ("cgroup", "cgroup2"):
            continue
        top, place = (part.replace("\\040", " ") for part in fields.split()[3:5])
        folder, version = root / place.lstrip("/"), 2 if words[0] == "cgroup2" else 1
        yield Mount(folder, top, version, frozenset(words[-1].split(",")))


def _number(path: Path) -> float:
    """Return the number in a file; infinity if the file contains "max" or no number."""
    with suppress(ValueError):
        return float(_text(path).replace("max", "inf"))
    return math.inf


def _text(path: Path) -> str:
    """Return the text of a file; empty if the file cannot be read."""
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""
