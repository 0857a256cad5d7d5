"""The zoo: objects in scenes on several grids, to measure errors and to check what is told of them.

`measure` adds a row to zoo.jsonl for each object and scene that has none, so it can be stopped and
started again; a slice ends after some minutes. `table` rewrites docs/lab/own-error.md:

    nice python tests/benchmarks/zoo.py measure --objects ../shared/objects --minutes 50

A row has the distances of all pairs of grids in each frame. The finest grid, at least twice as fine
as the one that is judged, is the truth. Objects are the files of a folder, which stand on -y, the
pictures of demo/examples, and solids that need no file.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from itertools import combinations, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray
from trimesh import Trimesh, creation

from phy124 import pipeline
from phy124.accuracy.companion import FLOOR, RATIO, estimate, factors_of
from phy124.accuracy.promises import promise
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.mesh import mesh
from phy124.io.clip import Clip
from phy124.io.formats import read_gaussians
from phy124.particles.solid import ACROSS, find_solid
from phy124.particles.thickness import local_thickness
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import DOCS, markdown, processor, replace_block

ROOT = Path(__file__).parents[2]
ROWS = Path(__file__).with_suffix(".jsonl")
GRIDS = {"draft": (8, 16, 32), "standard": (10, 16, 20, 32, 64), "fine": (24, 48, 96)}
"""Name -> cells across the object: companions, the grid that is judged, and last the truth."""
COLOUR = (0.6, 0.4, 0.3)
QUANTILES = (0.05, 0.1, 0.25, 0.5)
"""Fractions of the volume of which the local thickness is measured."""
TOP = {"lower": (-1e9, -1e9, 0.5)}
PUSH = {"kind": "acceleration", "a": (0.0, 6.0, 0.0), "end": 0.15, "region": TOP}
Change = dict[str, Any]
SCENES: dict[str, tuple[str, Change]] = {
    **{name: (name, {}) for name in ("press", "drop", "sway", "spin", "bounce", "collide")},
    "wind": ("wind", {"binding": "lattice"}),
    "pushed": ("drop", {"object.lift": 0.0, "forces": [{"kind": "gravity"}, PUSH]}),
    "plasticine press": ("press", {"material": {"law": "plasticine"}}),
    "sand drop": ("drop", {"material": {"law": "sand"}}),
    "snow drop": ("drop", {"material": {"law": "snow"}}),
    "fluid drop": ("drop", {"material": {"law": "fluid"}}),
}
"""Name -> preset and changes to its beginning."""


def ball(radius: float, *centre: float) -> Trimesh:
    """A ball around a point."""
    return creation.icosphere(radius=radius).apply_translation(centre)


def rod(radius: float, height: float, *centre: float) -> Trimesh:
    """An upright rod around a point."""
    return creation.cylinder(radius=radius, height=height).apply_translation(centre)


def box(*sides: float, centre: tuple[float, float, float] = (0, 0, 0)) -> Trimesh:
    """A box around a point."""
    return creation.box(sides).apply_translation(centre)


def bush() -> Trimesh:
    """A stem with a cluster of balls."""
    rng = np.random.default_rng(11)
    centres = rng.normal(0, 0.18, (25, 3)) + (0, 0, 0.5)
    balls = [ball(r, *c) for r, c in zip(rng.uniform(0.06, 0.16, 25), centres, strict=True)]
    return join(*[rod(0.06, 0.5, 0, 0, 0.2), *balls])


def join(*pieces: Trimesh) -> Trimesh:
    """One mesh of several."""
    return trimesh.util.concatenate(list(pieces))


SOLIDS: dict[str, Callable[[], Trimesh]] = {
    "torus": lambda: creation.torus(0.35, 0.13),
    "cone": lambda: creation.cone(radius=0.35, height=0.9),
    "capsule": lambda: creation.capsule(height=0.6, radius=0.18),
    "tablet": lambda: box(0.6, 0.8, 0.12),
    "sheet": lambda: box(0.03, 0.7, 1.0),
    "bracket": lambda: join(
        box(0.3, 0.9, 0.15, centre=(0, 0, 0.075)), box(0.3, 0.15, 0.8, centre=(0, -0.37, 0.4))
    ),
    "table": lambda: join(
        box(0.8, 0.8, 0.1, centre=(0, 0, 0.65)),
        *(rod(0.06, 0.6, x, y, 0.3) for x in (-0.3, 0.3) for y in (-0.3, 0.3)),
    ),
    "snowman": lambda: join(ball(0.3, 0, 0, 0.3), ball(0.22, 0, 0, 0.75), ball(0.15, 0, 0, 1.05)),
    "mug": lambda: join(creation.annulus(0.28, 0.35, 0.7), rod(0.35, 0.07, 0, 0, -0.33)),
    "bush": bush,
}


def objects(folder: Path | None) -> dict[str, Path | None]:
    """Name of an object -> its picture or file; None for a solid."""
    files = sorted(folder.glob("*.splat")) if folder else []
    pictures = sorted((ROOT / "demo/examples").glob("*.png"))
    paths = {path.stem: path for path in [*files, *pictures]}
    return {**paths, **dict.fromkeys(SOLIDS)}


def gaussians_of(name: str, path: Path | None) -> Gaussians:
    """Return the object of a picture, of a file of Gaussians, or a solid."""
    if path is None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "solid.stl"
            SOLIDS[name]().export(file)
            return mesh(file, COLOUR)
    if path.suffix == ".png":
        return pipeline.make_gaussians(path).gaussians
    return read_gaussians(path, up="-y").gaussians


def scene_of(name: str, solver: str = "mpm") -> Scene:
    """Return a scene of the zoo for a solver of elastic bodies."""
    preset, changes = SCENES[name]
    return beginning(preset).replaced({**changes, "accuracy": {"solver": solver}})


def apart(clips: list[Clip], size: float) -> list[list[float]]:
    """Return the RMS distance of each pair of clips in each frame, relative to the size."""
    pairs = combinations([clip.surface.means for clip in clips], 2)
    return [distance(a, b, size).tolist() for a, b in pairs]


def distance(a: NDArray, b: NDArray, size: float) -> NDArray:
    """Return the RMS distance of two motions in each frame [T], to 4 digits."""
    gaps = np.sqrt(((a.astype(float) - b) ** 2).sum(axis=2).mean(axis=1)) / size
    return np.array([float(f"{gap:.4g}") for gap in gaps])


def measured(gaussians: Gaussians, base: Scene, levels: tuple[int, ...]) -> dict[str, Any]:
    """Run a scene on some grids; return the distances and the costs of the runs."""
    runs, clips = [], []
    for cells in levels:
        start = time.process_time()
        scene = base.replaced({"accuracy.cells": cells, "time.budget": 1e6})
        run = Simulation(prepare(gaussians, scene, RunContext(threads=1)))
        middle = time.process_time()
        clips.append(run.run())
        runs.append(
            {
                "cells": cells,
                "complete": clips[-1].report["complete"],
                "torn": clips[-1].report["balance"]["tearing"]["likely"],
                "particles": clips[-1].report["particles"],
                "substeps": clips[-1].report["substeps"],
                "preparing": round(middle - start, 2),
                "seconds": round(time.process_time() - middle, 2),
            }
        )
        if not runs[-1]["complete"]:
            clips.pop()
    whole = [run["cells"] for run in runs if run["complete"]]
    return {"runs": runs, "levels": whole, "apart": apart(clips, base.object.size)}


def thicknesses(gaussians: Gaussians) -> list[float]:
    """Return quantiles of the local thickness of an object, relative to its size."""
    scene = beginning("spin")
    shape = find_solid(_placed(gaussians, scene), scene.object.size / ACROSS)
    return [round(local_thickness(shape, part) / scene.object.size, 4) for part in QUANTILES]


def _placed(gaussians: Gaussians, scene: Scene) -> Gaussians:
    return prepare(gaussians, scene.replaced({"accuracy.cells": 8})).gaussians


@cache
def commit() -> str:
    """Return the commit of the code that runs."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def rows() -> list[dict[str, Any]]:
    """The rows that were measured."""
    return [json.loads(line) for line in ROWS.read_text().splitlines()] if ROWS.exists() else []


def measure(args: argparse.Namespace) -> None:
    """Measure what is missing, for some minutes."""
    end, known = time.monotonic() + 60 * args.minutes, objects(args.objects)
    there = {(row["object"], row["scene"], row["solver"], row["grids"]) for row in rows()}
    names = args.names or list(known)
    # A diagonal order, so that any beginning of the list has every scene and every object.
    order = sorted(
        product(range(len(names)), range(len(args.scenes))),
        key=lambda place: ((place[0] - place[1]) % len(names), place[1]),
    )
    made: dict[str, Any] = {}
    for place, which in order:
        name, words = names[place], args.scenes[which]
        if (name, words, args.solver, args.grids) in there:
            continue
        if time.monotonic() > end:
            break
        try:
            if name not in made:
                gaussians = gaussians_of(name, known[name])
                made[name] = gaussians, thicknesses(gaussians)
            result = measured(made[name][0], scene_of(words, args.solver), GRIDS[args.grids])
        except InputError as refusal:
            print(f"{name} {words}: {refusal}", file=sys.stderr)
            continue
        row = {
            "object": name,
            "scene": words,
            "solver": args.solver,
            "grids": args.grids,
            "thickness": made[name][1],
            **result,
            "machine": processor(),
            "date": time.strftime("%Y-%m-%d"),
            "commit": commit(),
        }
        with ROWS.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{name} {words}", flush=True)


class Pair(NamedTuple):
    """An object in a scene on a grid: its error, and what its run and the scene tell of it."""

    grids: str
    scene: str
    object: str
    error: float
    distance: float
    """RMS distance from the companion, in object sizes."""
    at_most: float
    """Bound that the run tells for itself."""
    before: float | None
    """Bound that was told before the run; None: not measured."""
    until: float | None


def pair_of(row: dict[str, Any]) -> Pair | None:
    """Return the pair of a row; None without an error, such as for a torn grid."""
    *_, grid, truth = GRIDS[row["grids"]]
    coarse, scene = round(RATIO * grid), scene_of(row["scene"], row["solver"])
    runs = [run for run in row["runs"] if run["cells"] in (coarse, grid, truth)]
    if any(run["torn"] or not run["complete"] for run in runs):
        return None
    apart = dict(zip(combinations(row["levels"], 2), map(np.array, row["apart"]), strict=True))
    distances, errors = apart[coarse, grid], apart[grid, truth]
    times = np.arange(len(distances)) / scene.time.fps
    _, at_most, until = estimate(distances, times, factors_of(scene, coarse))
    if at_most is None:
        return None
    count = len(times) if until is None else int(np.searchsorted(times, until - 1e-9))
    distance, error = (float(np.sqrt((d[:count] ** 2).mean())) for d in (distances, errors))
    told = promise(scene.replaced({"accuracy": row["grids"]}), row["thickness"][2])
    return Pair(
        row["grids"], row["scene"], row["object"], error, distance, at_most, told.error, until
    )


def leave_out(pairs: list[Pair]) -> list[float]:
    """Return error / bound of each pair, with a bound fitted to all other objects."""
    ratios = np.array([pair.error / (pair.at_most - FLOOR) for pair in pairs])
    names = np.array([pair.object for pair in pairs])
    return [
        pair.error
        / (np.quantile(ratios[names != pair.object], 0.95) * (pair.at_most - FLOOR) + FLOOR)
        for pair in pairs
    ]


def summary(title: str, pairs: list[Pair]) -> list[str]:
    """Return a line of the page's table."""
    ratios = np.array([pair.error / pair.at_most for pair in pairs])
    rest = np.array(leave_out(pairs)) if len(pairs) > 9 else np.array([np.nan])
    known = [pair for pair in pairs if pair.before is not None]
    before = np.array([pair.error / (pair.before or np.inf) for pair in known])
    broken = [pair for pair in known if pair.error > (pair.before or np.inf)]
    seen = sum(pair.at_most > (pair.before or np.inf) for pair in broken)
    return [
        title,
        f"{len(pairs)} ({len({pair.object for pair in pairs})})",
        f"{np.mean(ratios <= 1):.0%}",
        f"{np.mean(rest <= 1):.0%}" if len(pairs) > 9 else "-",
        f"{np.median(1 / ratios):.1f}",
        f"{ratios.max():.1f}",
        f"{np.mean(before <= 1):.0%} of {len(known)}" if known else "not measured",
        f"{np.median(1 / before):.1f}" if known else "-",
        f"{seen} of {len(broken)}",
    ]


def table(_: argparse.Namespace) -> None:
    """Rewrite the table and the plot of docs/lab/own-error.md."""
    import matplotlib.pyplot as plt  # the extra `plots`

    known = rows()
    pairs = [pair for pair in map(pair_of, known) if pair is not None]
    lines = []
    for grids in GRIDS:
        group = [pair for pair in pairs if pair.grids == grids]
        lines += [summary(f"**{grids}**", group)] if group else []
        for name in SCENES:
            each = [pair for pair in group if pair.scene == name]
            lines += [summary(f"{grids}: {name}", each)] if len(each) > 2 else []
    heads = ["pairs", "pairs (objects)", "held", "held, left out", "told / true", "worst"]
    heads += ["before: held", "before: told / true", "broken promises foreseen"]
    days, where = {row["date"] for row in known}, {row["machine"] for row in known}
    parted = sum(pair.until is not None for pair in pairs)
    text = (
        f"Measured on {' and '.join(sorted(where))}; {' to '.join(sorted(days))}. "
        f"{len(known)} rows, {len(pairs)} with an error; "
        f"in {parted} of them the grids part before the end."
    )
    replace_block(DOCS / "lab/own-error.md", "zoo", f"{markdown(heads, lines)}\n\n{text}")
    figure, axes = plt.subplots(figsize=(6, 5))
    for grids in GRIDS:
        group = [pair for pair in pairs if pair.grids == grids]
        axes.loglog([p.error for p in group], [p.at_most for p in group], ".", label=grids)
    ends = np.array([1e-5, 0.3])
    axes.loglog(ends, ends, "k-", lw=1, label="told = true")
    axes.loglog(ends, 2 * ends, "k:", lw=1, label="told = 2 x true")
    axes.set(xlabel="true error [object sizes]", ylabel="told: at most [object sizes]")
    axes.legend()
    figure.savefig(DOCS / "images/results/own-error.png", dpi=110, bbox_inches="tight")


def main() -> None:
    """Measure what is missing, or rewrite the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(required=True)
    commands.add_parser("table", help="rewrite the page").set_defaults(run=table)
    how = commands.add_parser("measure", help="add rows")
    how.set_defaults(run=measure)
    how.add_argument("--objects", type=Path, help="folder of .splat files")
    how.add_argument("--names", nargs="+", help="names of objects; default all")
    how.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    how.add_argument("--solver", default="mpm", choices=("mpm", "lattice"))
    how.add_argument("--grids", default="standard", choices=list(GRIDS))
    how.add_argument("--minutes", type=float, default=50)
    args = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    args.run(args)


if __name__ == "__main__":
    main()
