"""Measures the page: cold start, first result, another camera, memory. Prints a Markdown table.

The table has wall-clock seconds, and processor seconds of the server, with a warm kernel cache. The
wall-clock seconds are valid only on a machine without other programs. The processor seconds hardly
depend on other programs.
"""

import os
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parents[1]))

from gradio_client import Client, handle_file

from support.served import Server, serving

ROOT = Path(__file__).parents[2]
DUCK = ROOT / "demo" / "examples" / "duck.png"
Row = tuple[str, float, float]
"""Action, seconds, processor seconds."""


def main() -> None:
    """Measure and print."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as server:
        ready = time.perf_counter() - start
        rows = [("cold start to a warm page that has measured the machine", ready, _spent(server))]
        rows.append(_measured(server, "the page itself", lambda: _read(server.url)))
        client = Client(server.url, verbose=False, analytics_enabled=False)
        rows += _runs(server, client)
        memory = server.peak_memory() / 1e6
        client.close()
    print("| | seconds | processor seconds |\n|---|--:|--:|")
    for name, wall, processor in rows:
        print(f"| {name} | {wall:.1f} | {processor:.1f} |")
    print(f"\nGreatest resident memory: {memory:.0f} MB. Load: {os.getloadavg()[0]:.0f}.")


def _runs(server: Server, client: Client) -> list[Row]:
    rows = []
    for accuracy in ("draft", "standard"):
        inputs = (handle_file(str(DUCK)), "press", accuracy, 14, {}, [])
        work = partial(client.predict, *inputs, api_name="/generate")
        name = f"duck, press, {accuracy}: picture to five videos"
        rows.append(_measured(server, name, work))
    work = partial(client.predict, ["orbit"], 512, 25, api_name="/render")
    return [*rows, _measured(server, "another camera (nothing simulated)", work)]


def _measured(server: Server, name: str, work: Callable[[], object]) -> Row:
    start, spent = time.perf_counter(), _spent(server)
    work()
    return name, time.perf_counter() - start, _spent(server) - spent


def _spent(server: Server) -> float:
    """Processor time of the server and of the processes that it has started and ended, s."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return sum(int(fields[place]) for place in range(11, 15)) / os.sysconf("SC_CLK_TCK")


def _read(url: str) -> bytes:
    with urllib.request.urlopen(url) as answer:
        return answer.read()


if __name__ == "__main__":
    main()
