"""Writes output files atomically: a file appears, or replaces an older file, only when complete.

Links are followed, and output is written into devices and pipes. A process locks its temporary
files; a temporary file without a lock was left by a killed process.
"""

import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from phy124.errors import SHORT_CODES, Incomplete, InputError, is_full_disk

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LOCKS_AVAILABLE = fcntl is not None
"""Whether this system has advisory file locks (`flock`)."""


def lock(path: Path, *, wait: bool = False) -> int | None:
    """Lock a file or folder; return None if it is already locked or the system has no `flock`."""
    if fcntl is None:
        return None
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            return descriptor
        except OSError:
            os.close(descriptor)
    return None


def unlock(held: int | None) -> None:
    """Release a lock."""
    if held is not None:
        os.close(held)


@contextmanager
def locking(path: Path) -> Iterator[None]:
    """Hold a lock during the `with` block; first wait until other processes have released it."""
    held = lock(path, wait=True)
    try:
        yield
    finally:
        unlock(held)


DESCRIPTORS = ("/dev/fd/", "/proc/", "/dev/stdout", "/dev/stderr")
"""Prefixes of paths that name an open file, pipe or device of a process."""
PARTS = ".*-????????.part*"
"""Pattern that matches the names of files that are still being written."""
LONGEST = 40
"""Number of characters of a file's name that are copied to the name of its temporary file."""


def is_stream(path: Path) -> bool:
    """Return whether a path is a device, a pipe or an open file.

    Output is written into such a path, while an ordinary file is replaced.

    Raises:
        OSError: If the path is a folder, a disk, a socket, or a link that refers to itself.
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


def create_temporary(path: Path) -> Path:
    """Create an empty temporary file, which `move_to` moves to `path` when it is complete.

    The temporary file keeps the extension of `path`, because some writers need the extension. The
    temporary file is in the folder of the resolved path or, if `path` is a device or pipe, in the
    system's temporary folder.

    Raises:
        OSError: If no file can be written in that folder.
    """
    folder = Path(tempfile.gettempdir()) if is_stream(path) else resolve_links(path).parent
    ending = path.suffix if len(path.suffix) <= LONGEST else ""
    name = f".{path.stem[:LONGEST]}-{secrets.token_hex(4)}.part{ending}"
    # The operating system applies the umask, because a process can read the umask only by changing
    # it.
    os.close(os.open(folder / name, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return folder / name


def move_to(source: Path, path: Path) -> None:
    """Move a finished file or folder to a path; replace any file or folder at this path.

    Links are followed, and content is written into devices and pipes.

    Raises:
        OSError: If no file can be written to the path.
    """
    if source.is_dir():
        shutil.rmtree(resolve_links(path), ignore_errors=True)
    elif is_stream(path):
        with open(source, "rb") as file, open(path, "wb") as stream:
            shutil.copyfileobj(file, stream)
        source.unlink()
        return
    try:
        os.replace(source, resolve_links(path))
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        _copy(source, path)


def resolve_links(path: Path) -> Path:
    """Return the absolute path after all links are resolved."""
    return Path(os.path.realpath(path))


def _copy(source: Path, path: Path) -> None:
    if source.is_dir():
        shutil.move(source, resolve_links(path))
        return
    copy = create_temporary(path)
    try:
        shutil.copyfile(source, copy)
        os.replace(copy, resolve_links(path))
    finally:
        copy.unlink(missing_ok=True)
    source.unlink()


PathLike = str | os.PathLike[str]
MAKING = ".making-"
"""Prefix of the names of temporary folders, whose files are not yet complete."""
RUNNING = f"{MAKING}run-"
"""Prefix of the name of a run's temporary folder if no other run may use the same output folder."""


@contextmanager
def staging(out: PathLike, *, keeps: bool = False, alone: bool = False) -> Iterator[Path]:
    """Provide a temporary folder whose files are moved into `out` if the block succeeds.

    Files that killed processes left in `out` are removed.

    Args:
        out: The folder to fill.
        keeps: Whether complete files are moved into `out` even if the block fails.
        alone: Whether to raise an error if another block with `alone`, in any process, is filling
            `out`.

    Raises:
        InputError: If `out` is a file, cannot be written, or is being filled by another run.
        OSError: If the disk is full.
        Incomplete: If the block failed but some files were kept.
    """
    out, missing = Path(out), []
    try:
        target = resolve_links(out)
        missing = [path for path in (target, *target.parents) if not path.exists()]
        target.mkdir(parents=True, exist_ok=True)
        with locking(target):
            sweep_killed(out)
            others = list(out.glob(f"{RUNNING}*")) if alone else []
            folder = Path(tempfile.mkdtemp(prefix=RUNNING if alone else MAKING, dir=out))
            held = lock(folder)
    except OSError as error:
        remove_empty(missing)
        if error.errno in SHORT_CODES:
            raise
        # A link to itself makes mkdir say that the folder exists.
        loops = error.errno == errno.EEXIST and out.is_symlink()
        reason = os.strerror(errno.ELOOP) if loops else error.strerror
        why = "it is a file" if os.path.isfile(out) else f"it cannot be written ({reason})"
        raise InputError("out", out, f"{why}.", "Choose another folder.") from None
    try:
        if others and held is not None:  # without locks, these folders may be from killed runs
            limit = "another run is writing its results to this folder."
            raise InputError("out", out, limit, "Wait until it ends, or choose another folder.")
        with naming_full_disk(out):
            yield folder
            deliver(folder)
    except Exception as error:
        if keeps and (names := deliver(folder)):
            raise Incomplete(f"kept in {out}: {', '.join(names)}") from error
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        unlock(held)
        remove_empty(missing)


@contextmanager
def naming_full_disk(folder: Path) -> Iterator[None]:
    """Within this block, errors about a full disk name the folder to which the block writes.

    An error that names a file outside the folder is not changed.

    Raises:
        OSError: If the disk is full.
    """
    try:
        yield
    except Exception as error:
        if not is_full_disk(error):
            raise
        code, name = errno.ENOSPC, None
        if isinstance(error, OSError):
            code, name = error.errno or code, error.filename2 or error.filename
        if name and not resolve_links(Path(name)).is_relative_to(resolve_links(folder)):
            raise
        # `staging` writes to a hidden folder; the message names the user's folder that contains it.
        known = folder.parent if folder.name.startswith(MAKING) else folder
        raise OSError(code, os.strerror(code), os.fspath(known)) from error


def deliver(folder: Path) -> list[str]:
    """Move complete files and non-empty folders from a `staging` folder to its output folder."""
    out, made = folder.parent, folder.glob("[!.]*")
    names = sorted(path.name for path in made if path.is_file() or any(path.iterdir()))
    for name in names:
        move_to(folder / name, out / name)
    return names


def write_whole(path: PathLike, text: str) -> None:
    """Write a text file atomically.

    Raises:
        InputError: If the folder is missing or the file cannot be created.
        OSError: If the disk is full.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, "utf-8")


def sweep_killed(out: Path) -> None:
    """Remove temporary folders and files that killed processes left in an output folder."""
    for folder in out.glob(f"{MAKING}*"):
        held = lock(folder)
        if held is not None:
            shutil.rmtree(folder, ignore_errors=True)
        unlock(held)
    sweep_parts(out)


def sweep_parts(folder: Path) -> None:
    """Remove temporary files that killed processes left in a folder."""
    for path in folder.glob(PARTS):
        held = lock(path)
        if held is not None:
            path.unlink(missing_ok=True)
        unlock(held)


def writable(folder: Path) -> bool:
    """Return whether files can be written into a folder, which need not exist."""
    for path in (folder, *folder.parents):
        if os.path.lexists(path):
            return path.is_dir() and os.access(path, os.W_OK | os.X_OK)
    return False


def remove_empty(folders: list[Path]) -> None:
    """Remove empty folders, innermost first; stop at the first folder that is not empty."""
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()


def refuse_unwritable(path: PathLike) -> None:
    """Raise InputError if `replacing` cannot write to a path; an existing file is not changed."""
    _create(Path(path)).unlink()


def refuse_replacing(path: Path, read: Iterable[Path]) -> None:
    """Refuse to write to the path of a file that the command reads.

    Raises:
        InputError: `path` is one of the files in `read`.
    """
    if resolve_links(path) in [resolve_links(each) for each in read]:
        limit = "It is the name of a file that this command reads."
        raise InputError("out", path, limit, "Give another name for the output.")


def _create(path: Path) -> Path:
    try:
        return create_temporary(path)
    except OSError as error:
        if error.errno in SHORT_CODES:
            raise
        limit = f"no file can be written to this path ({error.strerror})."
        remedy = "Give a file name in an existing folder to which you may write."
        raise InputError("output", path, limit, remedy) from error


@contextmanager
def replacing(path: PathLike) -> Iterator[Path]:
    """Provide a temporary file for writing, which replaces `path` if the block succeeds.

    Links are followed, and content is written into devices and pipes. If the block ends early for
    any reason, an older file at `path` stays unchanged.

    Raises:
        InputError: If the folder is missing or the file cannot be written.
        OSError: If the disk is full.
    """
    path = Path(path)
    temporary = _create(path)
    held = lock(temporary)
    try:
        with naming_full_disk(path.parent):
            yield temporary
            move_to(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    finally:
        unlock(held)
