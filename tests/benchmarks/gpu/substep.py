"""Measures one substep, kernel by kernel, and the time of its memory transfers.

The substep is run as a graph and by launches of the host. A cube of neo-Hookean jelly falls on the
ground in the paper's domain of 64 cells. The lower bound of a kernel's time is the time to copy its
bytes, where each node counts once.
"""

import json
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from arguments import device_asked

sys.path.insert(0, str(Path(__file__).parents[1]))
from device import SUBSTEP, bandwidth, pace
from mpm import cube

from phy124.materials import NeoHookean
from phy124.mpm import Solver

wp.config.log_level = wp.LOG_WARNING
SUBSTEPS = 200
BYTES = {"p2g": (104, 16), "g2p": (168, 16), "grid": (0, 32), "clear": (0, 16)}
"""Kernel -> bytes per particle and per node in float32."""


def falling(count: int, device: str, graph: bool) -> Solver:
    """The cube; by the host's loop or as a graph."""
    made = cube(count, 64, NeoHookean, "plain", 1, device)
    made.on_device = graph
    return made


def by_kernel(s: Solver, device: str) -> dict[str, float]:
    """Microseconds of each kernel per substep, by the host's loop."""
    s.advance(s.clock.time + 10 * SUBSTEP)
    before = s.clock.substeps
    if device == "cpu":
        s.timings.clear()
        s.advance(s.clock.time + SUBSTEPS * SUBSTEP)
        taken = s.clock.substeps - before
        return {name: spent / taken * 1e6 for name, (spent, _) in s.timings.items()}
    wp.timing_begin(cuda_filter=wp.TIMING_ALL)
    s.advance(s.clock.time + SUBSTEPS * SUBSTEP)
    wp.synchronize()
    outcome: dict[str, float] = defaultdict(float)
    for result in wp.timing_end():
        outcome[result.name.split("__")[-1]] += result.elapsed * 1e3
    taken = s.clock.substeps - before
    return {name: spent / taken for name, spent in outcome.items()}


def floor(name: str, s: Solver, speed: float) -> float | None:
    """Microseconds that the memory of a kernel takes, or None."""
    for kernel, (particle, node) in BYTES.items():
        if kernel in name:
            return (particle * len(s.model) + node * s.grid.count) / speed * 1e6
    return None


def show(**row: Any) -> None:
    """One line."""
    short = {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in row.items()}
    print(json.dumps(short), flush=True)


def main(count: int, device: str) -> None:
    """Kernels, then graph against host."""
    speed = bandwidth(device)
    show(what="copy", gb_per_s=speed / 1e9)
    s = falling(count, device, graph=False)
    for name, us in sorted(by_kernel(s, device).items(), key=lambda item: -item[1]):
        show(what="kernel", name=name, us=us, memory_floor_us=floor(name, s, speed))
    ends = []
    for graph in (False, True):
        s = falling(count, device, graph)
        start = time.perf_counter()
        us = pace(s, SUBSTEPS) * 1e6
        way = "graph" if graph else "host"
        show(
            what="substep",
            by=way,
            particles=count,
            nodes=s.grid.count,
            us=us,
            measured_s=time.perf_counter() - start,
        )
        ends.append(s.state.x.numpy())
    show(what="graph against host", largest_distance_m=float(np.abs(ends[0] - ends[1]).max()))


if __name__ == "__main__":
    inputs = device_asked(__doc__, 65_536)
    main(inputs.count, inputs.device)
