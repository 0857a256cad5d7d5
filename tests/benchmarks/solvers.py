"""Runs both solvers of elastic bodies in turn: CPU time, and distances between their motions.

The program adds a row to solvers.jsonl.gz for each object and scene without a row, so it can be
stopped and started again. At its end it updates the tables of docs/lab/solvers.md:

    nice python tests/benchmarks/solvers.py --objects ../shared/objects --minutes 30

With `--cells 16 32 64` it also compares the motions of both solvers on the finest grid. Objects and
scenes are those of the zoo (zoo.py).
"""

import argparse
import gzip
import json
import sys
import time
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import warp as wp

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

sys.path.insert(0, str(Path(__file__).parent))
from tables import DOCS, markdown, processor, replace_block
from zoo import Row, commit, distance, gaussians_of, objects, scene_of

ROWS = Path(__file__).with_suffix(".jsonl.gz")
NAMES = ("spot", "sword", "duck", "plant", "table", "teddy", "sheet", "koala", "tree", "fish")
SCENES = ("press", "drop", "bounce", "sway", "spin", "pushed")
SOLVERS = ("mpm", "lattice")


def run_once(gaussians: Gaussians, scene: Scene) -> tuple[Row, Clip]:
    """Run a scene in one thread; return its seconds of CPU time, and its clip."""
    start = time.process_time()
    run = Simulation(prepare(gaussians, scene, RunContext(threads=1)))
    middle = time.process_time()
    clip = run.run()
    end = time.process_time()
    report = clip.report
    return {
        "solver": scene.resolution.solver,
        "cells": scene.resolution.cells,
        "complete": report["complete"],
        "particles": report["particles"],
        "substeps": report["substeps"],
        "preparing": round(middle - start, 3),
        "seconds": round(end - middle, 3),
    }, clip


@cache
def warm(words: str) -> None:
    """Load the kernels of a scene, which the first run of a process does."""
    for solver in SOLVERS:
        changes = {"accuracy.cells": 8, "time.frames": 2}
        run_once(gaussians_of("cone", None), scene_of(words, solver).replaced(changes))


def compare(gaussians: Gaussians, words: str, levels: list[int]) -> Row:
    """Run a scene with both solvers in turn, from the coarsest grid to the finest."""
    warm(words)
    runs, clips = [], []
    for cells in levels:
        for solver in SOLVERS:
            changes = {"accuracy.cells": cells, "time.budget": 1e6}
            row, clip = run_once(gaussians, scene_of(words, solver).replaced(changes))
            runs.append(row)
            clips.append(clip)
    apart, size = [], scene_of(words).object.size
    for (first, a), (second, b) in combinations(zip(runs, clips, strict=True), 2):
        if first["complete"] and second["complete"]:
            gaps = distance(a.surface.means, b.surface.means, size)
            names = [f"{run['solver']} {run['cells']}" for run in (first, second)]
            apart.append([*names, float(f"{np.sqrt((gaps**2).mean()):.3g}")])
    return {"runs": runs, "apart": apart}


def rows() -> list[Row]:
    """The rows that were measured."""
    if not ROWS.exists():
        return []
    with gzip.open(ROWS, "rt", encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def measure(args: argparse.Namespace) -> None:
    """Measure what is missing, for some minutes, in a diagonal order."""
    end, known = time.monotonic() + 60 * args.minutes, objects(args.objects)
    there = {(row["object"], row["scene"]) for row in rows() if covers(row, args.cells)}
    for number in range(len(args.names) * len(args.scenes)):
        shift, which = divmod(number, len(args.scenes))
        name, words = args.names[(which + shift) % len(args.names)], args.scenes[which]
        if (name, words) in there:
            continue
        if time.monotonic() > end:
            break
        try:
            result = compare(gaussians_of(name, known[name]), words, args.cells)
        except InputError as refusal:
            print(f"{name} {words}: {refusal}", file=sys.stderr)
            continue
        about = {"machine": processor(), "date": time.strftime("%Y-%m-%d"), "commit": commit()}
        with gzip.open(ROWS, "at", encoding="utf-8") as file:
            file.write(json.dumps({"object": name, "scene": words, **result, **about}) + "\n")
        print(f"{name} {words}", flush=True)


def write_page() -> None:
    """Renew the tables of docs/lab/solvers.md."""
    known, lines, finest = rows(), [], []
    for words in SCENES:
        each = {row["object"]: row for row in known if row["scene"] == words}.values()
        errors = [tuple(error(row, solver, 16, 32) for solver in SOLVERS) for row in each]
        medians = [f"{100 * np.median(error):.2g} %" for error in zip(*errors, strict=True)]
        less = sum(lattice < mpm for mpm, lattice in errors)
        ratios = [[ratio(row, cells) for row in each] for cells in (16, 32)]
        times = [f"{np.median(r):.2f} ({min(r):.2f} to {max(r):.2f})" for r in ratios]
        lines.append([words, len(each), *medians, f"{less} of {len(each)}", *times])
    heads = ["scene", "objects", "error at 16 cells, mpm", "lattice", "lattice is smaller"]
    heads += ["CPU time at 16 cells, lattice / mpm", "at 32 cells"]
    for row in known:
        if covers(row, [64]):
            pairs = [error(row, solver, 32, 64) for solver in SOLVERS]
            across = [apart(row, f"mpm {a}", f"lattice {b}") for a, b in ((32, 64), (64, 32))]
            both = apart(row, "mpm 64", "lattice 64")
            numbers = [f"{100 * number:.2g} %" for number in (*pairs, *across, both)]
            finest.append([row["object"], row["scene"], *numbers, f"{ratio(row, 64):.2f}"])
    more = ["object", "scene", "mpm 32 to mpm 64", "lattice 32 to lattice 64"]
    more += ["mpm 32 to lattice 64", "lattice 32 to mpm 64", "mpm 64 to lattice 64"]
    more += ["CPU time at 64 cells, lattice / mpm"]
    places, days = ({row[name] for row in known} for name in ("machine", "date"))
    text = f"Measured on {'; '.join(sorted(places))}; {', '.join(sorted(days))}."
    replace_block(DOCS / "lab/solvers.md", "solvers", f"{markdown(heads, lines)}\n\n{text}")
    replace_block(DOCS / "lab/solvers.md", "finest", markdown(more, finest))


def apart(row: Row, first: str, second: str) -> float:
    """Return the distance between two motions of a row, in object sizes."""
    return next(d for a, b, d in row["apart"] if {a, b} == {first, second})


def error(row: Row, solver: str, cells: int, finer: int) -> float:
    """Return the distance of a solver's motion from that on its finer grid, in object sizes."""
    return apart(row, f"{solver} {cells}", f"{solver} {finer}")


def ratio(row: Row, cells: int) -> float:
    """Return the CPU time of the dynamics on the lattice, divided by that of MPM."""
    seconds = {run["solver"]: run["seconds"] for run in row["runs"] if run["cells"] == cells}
    return seconds["lattice"] / seconds["mpm"]


def covers(row: Row, levels: list[int]) -> bool:
    """Return whether a row has these grids."""
    return set(levels) <= {run["cells"] for run in row["runs"]}


def main() -> None:
    """Measure what is missing."""
    how = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    how.add_argument("--objects", type=Path, help="folder of .splat files")
    how.add_argument("--names", nargs="+", default=list(NAMES), help="names of objects")
    how.add_argument("--scenes", nargs="+", default=list(SCENES))
    how.add_argument("--cells", nargs="+", type=int, default=[16, 32])
    how.add_argument("--minutes", type=float, default=30)
    args = how.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    measure(args)
    write_page()


if __name__ == "__main__":
    main()
