"""Simulates visitors who arrive at random and run one draft each, and measures how long they wait.

    python tests/benchmarks/load.py --visitors 100 --minutes 60

The server and the visitors share the machine. Each visitor uploads a picture, cuts the object out,
presses Generate once, and follows the run as the page does. The program prints percentiles of the
time from Generate to the second frame in the viewer and to the finished videos. For visitors who
waited at least five seconds, it also prints the ratio of the announced to the actual waiting time.
"""

import json
import os
import random
import sys
import tempfile
import time
from argparse import ArgumentParser
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "abuse"))

from attacker import Attacker

from phy124.scene import Scene
from support.served import ROOT, Server, serving

EXAMPLES = sorted((ROOT / "demo/examples").glob("*.png"))
NOTICEABLE = 5.0
"""Shortest waiting time whose announcement is judged [s]."""


@dataclass
class Visit:
    """Times since Generate [s]."""

    moving: float = np.nan
    finished: float = np.nan
    announced: float = np.nan
    """Waiting time that was shown first."""
    waited: float = 0.0
    state: str = "refused"


def visit(server: Server, number: int, arrival: float, preset: str) -> Visit:
    """Arrive, generate one draft and follow it."""
    time.sleep(arrival)
    visitor = Attacker(server, address=f"10.2.{number // 250}.{number % 250}")
    path = visitor.uploaded(EXAMPLES[number % len(EXAMPLES)].read_bytes())
    cutting = visitor.press("picture", "choose", [], upload=path)[0]["job"]
    visitor.followed(cutting)
    visitor.press("picture", "cut", [None, None], job=cutting)
    scene = Scene.named(preset).replaced({"accuracy": "draft"}).data()
    start, seen = time.monotonic(), Visit()
    run = visitor.press("go", "click", [None, scene, None])[0]
    if not run.get("job"):
        return seen
    for answer in visitor.following(run["job"]):
        now = time.monotonic() - start
        seen.state = answer["state"]
        if answer["state"] == "waiting":
            seen.waited = now
            if answer["place"] and np.isnan(seen.announced):
                seen.announced = now + answer["wait"]
        elif len(answer["live"]) >= 2 and np.isnan(seen.moving):
            seen.moving = now
    seen.finished = time.monotonic() - start
    return seen


def _row(name: str, values: list[float], unit: str) -> str:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return f"| {name} | 0 | | | |"
    half, most = np.percentile(known, [50, 95])
    return f"| {name} | {len(known)} | {half:.1f} | {most:.1f} | {max(known):.1f} {unit} |"


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--visitors", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--preset", default="press")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    arrivals = sorted(rng.uniform(0, 60 * options.minutes) for _ in range(options.visitors))
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(Path(folder), max_visitors=512) as server,
        ThreadPoolExecutor(options.visitors) as threads,
    ):
        jobs = [
            threads.submit(visit, server, number, arrival, options.preset)
            for number, arrival in enumerate(arrivals)
        ]
        visits = [job.result() for job in jobs]
        memory = server.peak_memory() / 1e6
    waiting = [v for v in visits if np.isfinite(v.announced) and v.waited >= NOTICEABLE]
    print("| | visitors | median | p95 | largest |\n|---|--:|--:|--:|--:|")
    print(_row("Generate to the second frame", [v.moving for v in visits], "s"))
    print(_row("Generate to the videos", [v.finished for v in visits if v.state == "done"], "s"))
    print(_row("true waiting time", [v.waited for v in visits if v.waited >= NOTICEABLE], "s"))
    print(_row("announced / true waiting time", [v.announced / v.waited for v in waiting], ""))
    within = sum(0.7 <= v.announced / v.waited <= 1.3 for v in waiting)
    states = {state: sum(v.state == state for v in visits) for state in {v.state for v in visits}}
    print(f"\nWithin 30 %: {within} of {len(waiting)}. Runs: {json.dumps(states)}.")
    print(f"Greatest resident memory: {memory:.0f} MB. Load: {os.getloadavg()[0]:.0f}.")


if __name__ == "__main__":
    main()
