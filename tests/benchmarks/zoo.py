"""Simulates the zoo, objects in scenes on several grids, to measure and to predict errors.

The program adds a row to zoo.jsonl.gz for each object and scene without a row, so it can be stopped
and started again. With `--minutes` it ends after this time:

    nice python tests/benchmarks/zoo.py --objects ../shared/objects --minutes 50

A row has the distances between all pairs of grids in each frame. The finest grid, at least twice as
fine as the grid that is tested, is taken as the truth. Objects are the files of a folder, whose
bottom is at -y, the pictures of demo/examples, and solids that need no file.
"""

import argparse
import gzip
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray
from trimesh import Trimesh, creation

from phy124 import pipeline
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.mesh import mesh
from phy124.io.clip import Clip
from phy124.io.formats import read_gaussians
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.bodies import proportions_of

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import processor

ROOT = Path(__file__).parents[2]
ROWS = Path(__file__).with_suffix(".jsonl.gz")
GRIDS = {"draft": (6, 8, 16, 32), "standard": (10, 12, 16, 20, 32, 64), "fine": (18, 24, 48, 96)}
"""Name -> cells across the object: companions, the grid that is judged, and last the truth."""
COLOUR = (0.6, 0.4, 0.3)
TOP = {"lower": (-1e9, -1e9, 0.5)}
PUSH = {"kind": "acceleration", "a": (0.0, 6.0, 0.0), "end": 0.15, "region": TOP}
Change = dict[str, Any]
Row = dict[str, Any]
COMPRESSIBLE: Change = {"material": {"law": "fluid"}, "accuracy.liquid": "compressible"}
SCENES: dict[str, tuple[str, Change]] = {
    **{name: (name, {}) for name in ("press", "drop", "sway", "spin", "bounce", "collide", "wind")},
    "pushed": ("drop", {"object.lift": 0.0, "forces": [{"kind": "gravity"}, PUSH]}),
    "plasticine press": ("press", {"material": {"law": "plasticine"}}),
    "sand drop": ("drop", {"material": {"law": "sand"}}),
    "snow drop": ("drop", {"material": {"law": "snow"}}),
    "fluid drop": ("drop", COMPRESSIBLE),
    "water drop": ("drop", {"material": {"law": "fluid"}}),
}
"""Name -> preset and changes to its beginning."""
HAND = {"kind": "grab", "point": (0, 0, 0.8), "radius": 0.3, "times": (0, 0.3)}
HAND |= {"targets": ((0, 0, 0.8), (0, 0.25, 0.8)), "strength": 400.0, "damping": 50.0}
TOUCH = {"kind": "grab", "point": (0, 0, 0.5), "radius": 0.5, "times": (0, 0.3)}
TOUCH |= {"targets": ((0, 0, 0.5), (0, 0.3, 0.7)), "strength": 3000.0, "damping": 300.0}
SWING = {"kind": "swing", "amplitude": (0, 0.05, 0), "frequency": 2.0}
RAM = {"kind": "path", "times": (0, 0.4), "points": ((0, 0, 0), (0, 0.5, 0))}
WALL = {"kind": "half_space", "point": (0, -0.5, 0), "normal": (0, 1, 0), "motion": RAM}


def law(preset: str, name: str) -> tuple[str, Change]:
    """Return a preset with another law, which has its default values."""
    return preset, {"material": {"law": name}}


def forces(preset: str, *forces: Change, gravity: bool = False) -> tuple[str, Change]:
    """Return a preset with other forces."""
    return preset, {"forces": [*([{"kind": "gravity"}] if gravity else []), *forces]}


VARIANTS: dict[str, tuple[str, Change]] = {
    "soft drop": ("drop", {"material.E": 5e4}),
    "high drop": ("drop", {"object.lift": 0.9}),
    "undamped drop": ("drop", {"material.damping": 0.0}),
    "soft press": ("press", {"material.E": 1e4}),
    "fast press": ("press", {"boundaries.1.down": 0.08}),
    "slight press": ("press", {"boundaries.1.depth": 0.15}),
    "soft sway": ("sway", {"material.E": 4e4}),
    "damped sway": ("sway", {"material.damping": 50.0}),
    "soft spin": ("spin", {"material.E": 2.5e4}),
    "stiff spin": ("spin", {"material.E": 1e6, "material.damping": 100.0}),
    "long sway": ("sway", {"time.frames": 41}),
    "long drop": ("drop", {"time.frames": 41}),
    "long spin": ("spin", {"time.frames": 41}),
    "gusts": ("wind", {"forces.0.v": (0, 10, 0)}),
    "hard": ("bounce", {"material.nu": 0.45}),
    "pulled": forces("sway", HAND),
    "lifted": forces("drop", TOUCH, gravity=True),
    "thrown": forces("spin", {"kind": "impulse", "p": (0, 30, 0), "region": TOP}),
    "set off": forces("sway", {"kind": "set_velocity", "v": (0, 1.0, 0), "end": 0.05}),
    "twisted": forces("sway", {"kind": "wrench", "force": (0, 0, 0), "torque": (0, 0, 10.0)}),
    "loaded": forces("sway", {"kind": "force", "f": (0, 30, 0), "region": TOP}),
    "blown": forces("drop", {"kind": "zone", "a": (0, 12, 0)}, gravity=True),
    "drawn": forces("drop", {"kind": "attraction", "g": 10.0, "centre": (0, 0.6, 0.6)}),
    "shaken": ("sway", {"forces": [], "boundaries.0.motion": SWING}),
    "rammed": ("drop", {"object.lift": 0.0, "boundaries": [{"kind": "ground"}, WALL]}),
    "metal drop": law("drop", "metal"),
    "metal press": law("press", "metal"),
    "foam drop": law("drop", "foam"),
    "foam press": law("press", "foam"),
    "plasticine drop": law("drop", "plasticine"),
    "sand press": law("press", "sand"),
    "snow press": law("press", "snow"),
    "fluid press": ("press", COMPRESSIBLE),
    "water press": law("press", "fluid"),
    "hencky drop": law("drop", "hencky"),
    "corotated sway": law("sway", "fixed_corotated"),
    "loose particles": ("drop", {"binding": "particles"}),
    "wind particles": ("wind", {"binding": "particles"}),
    "heap": ("sand", {}),
    "thrown snow": ("snow", {}),
    "dent": ("metal", {}),
    **{name: (name, {}) for name in ("jelly", "water", "honey", "lava", "oil")},
    **{name: (name, {}) for name in ("stack", "bury", "land_on_cushion")},
}
"""Further scenes, for coarse grids, which show how errors depend on the values of a scene."""
ALL = {**SCENES, **VARIANTS}


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
    preset, changes = ALL[name]
    return beginning(preset).replaced({"accuracy": {"solver": solver}, **changes})


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
                "torn": clips[-1].report["balance"].get("tearing", {}).get("likely", False),
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


@cache
def commit() -> str:
    """Return the commit of the code that runs."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def rows() -> list[Row]:
    """The rows that were measured."""
    if not ROWS.exists():
        return []
    with gzip.open(ROWS, "rt", encoding="utf-8") as file:
        return [json.loads(line) for line in file]


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
    made: dict[str, Gaussians] = {}
    for place, which in order:
        name, words = names[place], args.scenes[which]
        if (name, words, args.solver, args.grids) in there:
            continue
        if time.monotonic() > end:
            break
        scene = scene_of(words, args.solver)
        try:
            if name not in made:
                made[name] = gaussians_of(name, known[name])
            result = measured(made[name], scene, GRIDS[args.grids])
            proportions = proportions_of(made[name], scene)
        except InputError as refusal:
            print(f"{name} {words}: {refusal}", file=sys.stderr)
            continue
        row = {
            "object": name,
            "scene": words,
            "solver": args.solver,
            "grids": args.grids,
            "proportions": [round(value, 4) for value in proportions or ()],
            **result,
            "machine": processor(),
            "date": time.strftime("%Y-%m-%d"),
            "commit": commit(),
        }
        with gzip.open(ROWS, "at", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{name} {words}", flush=True)


def main() -> None:
    """Measure what is missing."""
    how = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    how.add_argument("--objects", type=Path, help="folder of .splat files")
    how.add_argument("--names", nargs="+", help="names of objects; default all")
    how.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(ALL))
    how.add_argument("--solver", default="mpm", choices=("mpm", "lattice"))
    how.add_argument("--grids", default="standard", choices=list(GRIDS))
    how.add_argument("--minutes", type=float, default=50)
    args = how.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    measure(args)


if __name__ == "__main__":
    main()
