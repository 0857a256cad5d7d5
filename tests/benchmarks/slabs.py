"""Computes the speed-up of the solver by N threads, from the measured work of each worker.

The workers of each phase run one after the other on one thread, and the processor time of each is
measured. A machine with two cores can thus show the speed of a machine with sixteen cores, if its
memory is fast enough. A substep takes as long as the slowest worker of each phase. For every
launch, a thread holds Python's global lock. N workers hold it N times as long in total, and no
substep can be shorter than this time. The time of waiting at barriers is added; the barriers are
counted.

    python tests/benchmarks/slabs.py          one JSON line per object and number of threads
    python tests/benchmarks/slabs.py halo     nodes of slabs over the frames of presets
    python tests/benchmarks/slabs.py pair     one and two threads in turn on this machine
    python tests/benchmarks/slabs.py live     frames of a live run on a lattice
"""

import json
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.boundaries import Ground, Sphere
from phy124.forces import Gravity
from phy124.live import Live
from phy124.materials import NeoHookean
from phy124.monitor.external_work import ExternalWork
from phy124.mpm import Solver, workers
from phy124.mpm.runner import Runner
from phy124.mpm.threads import Task, Team
from phy124.pipeline import make_gaussians
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import make_solver
from support.shapes import cloud

COUNTS = (1, 2, 4, 8, 16)
OBJECTS = {
    "cube, 24 cells": (110_592, 24, (1.0, 1.0, 1.0)),
    "column, 48 cells": (98_304, 48, (0.4, 0.4, 1.0)),
    "cube, 48 cells": (884_736, 48, (1.0, 1.0, 1.0)),
}
"""Particles, cells of the longest side, and sides [m]: eight particles in a cell."""
NODE_BYTES = 16


def body(name: str, threads: int, *, ball: bool = False) -> Solver:
    """An object that falls on the floor, or on a ball, its balance checked as in every run."""
    count, cells, sides = OBJECTS[name]
    x = cloud(count, size=1.0, corner=0.0, dx=1 / cells) * sides
    axis = int(np.argmax(sides))
    if axis and threads > 1:  # as Simulation orders them
        x = x[np.argsort(workers.layers(x, axis, 1 / cells), kind="stable")]
    work, volume = ExternalWork(), np.full(count, np.prod(sides) / count)
    wall = Sphere(centre=(sides[0] / 2, sides[1] / 2, -0.2), radius=0.22) if ball else Ground()
    s = make_solver(
        x,
        volume,
        [NeoHookean(E=1e5)],
        dx=1 / cells,
        forces=[Gravity()],
        boundaries=work.wrap_walls([wall], [wall]),
        accumulators=[work],
        threads=threads,
    )
    s.clock.ceiling = 1e-4
    work.open(s.clock)
    s.step(1e-4, 1e-4)
    return s


def counted(name: str, threads: int, *, ball: bool, rounds: int = 5) -> dict[str, Any]:
    """Return the time of the slowest worker in each phase, least of some rounds, and the nodes of
    slabs."""
    s = body(name, threads, ball=ball)
    spent = np.full((rounds, len(s.workers[0].phases), threads), np.inf)
    for turn in range(rounds):
        s._measure_if_due()
        s.clock.begin(1e-4, 1e-4)
        for phase in range(spent.shape[1]):
            for index, worker in enumerate(s.workers):
                start = time.thread_time_ns()
                worker.run(phase)
                spent[turn, phase, index] = (time.thread_time_ns() - start) / 1000
        s.clock.finish(1e-4)
    least = spent.min(axis=0)
    private = s.slabs.pool.shape[0] * NODE_BYTES if s.slabs else 0
    return {
        "object": name + (" on a ball" if ball else ""),
        "threads": threads,
        "slab_nodes_per_window_node": round(s.slabs.share, 2) if s.slabs else 0,
        "private_MB": round(private / 1e6, 2),
        "full_windows_MB": round((threads > 1) * threads * s.grid.count * NODE_BYTES / 1e6, 2),
        "meetings": len(least) + 1 if threads > 1 else 0,
        "phases_us": np.round(least.max(axis=1)).astype(int).tolist(),
        "substep_us": round(float(least.max(axis=1).sum())),
        "work_us": round(float(least.sum())),
        "launches": sum(len(phase) for worker in s.workers for phase in worker.phases),
    }


def lock_us() -> float:
    """Return how long a launch by a worker holds Python's lock [us], from launches over a few
    nodes."""
    s = make_solver(
        np.random.default_rng(0).uniform(size=(16, 3)),
        np.full(16, 1 / 16),
        [NeoHookean()],
        dx=1.0,
        threads=2,
    )
    s.step(1e-6, 1e-6)
    worker, rounds = s.workers[1], 2000
    launches, start = sum(map(len, worker.phases)), time.thread_time()
    for _ in range(rounds):
        for phase in range(len(worker.phases)):
            worker.run(phase)
    return (time.thread_time() - start) / rounds / launches * 1e6


def halo() -> None:
    """Nodes of slabs per node of the window over a run, as they are cut and if never cut anew."""
    scenes = {
        "spin": ("spin", {"object.spin": [0.0, 6.0, 0.0]}),
        "sand": ("sand", {}),
        "water": ("water", {}),
        "press": ("press", {}),
    }
    usual = workers.NODES
    for name, (preset, changes) in scenes.items():
        scene = Scene.named(preset).replaced({"accuracy.cells": 20, "time.frames": 30, **changes})
        for threads in (2, 4, 16):
            row: dict[str, Any] = {"scene": name, "threads": threads}
            for label, nodes in (("as it is", usual), ("cut anew early", 0), ("never", 10**9)):
                workers.NODES = nodes
                run, shares, most = (
                    Simulation(prepare(bar(), scene, RunContext(threads=threads))),
                    [],
                    0,
                )
                for _ in run:
                    shares.append(run.solver.slabs.share)
                    most = max(most, len(run.solver.slabs.pool))
                row[label] = {
                    "mean": round(float(np.mean(shares[1:])), 2),
                    "largest": round(max(shares), 2),
                    "nodes_per_particle": round(most / len(run.setup.particles), 1),
                    "lists": any(len(part.chosen) for part in run.solver.slabs.parts),
                }
            print(json.dumps(row), flush=True)
    workers.NODES = usual


def bar() -> Any:
    """The bar with a knob whose clips `fingerprints.py` compares."""
    from fingerprints import body as made

    return made(1500)


def pair(rounds: int = 6, substeps: int = 40) -> None:
    """Wall and processor time of a substep with one and two threads in turn, least of rounds."""
    name = next(iter(OBJECTS))
    solvers = {threads: body(name, threads) for threads in (1, 2)}
    least: dict[int, list[float]] = {}
    for _ in range(rounds):
        for threads, s in solvers.items():
            wall, cpu, before = time.perf_counter(), time.process_time(), s.clock.substeps
            s.advance(s.clock.time + substeps * 1e-4)
            done = s.clock.substeps - before
            result = [(time.perf_counter() - wall) / done, (time.process_time() - cpu) / done]
            least[threads] = np.minimum(result, least.get(threads, result)).tolist()
    for threads, (wall, cpu) in least.items():
        row = {"object": name, "threads": threads, "wall_ms": wall * 1e3, "cpu_ms": cpu * 1e3}
        print(json.dumps({k: round(v, 2) if isinstance(v, float) else v for k, v in row.items()}))


def live(rounds: int = 4, frames: int = 21) -> None:
    """Milliseconds per frame of a live `press` of the duck on a lattice of 32 cells: processor time
    of all threads, and time with the slowest worker of each task only."""
    gaussians = make_gaussians(Path(__file__).parents[2] / "demo/examples/duck.png").gaussians
    scene, others = Scene.named("press").replaced({"accuracy.cells": 32}), [0.0]

    def in_turn(self: Team, task: Task) -> None:
        spent = []
        for member in range(self.size):
            start = time.process_time()
            task(member)
            spent.append(time.process_time() - start)
        others[0] += sum(spent) - max(spent)

    Team.complete, Runner.on_threads = in_turn, lambda self: nullcontext()
    least: dict[int, list[float]] = {}
    for _ in range(rounds):
        for threads in (1, 2, 4):
            run = Live(gaussians, scene, RunContext(threads=threads), shapes=False)
            run.step()
            run.step()
            start, others[0] = time.process_time(), 0.0
            for _ in range(frames):
                run.step()
            work = time.process_time() - start
            result = [1e3 * work / frames, 1e3 * (work - others[0]) / frames]
            least[threads] = np.minimum(result, least.get(threads, result)).tolist()
    for threads, (work, slowest) in least.items():
        row = {"threads": threads, "work_ms": round(work, 1), "frame_ms": round(slowest, 1)}
        print(json.dumps(row))


def main() -> None:
    """All counts, or what is asked for."""
    asked = sys.argv[1:]
    if asked == ["halo"]:
        halo()
    elif asked == ["pair"]:
        pair()
    elif asked == ["live"]:
        live()
    else:
        print(json.dumps({"lock_us_per_launch": round(lock_us(), 1)}))
        for name in OBJECTS:
            for threads in COUNTS:
                print(json.dumps(counted(name, threads, ball=False)), flush=True)
        for threads in COUNTS:
            print(json.dumps(counted(next(iter(OBJECTS)), threads, ball=True)), flush=True)


if __name__ == "__main__":
    main()
