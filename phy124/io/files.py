"""Output files appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from phy124.errors import InputError
from phy124.io.destinations import beginning, put, real

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PathLike = str | os.PathLike[str]
MAKING = ".making-"
"""Prefix of folders that are still being filled."""


@contextmanager
def staged(out: PathLike) -> Iterator[Path]:
    """A temporary folder whose files are moved into `out` if all goes well.

    If something fails, folders that were created for it are removed again, unless somebody else
    uses them by then. Leftovers of killed processes in `out` are removed as well.

    Raises:
        InputError: If `out` cannot be a folder.
    """
    out, missing = Path(out), []
    try:
        made = real(out)
        missing = [path for path in (made, *made.parents) if not path.exists()]
        made.mkdir(parents=True, exist_ok=True)
        with _locked(out):
            _sweep(out)
            folder = Path(tempfile.mkdtemp(prefix=MAKING, dir=out))
            lock = _lock(folder)
    except OSError as error:
        _remove_empty(missing)
        why = "it is a file" if out.is_file() else f"it cannot be written ({error.strerror})"
        raise InputError("out", out, f"{why}.", "Choose another folder.") from None
    try:
        yield folder
        for path in sorted(folder.iterdir()):
            put(path, out / path.name)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unlock(lock)
        _remove_empty(missing)


def _sweep(out: Path) -> None:
    """Remove the folders of processes that have ended: their locks ended with them."""
    for folder in out.glob(f"{MAKING}*"):
        lock = _lock(folder)
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
        _unlock(lock)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a lock under which one process at a time cleans up a folder or adds to it."""
    lock = _lock(folder, wait=True)
    try:
        yield
    finally:
        _unlock(lock)


def _lock(folder: Path, *, wait: bool = False) -> int | None:
    """A lock that ends with this process; None if another holds it or locks are unavailable."""
    if fcntl is None:
        return None
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            return descriptor
        except OSError:
            os.close(descriptor)
    return None


def _unlock(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def writable(folder: Path) -> bool:
    """Whether files can be written into a folder, which may still have to be created."""
    for path in (folder, *folder.parents):
        if os.path.lexists(path):
            return path.is_dir() and os.access(path, os.W_OK | os.X_OK)
    return False


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders, innermost first, as long as they are empty."""
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()


@contextmanager
def replacing(path: PathLike) -> Iterator[Path]:
    """A temporary file to write to; it takes the place of `path` if all goes well.

    If `path` is a link, it takes the place of the file that the link leads to; a device or a pipe
    is written into. The file's mode is that of a new file.

    If the block ends early for any reason, including an interrupt, the temporary file is removed
    and an older file at `path` is left as it was.

    Raises:
        InputError: If the folder is missing or the file cannot be written.
    """
    path = Path(path)
    try:
        temporary = beginning(path)
    except OSError as error:
        raise InputError(
            "output",
            path,
            f"no file can be written there ({error.strerror}).",
            "Give a file name in a folder that exists and that you may write to.",
        ) from error
    try:
        yield temporary
        put(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
