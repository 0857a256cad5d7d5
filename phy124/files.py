"""Output files appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phy124.errors import InputError


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary name beside `path` to write to; it becomes `path` when all went well.

    Whatever ends the block early, an interrupt too, the temporary file goes and an older file
    under that name stays.

    Raises:
        InputError: If the folder is missing or nothing can be written there.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise IsADirectoryError(0, "this is the name of a folder")
        # The ending stays: some writers go by it.
        descriptor, name = tempfile.mkstemp(
            prefix=f".{path.stem}-", suffix=f".part{path.suffix}", dir=path.parent
        )
    except OSError as error:
        raise InputError(
            "output",
            path,
            f"no file can be written there ({error.strerror}).",
            "Give a file name in a folder that exists and that you may write to.",
        ) from error
    os.close(descriptor)
    try:
        yield Path(name)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
