"""Output files appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from phy124.errors import SHORT_CODES, Incomplete, InputError
from phy124.io.destinations import PARTS, beginning, put, real
from phy124.io.locks import lock, locked, unlock

PathLike = str | os.PathLike[str]
MAKING = ".making-"
"""Prefix of folders that are still being filled."""


@contextmanager
def staged(out: PathLike, *, keeps: bool = False) -> Iterator[Path]:
    """A temporary folder whose files are moved into `out` if all goes well.

    If something fails, folders that were created for it are removed again, unless somebody else
    uses them by then. Leftovers of killed processes in `out` are removed as well.

    Args:
        out: The folder to fill.
        keeps: Whether files that are whole by then are moved even if something fails.

    Raises:
        InputError: If `out` cannot be a folder.
        OSError: If there is no room.
        Incomplete: Something failed, and `keeps` has kept some files.
    """
    out, missing = Path(out), []
    try:
        made = real(out)
        missing = [path for path in (made, *made.parents) if not path.exists()]
        made.mkdir(parents=True, exist_ok=True)
        with locked(made):
            _sweep(out)
            folder = Path(tempfile.mkdtemp(prefix=MAKING, dir=out))
            held = lock(folder)
    except OSError as error:
        _remove_empty(missing)
        if error.errno in SHORT_CODES:
            raise
        why = "it is a file" if os.path.isfile(out) else f"it cannot be written ({error.strerror})"
        raise InputError("out", out, f"{why}.", "Choose another folder.") from None
    try:
        yield folder
        deliver(folder)
    except Exception as error:
        if keeps and (names := deliver(folder)):
            raise Incomplete(f"kept in {out}: {', '.join(names)}") from error
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        unlock(held)
        _remove_empty(missing)


def deliver(folder: Path) -> list[str]:
    """Move what is whole in a folder of `staged` to where it belongs; returns the names."""
    out, names = folder.parent, sorted(path.name for path in folder.glob("[!.]*"))
    for name in names:
        put(folder / name, out / name)
    return names


def write_whole(path: PathLike, text: str) -> None:
    """Write a text file, which appears whole or not at all.

    Raises:
        InputError: If the folder is missing or no file can be made there.
        OSError: If there is no room.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, "utf-8")


def _sweep(out: Path) -> None:
    """Remove the folders and files of processes that have ended: their locks ended with them."""
    for folder in out.glob(f"{MAKING}*"):
        held = lock(folder)
        if held is not None:
            shutil.rmtree(folder, ignore_errors=True)
        unlock(held)
    sweep_parts(out)


def sweep_parts(folder: Path) -> None:
    """Remove the half-written files of processes that have ended from a folder."""
    for path in folder.glob(PARTS):
        held = lock(path)
        if held is not None:
            path.unlink(missing_ok=True)
        unlock(held)


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
        OSError: If there is no room.
    """
    path = Path(path)
    try:
        temporary = beginning(path)
    except OSError as error:
        if error.errno in SHORT_CODES:
            raise
        raise InputError(
            "output",
            path,
            f"no file can be written there ({error.strerror}).",
            "Give a file name in a folder that exists and that you may write to.",
        ) from error
    held = lock(temporary)
    try:
        yield temporary
        put(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    finally:
        unlock(held)
