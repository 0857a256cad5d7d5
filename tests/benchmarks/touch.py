"""Measures Touch in headless Chromium: time from the pointer to the picture, and growth of memory.

    python tests/benchmarks/touch.py [--seconds 600] [--gaussians 50000] [--film touch.webp]

The server, its live run and Chromium with software WebGL share the machine. A pointer swings the
object and moves 30 times a second. The delay of a movement lasts from its arrival in the browser
until the first frame that includes it has been drawn. By default, Chromium chooses how to compose
the page; without a GPU it uses the processor. With `--composed webgl`, software WebGL composes the
page, as in the tests of the page, which takes 20 ms more processor time for each picture. The
program also prints the processor time of server and browser, on which other work on the machine has
less influence. `--film` writes the viewer's pictures as an animated WebP.
"""

import io
import math
import os
import sys
import tempfile
import time
from argparse import ArgumentParser
from contextlib import suppress
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "e2e"))

from visit import FLAGS, HAND, LONG, TOP, Visit

from support.served import serving

SEEN = f"""(() => {{ const h = {HAND}; return {{
    pictures: h.pictures, time: h.head?.time ?? 0, bytes: h.bytes, count: h.count,
    splats: h.lattice.splats, nodes: h.lattice.nodes, told: h.status.textContent,
    size: [h.canvas.width, h.canvas.height], delays: h.delays.splice(0) }}; }})()"""
PLAIN = ["--no-sandbox", "--disable-gpu-watchdog"]
FILM_SIZE, FILM_RATE = (480, 357), 12


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--gaussians", type=int, default=50_000)
    parser.add_argument("--scene", default="Sway")
    parser.add_argument("--film", type=Path)
    parser.add_argument("--composed", choices=("plain", "webgl"), default="plain")
    arguments = parser.parse_args()
    from playwright.sync_api import sync_playwright

    minutes = {"touch_minutes": arguments.seconds / 60 + 10}
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(Path(folder), gaussians=arguments.gaussians, **minutes) as server,
        sync_playwright() as session,
    ):
        flags = PLAIN if arguments.composed == "plain" else FLAGS
        chromium = session.chromium.launch(executable_path="/usr/bin/chromium", args=flags)
        visit = Visit(chromium, server)
        begin(visit, arguments.scene)
        if arguments.film:
            film(visit.page, arguments.film)
        swing(visit.page, arguments.seconds, server)
        assert not visit.complaints, visit.complaints


def begin(visit: Visit, scene: str) -> None:
    page = visit.page
    visit.upload()
    page.locator(".card", has_text=scene).first.click()
    page.wait_for_timeout(500)
    page.locator("#begin-touch").click()
    page.wait_for_selector(".touch canvas.ready", timeout=LONG)
    page.wait_for_function(f"{HAND}.frames > 20", timeout=LONG)
    print(page.locator(".touch-status").inner_text())


def press(page) -> tuple[float, float]:
    x, y = page.evaluate(TOP)
    page.mouse.move(x, y + 8)
    page.mouse.down()
    return x, y


def swing(page, seconds: float, server) -> None:
    """Swing the object, and print what was measured every minute."""
    x, y = press(page)
    page.evaluate(SEEN)
    start, delays = time.monotonic(), []
    first = last = (start, page.evaluate(SEEN))
    memory, worked = [held(server)], [work(server)]
    while time.monotonic() - start < seconds:
        angle = 2 * math.pi * 0.4 * (time.monotonic() - start)
        page.mouse.move(x + 70 * math.sin(angle), y - 20 * math.sin(0.7 * angle))
        page.wait_for_timeout(33)
        if time.monotonic() - last[0] > min(60, seconds / 2):
            last = time.monotonic(), page.evaluate(SEEN)
            delays += last[1]["delays"]
            memory.append(held(server))
            worked.append(work(server))
            report(first, last, delays, memory, worked)
    last = time.monotonic(), page.evaluate(SEEN)
    delays += last[1]["delays"]
    memory.append(held(server))
    worked.append(work(server))
    report(first, last, delays, memory, worked)


def report(first, last, delays, memory, worked) -> None:
    (begun, before), (now, after) = first, last
    pictures = after["pictures"] - before["pictures"]
    rate, factor = pictures / (now - begun), (after["time"] - before["time"]) / (now - begun)
    sent = (after["bytes"] - before["bytes"]) / (now - begun) / 1e6
    p50, p95 = np.percentile(delays, [50, 95]) if delays else (math.nan, math.nan)
    drawn = f"{after['count']:,} of {after['splats']:,} Gaussians on {after['nodes']:,} nodes"
    print(
        f"{now - begun:.0f} s: pointer to picture p50 {p50:.0f} ms, p95 {p95:.0f} ms of "
        f"{len(delays)}; {rate:.1f} pictures/s, {factor:.2f}x real time, {sent:.2f} MB/s; "
        f"{drawn}, {after['size'][0]} x {after['size'][1]}; {grown(memory)}; "
        f"{spent(worked, pictures)}; "
        f"load {os.getloadavg()[0]:.1f}; {after['told'][:60]}",
        flush=True,
    )


def held(server) -> dict[str, float]:
    """Resident memory of each side [bytes]."""
    both = resident(server.process.pid)
    alone = server.memory()
    return {"Chromium": resident(os.getpid()) - both, "server": alone, "live run": both - alone}


def work(server) -> dict[str, float]:
    """Time that each side has had of the processor [s]."""
    served, alone = busy(server.process.pid), seconds(server.process.pid)
    return {"Chromium": busy(os.getpid()) - served, "server": alone, "live run": served - alone}


def spent(worked: list[dict[str, float]], pictures: int) -> str:
    """Time of the processor for each picture."""
    first, last = worked[0], worked[-1]
    parts = [f"{n} {1e3 * (last[n] - first[n]) / max(pictures, 1):.0f}" for n in first]
    return f"processor per picture {', '.join(parts)} ms"


def grown(memory: list[dict[str, float]]) -> str:
    """Return the memory at the start and at the end."""
    first, last = memory[0], memory[-1]
    return ", ".join(f"{n} {first[n] / 1e6:.0f} -> {last[n] / 1e6:.0f} MB" for n in first)


def resident(*roots: int) -> float:
    """Resident memory of processes and all that they started [bytes]."""
    return sum(4096 * int(answer[21]) for answer in family(roots).values())


def busy(*roots: int) -> float:
    """Time that processes and all that they started have had of the processor [s]."""
    return sum(seconds(process) for process in family(roots))


def seconds(process: int) -> float:
    """Time that a process has had of the processor [s], to the nanosecond."""
    total = 0
    for path in Path(f"/proc/{process}/task").glob("*/schedstat"):
        with suppress(OSError):
            total += int(path.read_text().split()[0])
    return total / 1e9


def family(roots: tuple[int, ...]) -> dict[int, list[str]]:
    """Return the operating system's data on processes and on all processes that they started, by
    number."""
    options: dict[int, list[str]] = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            options[int(path.name)] = path.joinpath("stat").read_text().rsplit(")", 1)[1].split()
    results = {}
    for process in options:
        above = process
        while above in options and above not in roots:
            above = int(options[above][1])
        if above in roots:
            results[process] = options[process]
    return results


def film(page, path: Path) -> None:
    """Six seconds of lifting, swinging and dropping the object, at its own pace."""
    from PIL import Image

    x, y = press(page)
    pictures = []
    for index in range(6 * FILM_RATE):
        t = index / FILM_RATE
        if t < 4:
            lift = 120 * min(t, 1)
            page.mouse.move(x + 130 * math.sin(2.2 * t), y - lift + 20 * math.sin(5 * t))
        elif t == 4:
            page.mouse.up()
        page.wait_for_timeout(1000 / FILM_RATE)
        shot = page.locator(".touch-view").screenshot()
        with Image.open(io.BytesIO(shot)) as picture:
            pictures.append(picture.convert("RGB").resize(FILM_SIZE, Image.Resampling.LANCZOS))
    options = {"duration": round(1000 / FILM_RATE), "loop": 0, "quality": 62, "method": 4}
    pictures[0].save(path, save_all=True, append_images=pictures[1:], **options)
    print(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
