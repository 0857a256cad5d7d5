"""Where an output goes: through links, into devices and pipes, with the mode of a new file."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
from pathlib import Path

DESCRIPTORS = ("/dev/fd/", "/proc/", "/dev/stdout", "/dev/stderr")
"""Beginnings of paths that name an open file, whatever it is."""
PARTS = ".*-????????.part*"
"""Pattern of the names of files that are still being filled."""
LONGEST = 40
"""Longest part of a file's name that the name of its temporary file repeats, in characters."""


def is_stream(path: Path) -> bool:
    """Whether a path is written into rather than replaced: a device, a pipe or an open file.

    Raises:
        OSError: It can be neither: a folder, a disk, a socket, or a link to itself.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "this is the name of a folder")
    if stat.S_ISBLK(mode) or stat.S_ISSOCK(mode):
        raise OSError(errno.EINVAL, "this is the name of a disk or a socket")
    return not stat.S_ISREG(mode) or os.path.abspath(path).startswith(DESCRIPTORS)


def beginning(path: Path) -> Path:
    """A new empty file to be filled, and then to be moved to `path` by `put`.

    Its ending is that of `path`, as some writers go by it. It lies beside the file that `path`
    leads to, or in the folder of temporary files if that is a stream.

    Raises:
        OSError: Nothing can be written there.
    """
    folder = Path(tempfile.gettempdir()) if is_stream(path) else real(path).parent
    ending = path.suffix if len(path.suffix) <= LONGEST else ""
    name = f".{path.stem[:LONGEST]}-{secrets.token_hex(4)}.part{ending}"
    # The system applies the umask, which a process can read only by changing it for all threads.
    os.close(os.open(folder / name, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return folder / name


def put(source: Path, path: Path) -> None:
    """Move a finished file or folder to where a path leads, in place of what is there.

    Links are followed, devices and pipes are written into, and a folder takes the place of a whole
    folder. On another file system the content is copied.

    Raises:
        OSError: Nothing can be written there.
    """
    if source.is_dir():
        shutil.rmtree(real(path), ignore_errors=True)
    elif is_stream(path):
        with open(source, "rb") as file, open(path, "wb") as stream:
            shutil.copyfileobj(file, stream)
        source.unlink()
        return
    try:
        os.replace(source, real(path))
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        _copy(source, path)


def real(path: Path) -> Path:
    """The path without links."""
    return Path(os.path.realpath(path))


def _copy(source: Path, path: Path) -> None:
    """Copy a file or folder to another file system, where it appears whole or not at all."""
    if source.is_dir():
        shutil.move(source, real(path))
        return
    copy = beginning(path)
    try:
        shutil.copyfile(source, copy)
        os.replace(copy, real(path))
    finally:
        copy.unlink(missing_ok=True)
    source.unlink()
