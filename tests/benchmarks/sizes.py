"""Measures time and memory of whole commands for many Gaussians, cells and frames.

    python tests/benchmarks/sizes.py ../shared/objects/koala.splat [--most N] [--longest FRAMES]

Each case runs in a separate process. The tables of docs/lab/sizes.md are updated row by row, so a
run that is stopped keeps its rows. `python tests/benchmarks/summaries.py` then draws the plot and
copies the tables to docs/results/scale.md. With --most 5_000_000 and --longest 2000 a run takes
about ten minutes on two idle cores. `finer.py` makes the files with many Gaussians.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from tables import DOCS, markdown, renew

PAGE = DOCS / "lab/sizes.md"
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
COPIES = (1, 5, 50, 200, 500)
"""Gaussians in place of each of the source's 10,000."""
CELLS = (16, 32, 64)
FRAMES = (14, 140, 700, 2000)


class Cost(NamedTuple):
    """Time and memory of one process."""

    wall: float
    """Elapsed time [s]."""
    processor: float
    """Processor time, including that of the encoders [s]."""
    memory: float
    """Largest memory of the process [GB]."""
    first: float | None
    """Time until the first frame was computed [s]; None if it computes no frames."""


def measure(*words: object) -> Cost:
    """Run a command of phy124 and measure its process."""
    command = [sys.executable, "-m", "phy124", *map(str, words)]
    begun, first = time.perf_counter(), None
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    for line in process.stderr:
        if first is None and line.startswith("simulate: "):
            first = time.perf_counter() - begun
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit status {process.returncode}")
    wall = time.perf_counter() - begun
    return Cost(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6, first)


def slope(sizes: list[float], values: list[float]) -> float:
    """Return the exponent of a power law through the two largest sizes."""
    return float(np.diff(np.log(values[-2:]))[0] / np.diff(np.log(sizes[-2:]))[0])


class Table:
    """A table of costs against one size; every row is written as soon as it is measured."""

    def __init__(self, name: str, head: str) -> None:
        self.name, self.head = name, head
        self.sizes: list[float] = []
        self.costs: list[Cost] = []

    def add(self, size: int, cost: Cost) -> None:
        """Add a row, with the exponents from the row before."""
        self.sizes.append(size)
        self.costs.append(cost)
        rows = []
        for last, (value, cost) in enumerate(zip(self.sizes, self.costs, strict=True), 1):
            columns = list(zip(*(c[:3] for c in self.costs[:last]), strict=True))
            powers = (
                [f"{slope(self.sizes[:last], c):.2f}" for c in columns] if last > 1 else [""] * 3
            )
            first = "" if cost.first is None else f"{cost.first:.1f}"
            figures = [f"{cost.wall:.1f}", f"{cost.processor:.1f}", f"{cost.memory:.2f}"]
            rows.append([f"{int(value):,}", first, *figures, " / ".join(powers).strip(" /")])
        heads = [self.head, "first frame [s]", "all [s]", "processor [s]", "memory [GB]", "slopes"]
        renew(PAGE, self.name, markdown(heads, rows))


def main() -> None:
    """Measure all cases."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("source", type=Path, help="file of about 10,000 Gaussians (.splat)")
    parser.add_argument("--most", type=int, default=COPIES[-1] * 10_000, help="Gaussians")
    parser.add_argument("--longest", type=int, default=FRAMES[-1], help="frames")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, press = Path(name), ("--scene", "press", "--frames", 14)
        measure("simulate", args.source, *press, "--out", folder / "warm")
        waits(args.source, folder)
        table = Table("gaussians", "Gaussians")
        for copies in COPIES:
            if copies * 10_000 > args.most:
                break
            many = folder / "many.splat"
            finer = [sys.executable, str(Path(__file__).with_name("finer.py"))]
            subprocess.run([*finer, args.source, many, "--times", str(copies)], check=True)
            cost = measure("simulate", many, *press, "--out", folder / "out")
            table.add(many.stat().st_size // 32, cost)
        table = Table("cells", "cells across")
        for cells in CELLS:
            grid = ("--set", f"accuracy.cells={cells}")
            table.add(cells, measure("simulate", args.source, *press, *grid, "--out", folder / "c"))
        table = Table("frames", "frames")
        for frames in FRAMES:
            if frames <= args.longest:
                length = ("--scene", "press", "--frames", frames)
                table.add(frames, measure("simulate", args.source, *length, "--out", folder / "f"))


def waits(source: Path, folder: Path) -> None:
    """Measure what a user waits for: the first frame, and everything, per command."""
    press, clip = ("--scene", "press", "--frames", 14), folder / "duck/clip.safetensors"
    commands: dict[str, tuple[object, ...]] = {
        "phy124 --help": ("--help",),
        "phy124 scenes": ("scenes",),
        "phy124 generate duck.png --scene press": ("generate", DUCK, *press, "--out", clip.parent),
        "phy124 simulate FILE --scene press": ("simulate", source, *press, "--out", folder / "s"),
        "phy124 render CLIP": ("render", clip, "--out", folder / "r"),
        "phy124 export CLIP --to p4d": (
            "export",
            clip,
            "--to",
            "p4d",
            "--out",
            folder / "duck.p4d",
        ),
    }
    rows = []
    for name, words in commands.items():
        cost = measure(*words)
        first = "" if cost.first is None else f"{cost.first:.1f}"
        figures = [f"{cost.wall:.2f}", f"{cost.processor:.2f}", f"{cost.memory:.2f}"]
        rows.append([f"`{name}`", first, *figures])
        heads = ["command", "first frame [s]", "all [s]", "processor [s]", "memory [GB]"]
        renew(PAGE, "waits", markdown(heads, rows))


if __name__ == "__main__":
    main()
