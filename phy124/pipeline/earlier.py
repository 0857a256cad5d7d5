"""Results that an earlier run left in the folder of a new one: they go once the new ones are there.

Only what the earlier report lists as written by its run is removed; what a user put there stays.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

REPORT = "report.json"
LONGEST = 1 << 26
"""Largest report that is read [bytes]; a usual one has 10,000."""


def listed(folder: Path) -> set[str]:
    """Names of what the run that wrote the report in a folder left there; none without a report."""
    path = folder / REPORT
    try:
        report = json.loads(path.read_bytes()) if path.stat().st_size <= LONGEST else {}
        names = report.get("files", [])
        return {name for name in names if isinstance(name, str) and _is_plain(name)}
    except (OSError, ValueError, RecursionError, AttributeError, TypeError):
        return set()


def remove(folder: Path, names: Iterable[str]) -> None:
    """Remove files and folders of these names from a folder, as far as they are there."""
    for name in names:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _is_plain(name: str) -> bool:
    """Whether a name stays within its folder: a report may come from anywhere."""
    return name not in ("", ".", "..") and "\0" not in name and Path(name).name == name
