"""The page: cold start, first result, another camera, memory. Prints a Markdown table.

Wall-clock seconds with a warm kernel cache; run it on an idle machine.
"""

from __future__ import annotations

import sys
import tempfile
import time
import urllib.request
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from gradio_client import Client, handle_file  # noqa: E402
from served import serving  # noqa: E402

DUCK = ROOT / "demo" / "examples" / "duck.png"


def main() -> None:
    """Measure and print."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as server:
        ready = time.perf_counter() - start
        rows = [("cold start to a warm page that has measured the machine", f"{ready:.1f} s")]
        rows.append(("the page itself", f"{_seconds(lambda: _read(server.url)):.2f} s"))
        client = Client(server.url, verbose=False, analytics_enabled=False)
        rows += _runs(client)
        rows.append(("greatest resident memory", f"{server.peak_memory() / 1e6:.0f} MB"))
        client.close()
    print("| | measured |\n|---|--:|")
    for name, value in rows:
        print(f"| {name} | {value} |")


def _runs(client: Client) -> list[tuple[str, str]]:
    rows = []
    for accuracy in ("draft", "standard"):
        given = (handle_file(str(DUCK)), "press", accuracy, 14, {}, [])
        spent = _seconds(lambda given=given: client.predict(*given, api_name="/generate"))
        rows.append((f"duck, press, {accuracy}: picture to five videos", f"{spent:.1f} s"))
    spent = _seconds(lambda: client.predict(["orbit"], 512, 25, api_name="/render"))
    rows.append(("another camera (nothing simulated)", f"{spent:.1f} s"))
    return rows


def _seconds(work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _read(url: str) -> bytes:
    with urllib.request.urlopen(url) as answer:
        return answer.read()


if __name__ == "__main__":
    main()
