"""Linux control groups, to test runs with little memory or few processors."""

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from support.processes import run_program


@contextmanager
def limited(controller: str, limits: Mapping[str, int]) -> Iterator[Path]:
    """Provide a control group of either version; skip the test if none can be created."""
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
