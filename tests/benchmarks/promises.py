"""Measures what may be promised: the error of each law in each kind of motion, on many objects.

Each object is moved by each scene on a series of grids, its Gaussians riding along on a lattice.
`measure` adds a row to promises.jsonl for each object and scene that has none, so the script can be
stopped and started again:

    python tests/benchmarks/promises.py measure --minutes 50 --scenes "neo_hookean press"

`table` rewrites phy124/accuracy/measured.json, from which `phy124.accuracy.promises` reads, and the
tables of docs/lab/error-bounds.md from these rows. `make accuracy` does both.

Objects are the pictures of demo/examples and the files of ../shared/objects, which stand on -y.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from phy124 import pipeline
from phy124.accuracy.convergence import distances, richardson
from phy124.accuracy.promises import largest_error
from phy124.accuracy.severity import damping, length, motion_of, poisson, violence, yielding
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.formats import read_gaussians
from phy124.materials import LAWS
from phy124.materials.elastic import Springy
from phy124.particles.solid import ACROSS
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.bodies import thickness_of

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import DOCS, markdown, processor, renew

ROOT = Path(__file__).parents[2]
ROWS = Path(__file__).with_suffix(".jsonl")
FILE = ROOT / "phy124/accuracy/measured.json"
LEVELS = (10, 13, 16, 24, 32, 48)
STUDIED = 16
"""The coarsest level of a study, in cells; coarser ones may have another order."""
HOLD = 0.95
"""Fraction of the errors of objects left out at which the promises from the others hold."""
ENOUGH, MANY = 4, 10
"""Number of objects from which a kind of scene counts as measured, and decides on the safety."""
SHOWN_LEVELS, SHOWN_THICKNESS = (16, 32), (0.05, 0.1, 0.2, 0.5)
"""Grids and thickness of objects, relative to their size, that the page shows."""
SPRINGY = [law for law, kind in LAWS.by_name.items() if issubclass(kind, Springy)]
FLOWING = [law for law, kind in LAWS.by_name.items() if kind().device_law.project]
STAND: dict[str, Any] = {"object.lift": 0.0, "time.fps": 24.0}
SCENES = {
    **{
        f"{law} {name}": (name, law, {})
        for law in SPRINGY
        for name in ("press", "drop", "sway", "spin", "bounce", "push_right")
    },
    **{f"{law} {name}": (name, law, {}) for law in FLOWING for name in ("press", "drop")},
    **{f"{law} standing": ("drop", law, STAND) for law in ("sand", "snow", "fluid", "foam")},
}
"""Name -> preset, law, changes."""

Row = dict[str, Any]


def scene_of(preset: str, law: str, changes: dict[str, Any]) -> Scene:
    """Return a preset's beginning with another law.

    Springy laws have the preset's values, all others have their defaults.
    """
    base = beginning(preset)
    plain: dict[str, Any] = {"law": law}
    if law in SPRINGY:
        plain |= base.material.model_dump(exclude={"law"})
    return base.replaced({"material": plain, **changes})


def objects() -> dict[str, Path]:
    """Name of an object -> its picture or file."""
    pictures = (ROOT / "demo/examples").glob("*.png")
    files = (ROOT.parent / "shared/objects").glob("*.splat")
    return {path.stem: path for path in sorted([*pictures, *files])}


def gaussians_of(path: Path) -> Gaussians:
    """Return the object of a picture or of a file of Gaussians."""
    if path.suffix == ".png":
        return pipeline.make_gaussians(path).gaussians
    return read_gaussians(path, up="-y").gaussians


def measured(name: str, gaussians: Gaussians, words: str, levels: Sequence[int]) -> Row:
    """Move an object by a scene on some grids; returns the row with their distances."""
    base = scene_of(*SCENES[words]).replaced({"time.budget": 1e6, "binding": "lattice"})
    whole, clips, torn, seconds = [], [], [], []
    for cells in levels:
        begin = time.process_time()
        run = Simulation(
            prepare(gaussians, base.replaced({"accuracy.cells": cells}), RunContext(threads=1))
        )
        clip = run.run()
        if not clip.report["complete"]:
            continue
        # Without grains, of which each grid has its own.
        clips.append(clip.means[:, : len(gaussians)])
        whole.append(cells)
        torn.append(clip.report["balance"]["tearing"]["likely"])
        seconds.append(round(time.process_time() - begin, 2))
    apart = distances(clips) / base.object.size if clips else np.zeros((0, 0))
    return {
        "object": name,
        "scene": words,
        "levels": whole,
        "torn": torn,
        "seconds": seconds,
        "apart": np.round(apart[np.triu_indices(len(whole), 1)], 6).tolist(),
        "thickness": round(thickness_of(gaussians, base), 4),
        "commit": commit(),
    }


def commit() -> str:
    """Return the commit of the code that runs."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def rows() -> list[Row]:
    """The rows that were measured."""
    return [json.loads(line) for line in ROWS.read_text().splitlines()] if ROWS.exists() else []


def missing(names: list[str], scenes: list[str]) -> Iterator[tuple[str, str]]:
    """Objects and scenes that have no row."""
    there = {(row["object"], row["scene"]) for row in rows()}
    return ((name, scene) for scene, name in product(scenes, names) if (name, scene) not in there)


def measure(args: argparse.Namespace) -> None:
    """Measure what is missing, for some minutes."""
    known, end = objects(), time.monotonic() + 60 * args.minutes
    made: dict[str, Gaussians] = {}
    for name, words in missing(args.objects or list(known), args.scenes):
        if time.monotonic() > end:
            break
        try:
            made.setdefault(name, gaussians_of(known[name]))
            row = measured(name, made[name], words, args.levels)
        except InputError as refusal:
            print(f"{name} {words}: {refusal}", file=sys.stderr)
            continue
        with ROWS.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{name} {words}", flush=True)


def errors_of(row: Row) -> list[float | None]:
    """Error of an object on each grid of a row, as a fraction of its size; None: none is known.

    The error is the largest of those estimated from all grids and from the finer grids alone. If
    the grids do not converge, it is the largest distance to a finer grid.
    """
    cells = [n for n, torn in zip(row["levels"], row["torn"], strict=True) if not torn]
    kept = np.flatnonzero(~np.array(row["torn"], bool))
    apart = np.zeros((len(row["levels"]),) * 2)
    apart[np.triu_indices(len(apart), 1)] = row["apart"]
    apart = (apart + apart.T)[np.ix_(kept, kept)]
    errors = np.zeros(len(cells))
    for first in range(max(0, min(len(cells) - 2, sum(n < STUDIED for n in cells) + 1))):
        found = richardson([1 / n for n in cells[first:]], apart[first:, first:])
        errors[first:] = np.maximum(errors[first:], found.errors or apart[first:].max(axis=1))
    known = dict(zip(cells, errors.tolist(), strict=True)) if len(cells) > 2 else {}
    return [known.get(n) for n in LEVELS]


def worst(rows: Sequence[Row]) -> list[float | None]:
    """The largest error on each grid over the scenes of a kind; None where one has none."""
    each = zip(*(errors_of(row) for row in rows), strict=True)
    return [None if None in errors else round(max(errors), 5) for errors in each]


def severity(scene: Scene) -> dict[str, float]:
    """How hard a scene is on its material."""
    return {
        "violence": violence(scene),
        "yielding": yielding(scene),
        "nu": poisson(scene),
        "damping": damping(scene),
        "length": length(scene),
        "particles_per_axis": scene.particles_per_axis,
    }


def kinds_of(rows: Sequence[Row]) -> dict[str, Any]:
    """Return what is promised from: for each kind of scene, how hard, and the errors of objects."""
    scenes = {name: scene_of(*SCENES[name]) for name in SCENES}
    kinds: dict[str, list[str]] = {}
    for name in dict.fromkeys(row["scene"] for row in rows):
        kind = f"{scenes[name].material.law} {motion_of(scenes[name])}"
        kinds.setdefault(kind, []).append(name)
    found = {}
    for kind, names in sorted(kinds.items()):
        hard = [severity(scenes[name]) for name in names]
        by_object = {
            thing: [row for row in rows if row["object"] == thing and row["scene"] in names]
            for thing in sorted({row["object"] for row in rows})
        }
        errors = {thing: worst(own) for thing, own in by_object.items() if len(own) == len(names)}
        known = {thing: each for thing, each in errors.items() if any(each)}
        if len(known) < ENOUGH:
            continue
        there = [k for k in range(len(LEVELS)) if any(each[k] for each in known.values())]
        found[kind] = {
            "from": [name.partition(" ")[2] for name in names],
            **{key: float(f"{max(one[key] for one in hard):.6g}") for key in hard[0]},
            "damping": float(f"{min(one['damping'] for one in hard):.6g}"),
            "levels": [LEVELS[k] for k in there],
            "errors": {thing: [each[k] for k in there] for thing, each in known.items()},
        }
    return found


def left_out(kind: dict[str, Any], thick: dict[str, float]) -> dict[tuple[str, int], float]:
    """Object and grid -> its error, relative to what is promised from all other objects."""
    ratios = {}
    for thing, errors in kind["errors"].items():
        others = {name: each for name, each in kind["errors"].items() if name != thing}
        for cells in kind["levels"]:
            error = errors[kind["levels"].index(cells)]
            promised, _ = largest_error({**kind, "errors": others}, thick, thick[thing], cells)
            if error is not None and promised is not None:
                ratios[thing, cells] = error / promised
    return ratios


def written(kinds: dict[str, Any], thick: dict[str, float], safety: float) -> list[list[str]]:
    """Lines of the page's table: what is promised to objects of some thickness, in per cent."""
    lines = []
    for kind, found in kinds.items():
        ratios = np.array(list(left_out(found, thick).values()))
        held = f"{np.mean(ratios <= safety):.0%} of {len(ratios)}" if len(ratios) else "-"
        promised = [
            largest_error(found, thick, thickness, cells)[0] if cells in found["levels"] else None
            for cells, thickness in product(SHOWN_LEVELS, SHOWN_THICKNESS)
        ]
        errors = ["none" if error is None else f"{100 * safety * error:.1f}" for error in promised]
        count = str(len(found["errors"]))
        lines.append([*kind.split(), ", ".join(found["from"]), count, *errors, held])
    return lines


def table(_: argparse.Namespace) -> None:
    """Rewrite measured.json and the tables of the page.

    Objects as thin as a voxel are left out, since they may be thinner than that.
    """
    measured = [row for row in rows() if row["thickness"] > 1.01 / ACROSS]
    thick = {row["object"]: row["thickness"] for row in measured}
    kinds = kinds_of(measured)
    many = [found for found in kinds.values() if len(found["errors"]) >= MANY]
    ratios = [ratio for found in many for ratio in left_out(found, thick).values()]
    safety = float(np.ceil(20 * max(1.0, np.quantile(ratios, HOLD, method="higher"))) / 20)
    thick = dict(sorted(thick.items(), key=lambda item: item[1]))
    commits = sorted({row["commit"] for row in measured})
    about = {"machine": processor(), "commits": commits, "safety": safety, "objects": thick}
    lines = [f"{json.dumps(kind)}: {json.dumps(found)}" for kind, found in kinds.items()]
    text = ",\n".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in about.items())
    FILE.write_text("{" + text + ',\n"scenes": {\n' + ",\n".join(lines) + "\n}}\n")
    heads = [f"D/{n}: {part:g}" for n, part in product(SHOWN_LEVELS, SHOWN_THICKNESS)]
    heads = ["law", "motion", "scenes", "objects", *heads, "held"]
    renew(DOCS / "lab/error-bounds.md", "promises", markdown(heads, written(kinds, thick, safety)))
    held = np.mean(np.array(ratios) <= safety)
    print(f"safety factor {safety:g}: {held:.1%} of {len(ratios)} errors of objects left out hold")


def main() -> None:
    """Measure, or rewrite the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.set_defaults(run=table)
    commands = parser.add_subparsers()
    commands.add_parser("table").set_defaults(run=table)
    how = commands.add_parser("measure")
    how.set_defaults(run=measure)
    how.add_argument("--minutes", type=float, default=50)
    how.add_argument("--objects", nargs="+", choices=list(objects()))
    how.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    how.add_argument("--levels", nargs="+", type=int, default=LEVELS, choices=LEVELS)
    args = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    args.run(args)


if __name__ == "__main__":
    main()
