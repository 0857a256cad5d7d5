"""Measures the solver's speed: particle-substeps per second by law, form, threads and size.

A cube of random particles, sorted by cells, falls on a floor with the paper's settings (jelly, E =
1e5, dt = 1e-4), so that the results can be compared with those of other programs. The forms, the
numbers of threads and a simple program of the same law (tests/reference/textbook.py) run in turn in
one process. The best of five rounds counts. The program prints one JSON line for each.
"""

import itertools
import json
import platform
import sys
import time
from pathlib import Path

import numpy as np
import warp as wp

from phy124.boundaries import Ground
from phy124.forces import Gravity
from phy124.materials import FixedCorotated, NeoHookean
from phy124.mpm import Solver

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.studies.validation.bodies import make_solver
from reference.textbook import Textbook
from support.shapes import cloud

wp.config.log_level = wp.LOG_WARNING
FORMS = {"simd": ("float32", True), "plain": ("float32", False), "double": ("float64", False)}


def cube(count: int, cells: int, law: type, form: str, threads: int, device: str = "cpu") -> Solver:
    """A unit cube in a domain of 2 m with `cells` cells per axis."""
    x = cloud(count, size=1.0, corner=0.5, dx=2 / cells)
    precision, simd = FORMS[form]
    return make_solver(
        x,
        np.full(count, 1 / count),
        [law(E=1e5, nu=0.3, density=200)],
        dx=2 / cells,
        forces=[Gravity()],
        boundaries=[Ground(height=0.5)],
        precision=precision,
        simd=simd,
        threads=threads,
        device=device,
        ceiling=1e-4,
    )


def textbook(count: int, cells: int) -> Textbook:
    """The same cube for the straightforward program."""
    x = cloud(count, size=1.0, corner=0.5, dx=2 / cells)
    material = {"E": 1e5, "nu": 0.3, "density": 200}
    return Textbook(x, 1 / count, cells=cells, size=2, floor=0.5, **material)


def round_of(s: Solver | Textbook, substeps: int) -> tuple[float, float]:
    """Wall and CPU seconds per substep."""
    count = s if isinstance(s, Textbook) else s.clock
    wall, cpu, before = time.perf_counter(), time.process_time(), count.substeps
    if isinstance(s, Textbook):
        for _ in range(substeps):
            s.step(1e-4)
    else:
        s.advance(s.clock.time + substeps * 1e-4)
    done = count.substeps - before
    return (time.perf_counter() - wall) / done, (time.process_time() - cpu) / done


def main() -> None:
    sizes = [(20_000, 100), (65_536, 64), (65_536, 100)]
    laws = [NeoHookean, FixedCorotated]
    variants = [("simd", 1), ("plain", 1), ("double", 1), ("simd", 2), ("plain", 2)]
    for (count, cells), law in itertools.product(sizes, laws):
        solvers: dict[tuple[str, int], Solver | Textbook] = {
            v: cube(count, cells, law, *v) for v in variants
        }
        if law is FixedCorotated:
            solvers["textbook", 1] = textbook(count, cells)
        best: dict[tuple[str, int], tuple[float, float]] = {}
        for turn, (variant, s) in itertools.product(range(6), solvers.items()):
            spent = round_of(s, max(8, 1_500_000 // count))
            if turn:
                best[variant] = min(best.get(variant, spent), spent)
        for (form, threads), (wall, cpu) in best.items():
            row = {
                "particles": count,
                "cells": cells,
                "law": law.__name__,
                "form": form,
                "threads": threads,
                "million_particle_substeps_per_s": round(count / wall / 1e6, 2),
                "cpu_ns_per_particle_substep": round(cpu / count * 1e9, 1),
                "processor": platform.processor() or platform.machine(),
            }
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
