"""A real server of the page for tests: `python app.py` with its own port and folder."""

import contextlib
import json
import os
import re
import resource
import secrets
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
TIMEOUT = 600
"""Longest wait for a condition [s], chosen for a machine that runs ten other programs."""
RESERVED: list[socket.socket] = []
"""Sockets that reserve the ports of this process until its end."""
TAIL = 4000
"""Number of characters of the server's log that a failure shows."""


class Server:
    """A running server."""

    def __init__(self, port: int, folder: Path, log: Path, process: subprocess.Popen) -> None:
        self.port, self.folder, self.log, self.process = port, folder, log, process
        self.url = f"http://127.0.0.1:{port}"

    def health(self) -> dict:
        self.check_running()
        with urllib.request.urlopen(f"{self.url}/health", timeout=TIMEOUT) as answer:
            return json.load(answer)

    def threads(self) -> int:
        """Return the threads of the server that do work."""
        names = [
            path.joinpath("comm").read_text().strip()
            for path in Path(f"/proc/{self.process.pid}/task").iterdir()
        ]
        return sum(name.startswith(("work", "render")) for name in names)

    def children(self) -> list[str]:
        """Return the programs of all running processes that the server has started."""
        listed = Path(f"/proc/{self.process.pid}/task").glob("*/children")
        result = [pid for path in listed for pid in path.read_text().split()]
        return [Path(f"/proc/{pid}/comm").read_text().strip() for pid in result]

    def files(self) -> list[Path]:
        """Return the files of visitors, without uploads that no visitor has claimed yet."""
        # The server may remove a folder at any moment; `os.walk` skips it, and `rglob` does not.
        walk = os.walk(self.folder / "visitors")
        inside = ((Path(folder), names) for folder, _, names in walk)
        return [path / name for path, names in inside if path.name != "arrivals" for name in names]

    def peak_memory(self) -> int:
        """Return the largest resident size so far [bytes]."""
        return self._status("VmHWM")

    def _status(self, name: str) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        match = re.search(rf"{name}:\s+(\d+) kB", status)
        assert match is not None
        return int(match[1]) * 1024

    def memory(self) -> int:
        """Return the current resident size [bytes]."""
        return self._status("VmRSS")

    def said(self) -> str:
        """Return the end of the server's log."""
        return self.log.read_text(errors="replace")[-TAIL:]

    def check_running(self) -> None:
        """Assert that the server runs; otherwise show its exit status and the end of its log."""
        status = self.process.poll()
        assert status is None, f"the server ended with status {status}:\n{self.said()}"

    def until(self, condition, what: str = "it") -> None:
        """Wait until a condition is true; a failure shows the server's log."""
        end = time.monotonic() + TIMEOUT
        while not condition():
            self.check_running()
            assert time.monotonic() < end, f"{what} did not happen in {TIMEOUT} s:\n{self.said()}"
            time.sleep(0.2)

    def until_idle(self) -> None:
        self.until(lambda: not self.health()["busy"], "an end of all work")


@contextlib.contextmanager
def serving(
    folder: Path,
    command: Sequence[str | Path] = (sys.executable, ROOT / "app.py"),
    *,
    files: int | None = None,
    warm: bool = True,
    port: int = 0,
    **settings: object,
) -> Iterator[Server]:
    """Serve until the block ends; settings are those of demo.settings.Settings.

    `files` is the largest number of open files and connections of the server. If `warm` is false,
    the server is used while it loads kernels and measures the machine. `port` 0 means any free
    port.
    """
    port = port or free_port()
    # After a native crash the log has the stack of each thread.
    options = {"PYTHONFAULTHANDLER": "1"}
    options |= {f"PHY124_{name.upper()}": str(value) for name, value in settings.items()}
    root, written = folder / "files", folder / "log.txt"
    environment = {**os.environ, "PHY124_PORT": str(port), "PHY124_FOLDER": str(root), **options}
    with open(written, "wb") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
    if files:
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (files, files))
    server = Server(port, root, written, process)
    try:
        server.until(lambda: _answers(server, warm), "a server that is ready")
        yield server
    finally:
        process.terminate()
        try:
            process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def free_port() -> int:
    """Return a free port, below the range of ports that connections of other programs get.

    A server needs some seconds until it uses its port. Meanwhile, a UDP socket with the same number
    keeps other tests from choosing the port.
    """
    while True:
        port = 20_000 + secrets.randbelow(12_000)
        mark = socket.socket(type=socket.SOCK_DGRAM)
        with socket.socket() as probe, contextlib.suppress(OSError):
            mark.bind(("127.0.0.1", port))
            probe.bind(("127.0.0.1", port))
            RESERVED.append(mark)
            return port
        mark.close()


def _answers(server: Server, warm: bool) -> bool:
    try:
        return server.health()["ready"] or not warm
    except OSError:
        return False
