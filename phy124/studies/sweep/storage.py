"""Stores a sweep's results in a local folder, or at an fsspec address."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from phy124.errors import InputError
from phy124.io.files import deliver, replacing, staging, sweep_parts
from phy124.runtime.installation import install_command


class Filling(NamedTuple):
    """A local folder for new files, which are later moved to the storage."""

    place: Path
    store: Callable[[], int]
    """Moves the files to the storage, and returns their size [bytes]."""


class Storage:
    """Reads and writes files by their names relative to a folder. Files are written atomically."""

    def __init__(self, address: str) -> None:
        """Open the file system; the folder need not exist yet.

        Raises:
            InputError: The package for this type of address is not installed.
        """
        self.address = str(address).rstrip("/") or "/"
        self._files, self._root = _open(self.address)

    @property
    def here(self) -> Path | None:
        """Path of the folder if it is on this machine; otherwise None."""
        return Path(self._root) if "file" in _names(self._files) else None

    def place(self, name: str) -> str:
        """Return the address of a file in the storage."""
        return f"{self.address}/{name}"

    def names(self, folder: str) -> list[str]:
        """Return the sorted names of all files in a folder and its subfolders."""
        self._files.invalidate_cache()
        start = len(self._root) + 1
        paths = self._files.find(f"{self._root}/{folder}")
        return sorted(path[start:] for path in paths if not Path(path).name.startswith("."))

    def read(self, name: str) -> bytes:
        """Read a file.

        Raises:
            FileNotFoundError: The file does not exist.
        """
        return self._files.cat_file(f"{self._root}/{name}")

    def write(self, name: str, content: bytes) -> None:
        """Write or replace a file."""
        if self.here is None:
            self._files.pipe_file(f"{self._root}/{name}", content)
            return
        path = self.here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(content)

    def remove(self, name: str) -> None:
        """Remove a file."""
        self._files.rm_file(f"{self._root}/{name}")

    def refuse_unusable(self) -> None:
        """Raise InputError if the storage is a folder on this machine that cannot be written."""
        if self.here is not None:
            with staging(self.here):
                pass

    @contextmanager
    def filling(self, folder: str) -> Iterator[Filling]:
        """Provide a local folder and a function that moves its files to the storage."""
        if self.here is not None:
            with staging(self.here / folder) as place:
                yield Filling(place, partial(_deliver, place))
            return
        with tempfile.TemporaryDirectory(prefix="phy124-") as temporary:
            place = Path(temporary)
            yield Filling(place, partial(self._copy, folder, place))

    def _copy(self, folder: str, source: Path) -> int:
        size = 0
        for path in sorted(path for path in source.rglob("*") if path.is_file()):
            content = path.read_bytes()
            self.write(f"{folder}/{path.relative_to(source).as_posix()}", content)
            size += len(content)
            path.unlink()
        return size

    def sweep(self, folder: str) -> None:
        """Remove incomplete files of killed processes from a folder on this machine."""
        if self.here is not None:
            sweep_parts(self.here / folder)


def _deliver(place: Path) -> int:
    size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
    deliver(place)
    return size


@contextmanager
def fetch(address: str) -> Iterator[Path]:
    """Provide the file at an address as a local file; a downloaded copy is later removed.

    Raises:
        InputError: The file cannot be downloaded.
    """
    files, path = _open(address)
    if "file" in _names(files):
        yield Path(address if "://" not in address else path)
        return
    with tempfile.TemporaryDirectory(prefix="phy124-") as folder:
        target = Path(folder) / Path(path).name
        try:
            files.get_file(path, str(target))
        except (OSError, ValueError) as error:
            limit = f"it cannot be downloaded ({error})."
            raise InputError("picture", address, limit, "Check the address of the file.") from error
        yield target


def stamp(address: str) -> object:
    """Return a value that changes when a file changes, or None if there is no such value."""
    files, path = _open(address)
    try:
        return files.ukey(path)
    except (OSError, NotImplementedError):
        return None


def list_matching(pattern: str) -> list[str]:
    """Return the sorted addresses of all files that match a path or pattern.

    The path of an existing file is not treated as a pattern, even if it contains brackets.

    Raises:
        InputError: No file matches the pattern, or the folder cannot be read.
    """
    files, path = _open(pattern)
    try:
        paths = [path] if files.isfile(path) else files.glob(path)
        matches = sorted(str(match) for match in paths if not files.isdir(match))
    except OSError as error:
        limit = f"its folder cannot be read ({error})."
        raise InputError(
            "pictures", pattern, limit, "Check the address and its access keys."
        ) from error
    if not matches:
        raise InputError(
            "pictures",
            pattern,
            "there is no such file.",
            "Give paths of existing files, or a pattern.",
        )
    if "file" not in _names(files):
        return [*map(files.unstrip_protocol, matches)]
    return matches if os.path.isabs(pattern) else [*map(os.path.relpath, matches)]


def _open(address: str) -> tuple[Any, str]:
    import fsspec
    from fsspec.core import url_to_fs

    try:
        return url_to_fs(address)
    except (ImportError, ValueError) as error:
        scheme = address.partition("://")[0]
        known = ", ".join(sorted(fsspec.available_protocols())[:12])
        limit = f"{scheme}:// needs a package that is not installed ({error})."
        remedy = f"Run `{install_command('sweep')}`, or use one of {known} ..."
        raise InputError("address", address, limit, remedy) from error


def _names(files: Any) -> tuple[str, ...]:
    names = files.protocol
    return (names,) if isinstance(names, str) else tuple(names)
