"""Measures clips per hour of a sweep: one process, one and two workers, killed workers; a million.

The queue of a driver and its workers is simulated: the driver distributes a task in a fixed time,
and each worker is free or busy. The simulation is compared with the measured runs, and then used
for larger numbers of workers. Planning is measured with the driver's loop over clips that are not
made.

    python tests/benchmarks/sweep.py [--items 120] [--planned 100000] [--cores 64 512 4096]
"""

import argparse
import hashlib
import heapq
import resource
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phy124.studies.sweep import Counts, Plan, Sweep, run
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.running import _orders
from phy124.studies.sweep.storage import Storage

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.processes import clips_of, killer

ROOT = Path(__file__).parents[2]
PRICE = 0.04
"""Price of an hour of one rented core [dollars], assumed."""
STORED = 0.023
"""Price of a gigabyte in an object store for a month [dollars], assumed."""
EVERY = 5.0
"""Time between two kills [s]."""
PICTURES = ("duck", "teddy", "cupcake", "chick")


class Made(NamedTuple):
    """A whole sweep."""

    wall: float
    seconds: np.ndarray
    """Time of each clip; that of the first clip of a picture includes the Gaussians."""
    bytes: float
    """Per clip."""
    files: dict[str, str]
    """Digest of each."""
    off: list[float]
    """Time left as told after each quarter of the clips, over what it then took."""


def declared(count: int) -> Plan:
    """Draft clips of four pictures and so many stiffnesses."""
    spread = {"first": 1e4, "last": 1e5, "count": count // len(PICTURES), "spacing": "log"}
    pictures = [str(ROOT / f"demo/examples/{name}.png") for name in PICTURES]
    data = {"pictures": pictures, "set": {"accuracy": "draft", "material.E": spread}}
    return Plan(Sweep.from_data(data))


def measured(plan: Plan, workers: int, *, kills: bool = False, shard: tuple[int, int] = (1, 1)):
    """A sweep, or a part of it."""
    counts, answer = Counts(), []

    def look(stage: str, done: int, total: int) -> None:
        if counts.left is not None:
            answer.append((time.perf_counter(), done / total, counts.left))

    with tempfile.TemporaryDirectory() as folder:
        killing = killer(Path(folder), EVERY) if kills else nullcontext([])
        begun = time.perf_counter()
        with killing as killed:
            run(plan, folder, workers=workers, shard=shard, progress=look, counts=counts)
        end = time.perf_counter()
        if kills:
            print(f"{len(killed)} workers were killed; {dict(counts.ended)}", flush=True)
        rows = read_manifest(Storage(folder))
        files = {n: hashlib.sha256(b).hexdigest() for n, b in clips_of(Path(folder)).items()}
    # Gaussians that several clips share count once.
    shared = {(r["picture"], r["generator"]): r["seconds.generate"] for r in rows}
    clips = np.array([row["seconds.clip"] for row in rows])
    clips[: len(shared)] += [*shared.values()]
    off = []
    for part in (0.25, 0.5, 0.75):
        at = next(((now, left) for now, done, left in answer if done >= part), None)
        off.append(at[1] / (end - at[0]) if at else float("nan"))
    return Made(end - begun, clips, float(np.mean([row["bytes"] for row in rows])), files, off)


def queued(seconds: np.ndarray, workers: int, handing_out: float, start: float) -> float:
    """Wall time of a driver that hands out tasks to the worker that is free first [s]."""
    free = [start] * workers
    driver = start
    for each in seconds:
        driver = max(driver, heapq.heappop(free)) + handing_out
        heapq.heappush(free, driver + each)
    return max(free)


def planning(count: int) -> float:
    """Processor time of the driver for each order [s]; prints its memory as they go by."""
    plan = declared(count)
    with tempfile.TemporaryDirectory() as folder:
        begun, counts = time.process_time(), Counts()
        orders = _orders(plan, range(len(plan)), Storage(folder), counts, "cpu")
        for number, _ in enumerate(orders, 1):
            if number in (1000, len(plan) // 10, len(plan) // 2, len(plan)):
                print(f"  {number} orders: {resident():.1f} MB", flush=True)
        return (time.process_time() - begun) / len(plan)


def resident() -> float:
    """Memory of this process now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def compare(count: int) -> tuple[Made, float]:
    """Print what each number of workers takes; returns the run with one, and Ray's start [s]."""
    plan = declared(count)
    measured(plan, 0, shard=(1, len(plan)))  # kernels are compiled here
    first = measured(plan, 1, shard=(1, len(plan)))
    start = first.wall - first.seconds.sum()
    print(f"Ray's start, and its end: {start:.1f} s", flush=True)
    runs = {}
    for workers in (0, 1, 2):
        made = runs[workers] = measured(plan, workers)
        begun = start if workers else 0.0
        spare = (made.wall - begun) * max(workers, 1) - made.seconds.sum()
        off = ", ".join(f"{ratio:.2f}" for ratio in made.off)
        print(
            f"workers {workers}: {made.wall:.1f} s for {len(plan)} clips; the work itself "
            f"{made.seconds.sum():.1f} s; besides it and the start {spare / len(plan):.3f} s per "
            f"clip ({spare / made.seconds.sum():.1%}); time left as told / true: {off}",
            flush=True,
        )
    print(
        f"speed-up of two workers over one: {runs[1].wall / runs[2].wall:.2f}, without the "
        f"start {(runs[1].wall - start) / (runs[2].wall - start):.2f}"
    )
    killed = measured(plan, 2, kills=True)
    same = killed.files == runs[0].files == runs[1].files == runs[2].files
    print(
        f"two workers, one killed every {EVERY:g} s: {killed.wall:.1f} s; all files of all runs "
        f"are {'equal' if same else 'NOT EQUAL'} byte for byte",
        flush=True,
    )
    for workers in (1, 2):
        seconds = queued(runs[1].seconds, workers, 0.0, start)
        print(
            f"simulated queue, {workers} workers: {seconds:.1f} s, "
            f"measured {runs[workers].wall:.1f} s"
        )
    return runs[1], start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--items", type=int, default=120)
    parser.add_argument("--planned", type=int, default=100_000)
    parser.add_argument("--cores", type=int, nargs="+", default=[64, 512, 4096])
    arguments = parser.parse_args()
    made, start = compare(arguments.items)
    print(f"planning {arguments.planned} clips:", flush=True)
    handing_out = planning(arguments.planned)
    print(f"a driver hands out a clip in {1e3 * handing_out:.2f} ms of CPU time")
    many = np.random.default_rng(0).choice(made.seconds, 1_000_000)
    hours = many.sum() / 3600
    print(
        f"a million clips: {hours:.0f} CPU-hours, {PRICE * hours:.0f} dollars at {PRICE} per hour "
        f"of a core, {made.bytes / 1e3:.0f} GB, {STORED * made.bytes / 1e3:.0f} dollars per month "
        "of storage"
    )
    for cores in arguments.cores:
        wall = queued(many, cores, handing_out, start)
        busy = many.sum() / cores / wall
        print(f"  {cores} cores: {wall / 3600:.2f} h, each busy for {busy:.0%} of it")


if __name__ == "__main__":
    main()
