"""The folder that stores visitors' files while the page runs.

The folder is removed when the page ends or, if the page is killed, by the next page. File locks
show which folders are in use. Windows has no such locks, so folders of killed pages remain there,
and two pages can use the same folder by mistake.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phy124.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PREFIX = "phy124-web-"
LOCK = "phy124-page.lock"
"""The file that marks a folder as the page's: the page deletes everything else in it."""
NO_LINKS = getattr(os, "O_NOFOLLOW", 0)


@contextmanager
def lock_folder(wanted: str = "") -> Iterator[Path]:
    """Lock a folder for this page, empty the folder, and remove it when the page ends.

    If `wanted` is empty, a new temporary folder is made.

    Raises:
        InputError: Another page uses the folder, or the folder contains other files.
    """
    if not wanted:
        _sweep(Path(tempfile.gettempdir()))
    root = Path(os.path.expanduser(wanted) or tempfile.mkdtemp(prefix=PREFIX)).absolute()
    root.mkdir(parents=True, exist_ok=True)
    strangers = [] if (root / LOCK).exists() else sorted(path.name for path in root.iterdir())
    lock = _lock(root)
    if lock is None:
        raise InputError(
            "PHY124_FOLDER", root, "another page uses this folder.", "Choose another one."
        )
    try:
        if strangers:
            (root / LOCK).unlink(missing_ok=True)
            limit = f"it holds other files, such as {strangers[0]}."
            remedy = "Give an empty folder, since the page deletes everything in it."
            raise InputError("PHY124_FOLDER", root, limit, remedy)
        _empty(root)
        try:
            yield root
        finally:
            _empty(root)
    finally:
        os.close(lock)  # Windows cannot remove an open file
        if not wanted:
            shutil.rmtree(root, ignore_errors=True)


def _sweep(folder: Path) -> None:
    if fcntl is None:
        return
    for left in folder.glob(f"{PREFIX}*"):
        if left.is_symlink() or not left.is_dir() or left.stat().st_uid != os.getuid():
            continue
        lock = _lock(left) if (left / LOCK).exists() else None
        if lock is not None:
            shutil.rmtree(left, ignore_errors=True)
            os.close(lock)


def _lock(folder: Path) -> int | None:
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | NO_LINKS, 0o600)
    except OSError:
        return None
    try:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


def _empty(root: Path) -> None:
    for path in root.iterdir():
        if path.name == LOCK:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
