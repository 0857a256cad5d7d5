"""Programs in other processes: they are run, waited for, limited, and killed."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

LIMIT = 60.0
"""Longest wait [s], chosen for a machine that runs ten other programs."""


def run_program(
    command: Any, *, check: bool = False, **options: Any
) -> subprocess.CompletedProcess:
    """Run a program to its end; return its status and the text that it wrote.

    Raises:
        subprocess.CalledProcessError: If `check`, and its status is not 0.
    """
    return subprocess.run(command, capture_output=True, text=True, check=check, **options)


def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition is true."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


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
    from phy124.studies.sweep.work import make_row

    title = f"ray::{make_row.__name__}".encode()
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
                    if entry.read_bytes().startswith(title) and is_ours(worker):
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


@contextmanager
def limited(controller: str, limits: Mapping[str, int]) -> Iterator[Path]:
    """Provide a Linux control group of either version; skip the test if none can be created."""
    first = Path("/sys/fs/cgroup")
    mount = first / controller if (first / controller).is_dir() else first
    group = mount / f"phy124-test-{os.getpid()}"
    made = False
    try:
        with suppress(OSError):
            group.mkdir()
            for name, value in limits.items():
                if (group / name).exists():
                    (group / name).write_text(str(value))
                    made = True
        if not made:
            pytest.skip("this machine lets us make no control group")
        yield group
    finally:
        with suppress(OSError):
            group.rmdir()


def within(group: Path, *command: object) -> subprocess.CompletedProcess:
    """Run Python in a control group."""
    enter = f'echo $$ > {group}/cgroup.procs && exec "$0" "$@"'
    whole = ["sh", "-c", enter, sys.executable, *map(str, command)]
    return run_program(whole, timeout=300)
