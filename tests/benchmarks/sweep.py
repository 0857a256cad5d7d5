"""Clips per hour of a sweep: one process, one worker, two; and what a million would take.

The queue is simulated: a driver that hands out a task in so much time, workers that are free or
not. It is compared with the measured runs, then asked for numbers of workers that nobody here has.

Run: python tests/benchmarks/sweep.py [--clips 120] [--cores 64 512 4096]
"""

import argparse
import heapq
import tempfile
import time
from pathlib import Path

import numpy as np

from phy124.sweep import Plan, Sweep, run
from phy124.sweep.manifest import read_manifest
from phy124.sweep.storage import Storage

ROOT = Path(__file__).parents[2]
PRICE = 0.04
"""Price of an hour of one rented core [dollars], as clouds ask for ordinary ones."""
STORED = 0.023
"""Price of a gigabyte in an object store for a month [dollars]."""


def measured(plan: Plan, workers: int) -> tuple[float, np.ndarray, float]:
    """Wall time of a whole sweep [s], the seconds of its clips, and bytes per clip."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        counts = run(plan, folder, workers=workers)
        wall = time.perf_counter() - begun
        assert counts.ended["done"] == len(plan), counts
        rows = read_manifest(Storage(folder))
    # Gaussians that several clips share count once.
    shared = {(r["picture"], r["generator"]): r["seconds.generate"] for r in rows}
    clips = np.array([row["seconds.clip"] for row in rows])
    clips[: len(shared)] += [*shared.values()]
    return wall, clips, float(np.mean([row["bytes"] for row in rows]))


def queued(seconds: np.ndarray, workers: int, handing_out: float, start: float) -> float:
    """Wall time of a driver that hands out tasks to the worker that is free first [s]."""
    free = [start] * workers
    driver = start
    for each in seconds:
        driver = max(driver, heapq.heappop(free)) + handing_out
        heapq.heappush(free, driver + each)
    return max(free)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clips", type=int, default=120)
    parser.add_argument("--cores", type=int, nargs="+", default=[64, 512, 4096])
    given = parser.parse_args()
    spread = {"first": 1e4, "last": 1e5, "count": given.clips // 4, "spacing": "log"}
    pictures = [str(ROOT / f"demo/examples/{n}.png") for n in ("duck", "teddy", "cupcake", "chick")]
    plan = Plan(Sweep.from_data({
        "pictures": pictures, "set": {"accuracy": "draft", "material.E": spread},
    }))  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:  # kernels are compiled here
        run(plan, folder, workers=0, shard=(1, len(plan)))
    walls = {}
    for workers in (0, 1, 2):
        walls[workers], seconds, size = measured(plan, workers)
        spare = walls[workers] * max(workers, 1) - seconds.sum()
        print(
            f"workers {workers}: {walls[workers]:.1f} s for {len(plan)} clips; the work itself "
            f"{seconds.sum():.1f} s; besides {spare / len(plan):.3f} s per clip "
            f"({spare / seconds.sum():.1%})",
            flush=True,
        )
    print(f"speed-up of two workers over one: {walls[1] / walls[2]:.2f}, "
          f"over one process: {walls[0] / walls[2]:.2f}")  # fmt: skip
    begun = time.perf_counter()
    for index in range(len(plan)):
        plan.scene_of(plan.item(index))
    planning = (time.perf_counter() - begun) / len(plan)
    start = walls[1] - seconds.sum() - planning * len(plan)
    for workers in (1, 2):
        told = queued(seconds, workers, planning, start)
        print(f"simulated queue, {workers} workers: {told:.1f} s, measured {walls[workers]:.1f} s")
    print(f"a driver hands out a clip in {1e3 * planning:.2f} ms: {1 / planning:.0f} per second")
    many = np.random.default_rng(0).choice(seconds, 1_000_000)
    hours = many.sum() / 3600
    print(
        f"a million clips: {hours:.0f} CPU-hours, {PRICE * hours:.0f} dollars at {PRICE} per hour "
        f"of a core, {size / 1e3:.0f} GB, {STORED * size / 1e3:.0f} dollars per month of storage"
    )
    for cores in given.cores:
        wall = queued(many, cores, planning, start)
        busy = many.sum() / cores / wall
        print(f"  {cores} cores: {wall / 3600:.2f} h, each busy for {busy:.0%} of it")


if __name__ == "__main__":
    main()
