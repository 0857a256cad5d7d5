"""Kills workers of a sweep while the sweep runs."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def made(out: Path) -> int:
    return len(list((out / "rows").rglob("*.json"))) if (out / "rows").is_dir() else 0


def clips_of(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted((out / "clips").rglob("*.*"))}


def is_ours(process: int) -> bool:
    """Return whether a process descends from this one; other programs may also run sweeps."""
    while process > 1 and process != os.getpid():
        status = Path(f"/proc/{process}/stat").read_text()
        process = int(status.rpartition(")")[2].split()[1])
    return process == os.getpid()


@contextmanager
def killer(out: Path, every: float) -> Iterator[list[int]]:
    """Within this context, workers that make clips are killed at intervals.

    On a busy machine, it waits until a clip is made before the next kill.
    """
    killed: list[int] = []
    done = threading.Event()

    def kill() -> None:
        last = -1
        while not done.wait(every):
            if (now := made(out)) == last:
                continue
            last = now
            for entry in Path("/proc").glob("[0-9]*/cmdline"):
                try:
                    worker = int(entry.parent.name)
                    if entry.read_bytes().startswith(b"ray::row_of") and is_ours(worker):
                        os.kill(worker, signal.SIGKILL)
                        killed.append(worker)
                        break
                except OSError:
                    continue

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    try:
        yield killed
    finally:
        done.set()
        thread.join()
