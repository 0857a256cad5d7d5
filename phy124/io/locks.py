"""Locks on files and folders that end with the process that holds them, however it ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

AVAILABLE = fcntl is not None
"""Whether this system has such locks."""


def lock(path: Path, *, wait: bool = False) -> int | None:
    """A lock; None if another process holds it or locks are unavailable."""
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
    """Give a lock back."""
    if held is not None:
        os.close(held)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Within this context, other processes wait for the same lock."""
    held = lock(path, wait=True)
    try:
        yield
    finally:
        unlock(held)
