"""Where a sweep's results are: a folder here, or anything that fsspec can address as one."""

from __future__ import annotations

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
    """Files on their way into a storage."""

    place: Path
    """The folder to fill."""
    store: Callable[[], int]
    """Moves what is there by now to the storage; returns its bytes."""


class Storage:
    """Files by their names below one folder; a file appears whole or not at all."""

    def __init__(self, address: str) -> None:
        """Find the folder, which need not exist yet.

        Raises:
            InputError: No installed package knows such an address.
        """
        self.address = str(address).rstrip("/") or "/"
        self._files, self._root = _opened(self.address)

    @property
    def here(self) -> Path | None:
        """The folder, if it is one of this machine."""
        return Path(self._root) if "file" in _names(self._files) else None

    def place(self, name: str) -> str:
        """The address of a file, for people and other programs."""
        return f"{self.address}/{name}"

    def names(self, folder: str) -> list[str]:
        """Names of all files below a folder, in order."""
        self._files.invalidate_cache()
        start = len(self._root) + 1
        found = self._files.find(f"{self._root}/{folder}")
        return sorted(path[start:] for path in found if not Path(path).name.startswith("."))

    def read(self, name: str) -> bytes:
        """The content of a file.

        Raises:
            FileNotFoundError: There is no such file.
        """
        return self._files.cat_file(f"{self._root}/{name}")

    def write(self, name: str, content: bytes) -> None:
        """Write a file."""
        if self.here is None:
            self._files.pipe_file(f"{self._root}/{name}", content)
            return
        path = self.here / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(content)

    @contextmanager
    def filling(self, folder: str) -> Iterator[Filling]:
        """A place on this machine for the files of a folder, which may be stored in parts."""
        if self.here is not None:
            with staging(self.here / folder) as place:
                yield Filling(place, partial(_deliver, place))
            return
        with tempfile.TemporaryDirectory(prefix="phy124-") as temporary:
            place = Path(temporary)
            yield Filling(place, partial(self._copy, folder, place))

    def _copy(self, folder: str, source: Path) -> int:
        """Move the files of a folder of this machine to the storage; returns their bytes."""
        size = 0
        for path in sorted(path for path in source.rglob("*") if path.is_file()):
            content = path.read_bytes()
            self.write(f"{folder}/{path.relative_to(source).as_posix()}", content)
            size += len(content)
            path.unlink()
        return size

    def sweep(self, folder: str) -> None:
        """Remove the half-written files that killed processes left in a folder of this machine."""
        if self.here is not None:
            sweep_parts(self.here / folder)

    @contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """A file as one of this machine; removed afterwards if it had to be fetched."""
        with fetched(self.place(name)) as path:
            yield path


def _deliver(place: Path) -> int:
    """Move files to their folder on this machine; returns their bytes."""
    size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
    deliver(place)
    return size


@contextmanager
def fetched(address: str) -> Iterator[Path]:
    """A file that may be elsewhere as one of this machine, for as long as it is needed.

    Raises:
        InputError: It cannot be fetched.
    """
    files, path = _opened(address)
    if "file" in _names(files):
        yield Path(address if "://" not in address else path)
        return
    with tempfile.TemporaryDirectory(prefix="phy124-") as folder:
        target = Path(folder) / Path(path).name
        try:
            files.get_file(path, str(target))
        except (OSError, ValueError) as error:
            limit = f"it cannot be fetched ({error})."
            raise InputError("picture", address, limit, "Check the address.") from error
        yield target


def stamp(address: str) -> object:
    """What changes when a file does, as far as its file system tells."""
    files, path = _opened(address)
    try:
        return files.ukey(path)
    except (OSError, NotImplementedError):
        return None


def matching(pattern: str) -> list[str]:
    """Addresses of the files that a path or pattern means, in order.

    Raises:
        InputError: There is none.
    """
    files, path = _opened(pattern)
    try:
        found = sorted(str(one) for one in files.glob(path) if not files.isdir(one))
    except OSError as error:
        limit = f"its folder cannot be read ({error})."
        raise InputError("pictures", pattern, limit, "Check the address and its keys.") from error
    if not found:
        raise InputError("pictures", pattern, "there is no such file.", "Give paths or a pattern.")
    if "file" not in _names(files):
        return [files.unstrip_protocol(one) for one in found]
    return [os.path.relpath(one) if not os.path.isabs(pattern) else one for one in found]


def _opened(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path in it."""
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
    """Names of a file system's protocol."""
    found = files.protocol
    return (found,) if isinstance(found, str) else tuple(found)
