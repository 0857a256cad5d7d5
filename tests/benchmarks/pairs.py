"""Measures the cost of two bodies, in contact and apart, relative to one body of as many particles.

`python tests/benchmarks/pairs.py [THREADS]` prints processor times of runs that are made in turn.
"""

import sys
import time

import numpy as np

from phy124.materials import NeoHookean
from phy124.mpm import Model, Solver, State

SIDE, SUBSTEPS, ROUNDS = 32, 40, 9
"""Particles along an edge of a cube, substeps of a run, and runs of each."""
DX = 2 / SIDE


def cubes(gap: float, *, bodies: int, threads: int) -> Solver:
    """Two cubes of 1 m, so far apart [m], that approach; as two bodies, or as one."""
    axis = (np.arange(SIDE) + 0.5) / SIDE
    cube = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    x = np.vstack([cube, cube + [1 + gap, 0, 0]])
    side = np.repeat([0, 1], len(cube))
    v = np.where(side == 0, 0.2, -0.2)[:, None] * [1.0, 0, 0]
    model = Model.of(
        x,
        np.full(len(x), SIDE**-3.0),
        [NeoHookean(E=1e5)],
        dx=DX,
        body=side if bodies == 2 else None,
    )
    return Solver(model, State.of(model, v), threads=threads)


def seconds(solver: Solver) -> tuple[float, float]:
    """Processor time and duration of a number of substeps [s]."""
    start, begun = time.process_time(), time.perf_counter()
    dt = 0.4 * DX / 12
    with solver.runner.on_threads():
        for _ in range(SUBSTEPS):
            solver.step(dt, dt)
    return time.process_time() - start, time.perf_counter() - begun


def main() -> None:
    threads = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    kinds = {
        "one body, the halves touch": cubes(0.0, bodies=1, threads=threads),
        "two bodies in contact": cubes(0.0, bodies=2, threads=threads),
        "one body, the halves 2 m apart": cubes(2.0, bodies=1, threads=threads),
        "two bodies 2 m apart": cubes(2.0, bodies=2, threads=threads),
    }
    results: dict[str, list[tuple[float, float]]] = {name: [] for name in kinds}
    for solver in kinds.values():
        seconds(solver)
    for _ in range(ROUNDS):
        for name, solver in kinds.items():
            results[name].append(seconds(solver))
    for name, times in results.items():
        cpu, wall = np.min(times, axis=0) / SUBSTEPS * 1e3
        print(f"{name:32} {cpu:7.2f} ms of CPU time, {wall:7.2f} ms per substep")


if __name__ == "__main__":
    main()
