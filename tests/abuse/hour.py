"""Simulates an hour in which half of the visitors make runs, and the other half attack the page.

    python tests/abuse/hour.py --seconds 3600 --visitors 200

At its end every honest visitor had a run, memory and disk are within their limits and flat, and no
process and no file of anybody is left. It prints how long /health took.
"""

import argparse
import itertools
import json
import math
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median, quantiles

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from attacker import Attacker

from demo.folder import LOCK
from demo.room import size_of
from phy124.scene import Scene
from support.hostile import bomb, png_claiming
from support.served import ROOT, Server, serving

DUCK = (ROOT / "demo/examples/duck.png").read_bytes()
SETTINGS = {
    "gaussians": 2000,
    "max_upload_mb": 2,
    "max_visitor_mb": 30,
    "max_total_mb": 300,
    "max_seconds": 120,
    "grace_minutes": 0.2,
    "warm_up": False,
    "max_per_address": 16,
}
MEMORY, GROWTH, SHORT = 1500e6, 100e6, 600.0
"""Memory of the server, and its growth [bytes], which is not judged in a short time [s]."""
ADDRESSES = 10
"""From which the hostile ones come; each honest visitor has an address to itself."""
FOREIGN = {"Origin": "https://evil.example"}


def scene(**changes: object) -> dict:
    """A small scene, as the page sends it."""
    few = {"view.views": ["front"], "view.size": 64, "accuracy": "draft", "time.frames": 6}
    return Scene.named("press").replaced({**few, **changes}).data()


@dataclass
class Record:
    """Observations of the server."""

    health: list[float] = field(default_factory=list)
    memory: list[int] = field(default_factory=list)
    disk: list[int] = field(default_factory=list)
    answers: Counter[str] = field(default_factory=Counter)
    """Number of attempts of each attack."""
    tries: list[int] = field(default_factory=list)
    """For each honest visitor, the number of attempts until the run existed."""

    def lines(self) -> list[str]:
        """In sentences."""
        late = quantiles(self.health, n=20)[-1] if len(self.health) > 1 else 0.0
        answers = f"{len(self.health)} answers of /health"
        return [
            f"{answers}, p95 {late:.2f} s, longest {max(self.health):.2f} s",
            f"{len(self.tries)} honest visitors with a run, tries at most {max(self.tries)}",
            _course("memory", self.memory),
            _course("disk", self.disk),
            f"attacks: {dict(self.answers)}",
        ]


def _course(name: str, values: list[int]) -> str:
    most, second, last = (
        f"{v / 1e6:.0f}" for v in (max(values), _part(values, 1), _part(values, 3))
    )
    return f"{name} at most {most} MB, second quarter {second}, last {last}"


def _part(values: list[int], quarter: int) -> float:
    """Median of a quarter of them, of which the first is 0."""
    size = max(len(values) // 4, 1)
    return median(values[quarter * size : (quarter + 1) * size] or values[-1:])


# ---- the honest ---------------------------------------------------------------------------------


def honest(server: Server, number: int, start: float, record: Record) -> None:
    """Come at some time, and try until the result is there."""
    time.sleep(start)
    visitor = Attacker(server, address=f"10.1.{number // 250}.{number % 250}")
    for attempt in range(1, 1000):
        status, text = visitor.upload(DUCK)
        if status == 200 and _had_a_run(visitor, json.loads(text)[0]):
            record.tries.append(attempt)
            return
        time.sleep(2)
    raise AssertionError(f"no run in 999 tries:\n{server.said()}")


def _had_a_run(visitor: Attacker, path: str) -> bool:
    shown = visitor.press("picture", "choose", [], upload=path)[0]
    if not shown.get("job") or visitor.followed(shown["job"])["state"] != "done":
        return False
    visitor.press("picture", "cut", [None, None], job=shown["job"])
    wanted = scene()
    run = visitor.press("go", "click", [None, wanted, None])[0]
    if not run.get("job"):
        return False  # the queue is full
    answer = visitor.followed(run["job"])
    assert answer["state"] == "done", answer
    pack = visitor.shown(run["job"], wanted)["pack"]["path"]
    return visitor.get(f"/gradio_api/file={pack}")[0] == 200


# ---- the others ---------------------------------------------------------------------------------


def _forces(attacker: Attacker) -> None:
    attacker.press("scene", "change", [None, {"forces": [{"kind": "uniform"}] * 800}, None, 1])


def _numbers(attacker: Attacker) -> None:
    attacker.post("/gradio_api/run/predict", {"fn_index": 0, "data": [1] * 500_000})


def _streams(attacker: Attacker) -> None:
    with ExitStack() as stack:
        for number in range(40):
            head = f"GET /gradio_api/heartbeat/{number} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
            stack.enter_context(attacker.slow_socket(head.encode()))
        time.sleep(3)


def _slow(attacker: Attacker) -> None:
    with ExitStack() as stack:
        for _ in range(40):
            stack.enter_context(attacker.slow_socket())
        time.sleep(3)


def _exports(attacker: Attacker) -> None:
    path = {"path": attacker.uploaded(DUCK)}
    attacker.generate(path, formats=["html", "ply", "glb"], frames=24, compose=True)


def _newcomers(attacker: Attacker) -> None:
    for _ in range(20):
        Attacker(attacker.server, address=attacker.address).upload(b"1")


def _nobody(attacker: Attacker) -> None:
    for _ in range(20):
        Attacker(attacker.server, cookie=False, address=attacker.address).upload(DUCK)


def _foreign(attacker: Attacker) -> None:
    for address in ("run/predict", "upload", "queue/join"):
        assert attacker.send("POST", f"/gradio_api/{address}", b"{}", FOREIGN)[0] == 403


def _runs(attacker: Attacker) -> None:
    """Start as many jobs as may wait, and leave."""
    if _cut(attacker):
        for seed in range(5):
            attacker.press("go", "click", [None, scene(seed=seed, **{"time.frames": 24}), None])


def _touch(attacker: Attacker) -> None:
    """Request a live run and never connect, or connect and disappear."""
    if _cut(attacker):
        attacker.press("begin-touch", "click", [None, scene(), None])
        if random.random() < 0.3:
            attacker.hold(scene()).close()


def _pictures(attacker: Attacker) -> None:
    for data in (bomb(16_000), png_claiming(30_000, 30_000), DUCK[:9000], b"x" * 99):
        attacker.choose(attacker.uploaded(data))


def _strokes(attacker: Attacker) -> None:
    stroke = {"keep": True, "width": 0.1, "points": [[0.5, 0.5]] * 2000}
    shown = {"picture": {"path": attacker.uploaded(DUCK)}}
    attacker.press("picture", "correct", [shown, None], strokes=[stroke] * 200)


def _cut(attacker: Attacker) -> bool:
    job = attacker.press("picture", "choose", [], upload=attacker.uploaded(DUCK))[0].get("job")
    if job and attacker.followed(job)["state"] == "done":
        attacker.press("picture", "cut", [None, None], job=job)
    return bool(job)


ATTACKS: list[Callable[[Attacker], None]] = [
    _forces, _numbers, _streams, _slow, _exports, _newcomers, _nobody, _foreign, _runs, _touch,
    _pictures, _strokes,
]  # fmt: skip


def hostile(server: Server, number: int, least: int, over: threading.Event, record: Record) -> None:
    """Attack in one way after the other, with a new cookie each time, until it is over.

    The first attacks are made in any case, `least` in number; those of all hostile visitors
    together are all kinds of attacks.
    """
    choice, first = random.Random(number), number * least % len(ATTACKS)
    for tried, attack in enumerate(itertools.cycle(ATTACKS[first:] + ATTACKS[:first])):
        if over.is_set() and tried >= least:
            return
        # What is refused, or answered by a lost connection, is as it should be.
        with suppress(OSError, AssertionError, ValueError, LookupError, TypeError, AttributeError):
            attack(Attacker(server, address=f"10.2.0.{number % ADDRESSES}"))
        record.answers[attack.__name__] += 1
        over.wait(choice.uniform(0, 2))


# ---- all together -------------------------------------------------------------------------------


def watch(server: Server, over: threading.Event, record: Record) -> None:
    """Look at the server every half second."""
    while not over.is_set():
        start = time.monotonic()
        assert server.health()["status"] == "ok"
        record.health.append(time.monotonic() - start)
        record.memory.append(server.memory())
        record.disk.append(size_of(server.folder))
        over.wait(0.5)


def attack(server: Server, seconds: float, visitors: int) -> Record:
    """Let half of so many visitors attack for so long, while the others come for a run each."""
    record, over = Record(), threading.Event()
    count, chance = visitors // 2, random.Random(0)
    least = math.ceil(len(ATTACKS) / count)
    with ThreadPoolExecutor(2 * count + 1) as pool:
        watching = pool.submit(watch, server, over, record)
        hostiles = [pool.submit(hostile, server, n, least, over, record) for n in range(count)]
        starts = [chance.uniform(0, 0.8 * seconds) for _ in range(count)]
        honests = [pool.submit(honest, server, n, at, record) for n, at in enumerate(starts)]
        over.wait(seconds)
        wait(honests)
        over.set()
        for each in (*honests, *hostiles, watching):
            each.result()
    return record


def check(server: Server, record: Record, seconds: float, visitors: int) -> None:
    """Assert that every honest visitor was served, limits held and nothing is left; times are not
    checked."""
    assert len(record.tries) == visitors // 2
    assert set(record.answers) == {attack.__name__ for attack in ATTACKS}
    assert max(record.memory) < MEMORY
    assert max(record.disk) < 1e6 * SETTINGS["max_total_mb"]
    if seconds > SHORT:
        assert _part(record.memory, 3) - _part(record.memory, 1) < GROWTH
        assert _part(record.disk, 3) < 2 * _part(record.disk, 1)
    server.until_idle()
    server.until(lambda: server.health()["visitors"] == 0, "everybody's leaving")
    server.until(lambda: not server.files(), "an end of all files")
    server.until(lambda: server.threads() == 0, "an end of all threads")
    server.until(lambda: not server.children(), "an end of all processes")


def main() -> None:
    """Serve, attack and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--visitors", type=int, default=200)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        with serving(Path(folder), **SETTINGS) as server:
            record = attack(server, asked.seconds, asked.visitors)
            sys.stdout.write("\n".join([*record.lines(), ""]))
            check(server, record, asked.seconds, asked.visitors)
        assert [path.name for path in server.folder.iterdir()] == [LOCK]


if __name__ == "__main__":
    main()
