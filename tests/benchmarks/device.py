"""Measures the speed of a device: particle-substeps per second, and the time of the paper's clip.

throughput: a cube of fixed corotated jelly falls with the paper's fixed substep of 1e-4 s. The time
  of a substep is compared with two lower bounds, measured on the same device. The first is the time
  to copy the bytes that a substep must move. The second is the time of a substep of 64 particles,
  which consists of launches only.
clip: 14 frames of 400 substeps of 65,536 Gaussians, each of which is a particle (the paper took
  15.67 s on an A40). The same duration is also simulated with the longest stable substeps.

`python tests/benchmarks/device.py [cpu | cuda]` prints one JSON line for each. Numbers after the
device replace the numbers of particles.
"""

import json
import platform
import sys
import time

import numpy as np
import warp as wp
from mpm import cube

from phy124.generators.shapes import ball
from phy124.materials import FixedCorotated
from phy124.mpm import Solver
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

wp.config.log_level = wp.LOG_WARNING
SUBSTEP = 1e-4
FRAMES, PER_FRAME = 14, 400
COUNTS = (65_536, 1_000_000)
BYTES = {"scatter": 104, "gather": 168}
"""Bytes a particle reads and writes in float32, without those of the nodes."""
COPIED = 2**28
"""Bytes copied to measure how fast."""


def name_of(device: str) -> str:
    """The device as its maker calls it."""
    if device == "cpu":
        return platform.processor() or platform.machine()
    return str(wp.get_device(device).name)


def pace(s: Solver, substeps: int, turns: int = 5) -> float:
    """Least wall seconds per substep; the first turn compiles and captures."""
    best = np.inf
    for turn in range(turns + 1):
        before, start = s.clock.substeps, time.perf_counter()
        s.advance(s.clock.time + substeps * SUBSTEP)
        wp.synchronize()
        if turn:
            best = min(best, (time.perf_counter() - start) / (s.clock.substeps - before))
    return float(best)


def bandwidth(device: str) -> float:
    """Bytes per second, read and written, of a copy."""
    a, b = (wp.zeros(COPIED, dtype=wp.uint8, device=device) for _ in range(2))
    best = np.inf
    for _ in range(5):
        wp.synchronize()
        start = time.perf_counter()
        wp.copy(a, b)
        wp.synchronize()
        best = min(best, time.perf_counter() - start)
    return 2 * COPIED / float(best)


def throughput(device: str, counts: tuple[int, ...]) -> None:
    """A row per count."""
    speed = bandwidth(device)
    launches = pace(cube(64, 16, FixedCorotated, "plain", 1, device), 200)
    for count in counts:
        cells = round(64 * (count / 65_536) ** (1 / 3))
        form, threads = ("simd", 2) if device == "cpu" else ("plain", 1)
        s = cube(count, cells, FixedCorotated, form, threads, device)
        seconds = pace(s, max(8, 20_000_000 // count))
        row = {
            "particles": count,
            "cells": cells,
            "us_per_substep": seconds * 1e6,
            "million_per_s": count / seconds / 1e6,
            "launch_floor_us": launches * 1e6,
            "memory_floor_us": count * sum(BYTES.values()) / speed * 1e6,
            "copies_gb_per_s": speed / 1e9,
        }
        show("throughput", device, row)


def clip(device: str, count: int) -> None:
    """The paper's fixed substep, then our own."""
    fps = 1 / (PER_FRAME * SUBSTEP)
    usual = {"time.fps": fps, "time.frames": FRAMES + 1, "material.law": "fixed_corotated"}
    accuracy = {"cells": 32, "particles_per_axis": 1.0, "precision": "float32"}
    for name, substep in (("fixed", SUBSTEP), ("adaptive", None)):
        options = {**usual, "accuracy": accuracy, "binding": "particles", "time.substep": substep}
        scene = Scene.named("bounce").replaced(options)
        for _ in range(2):  # The first compiles and captures.
            run = Simulation(prepare(ball(count), scene, RunContext(device=device)))
            start = time.perf_counter()
            run.run()
            seconds = time.perf_counter() - start
        row = {
            "substeps_by": name,
            "gaussians": count,
            "particles": len(run.setup.particles),
            "substeps": run.solver.clock.substeps,
            "seconds": seconds,
            "simulate": run.setup.context.watch.seconds["simulate"],
            "deform": run.setup.context.watch.seconds["deform"],
        }
        show("clip", device, row)


def show(what: str, device: str, row: dict) -> None:
    """One line."""
    short = {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in row.items()}
    print(json.dumps({"what": what, "device": name_of(device), **short}), flush=True)


if __name__ == "__main__":
    chosen = sys.argv[1] if len(sys.argv) > 1 else "cpu"
    counts = tuple(int(word) for word in sys.argv[2:]) or COUNTS
    throughput(chosen, counts)
    clip(chosen, counts[0])
