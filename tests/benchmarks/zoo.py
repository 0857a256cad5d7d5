"""Measures how far coarse grids are off on many objects: distances between grids, scene by scene.

Each object is moved by each scene on a series of grids. A row of zoo.jsonl holds the RMS distance
of every two of them over all Gaussians and frames, in sizes of the object, and what may foretell
it: how thick the object is, and how hard the scene is on it. Rows that are there already are kept,
so that the script can be stopped and started again.

    python tests/benchmarks/zoo.py --minutes 50 --scenes "neo_hookean press" --objects koala duck

Objects are the pictures of demo/examples and the files of ../shared/objects, which stand on -y.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from datetime import date
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import scipy.ndimage
import warp as wp
from numpy.typing import NDArray

from phy124 import pipeline
from phy124.accuracy.convergence import distances
from phy124.accuracy.promises import length, motion_of
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.formats import read_gaussians
from phy124.simulation import Simulation

sys.path.insert(0, str(Path(__file__).parent))
from promises import SCENES, scene_of, severity
from tables import machine

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_suffix(".jsonl")
LEVELS = (10, 13, 16, 24, 32, 48)
VOXELS = 64
"""Voxels along the longest side, roughly, whatever the spacing of the points: they are compared."""
FRACTIONS = (0.05, 0.1, 0.25, 0.5)
"""Of the volume, its thinnest part, of which a row has the largest thickness."""


def objects() -> dict[str, Path]:
    """Name of an object -> its picture or file."""
    pictures = (ROOT / "demo/examples").glob("*.png")
    files = (ROOT.parent / "shared/objects").glob("*.splat")
    return {path.stem: path for path in sorted([*pictures, *files])}


def gaussians_of(path: Path) -> Gaussians:
    """The object of a picture or of a file of Gaussians."""
    if path.suffix == ".png":
        return pipeline.static(path).gaussians
    return read_gaussians(path, up="-y").gaussians


def local_thickness(
    x: NDArray[np.floating], spacing: float, fractions: Sequence[float]
) -> list[float]:
    """Thickness that a fraction of the volume does not exceed [m], for each of some fractions.

    The local thickness of a point is the diameter of the largest ball inside the object that
    contains it (Hildebrand and Ruegsegger 1997, J. Microscopy 185): an opening by balls of a
    diameter removes what is thinner.

    It is too small by half a voxel on average, and a part of any corner counts as thin.

    Args:
        x: Points that fill the object evenly [P,3], m.
        spacing: Distance of neighbouring points [m].
        fractions: Fractions of the volume.
    """
    extent = float((x.max(axis=0) - x.min(axis=0)).max()) + spacing
    pitch = max(spacing, extent / VOXELS)
    index = np.floor((x - x.min(axis=0)) / pitch + 0.5).astype(int)
    inside = np.zeros(index.max(axis=0) + 1, bool)
    inside[tuple(index.T)] = True
    finer = max(1, round(VOXELS * pitch / extent))
    for axis in range(3):
        inside = inside.repeat(finer, axis)
    inside = np.pad(inside, 1)
    depth = scipy.ndimage.distance_transform_edt(inside)
    radii = np.unique(depth[inside])
    voxel = pitch / finer
    return [float((2 * _radius(inside, depth, radii, part) - 1) * voxel) for part in fractions]


def _radius(
    inside: NDArray[np.bool_], depth: NDArray[np.float64], radii: NDArray, fraction: float
) -> float:
    """Largest radius [voxels] of balls that removes at most a fraction of the volume."""
    fits, too_large = 0, len(radii)
    while too_large - fits > 1:
        middle = (fits + too_large) // 2
        opened = scipy.ndimage.distance_transform_edt(depth < radii[middle]) < radii[middle]
        removed = 1 - np.count_nonzero(opened & inside) / np.count_nonzero(inside)
        fits, too_large = (middle, too_large) if removed <= fraction else (fits, middle)
    return float(radii[fits])


def row(name: str, gaussians: Gaussians, words: str) -> dict[str, Any]:
    """What the grids of one object and scene have measured."""
    base = scene_of(*SCENES[words]).replaced({"time.budget": 1e6, "binding": "lattice"})
    levels, clips, seconds, torn, thick = [], [], [], [], []
    for cells in LEVELS:
        scene = base.replaced({"accuracy.cells": cells})
        begin = time.process_time()
        run = Simulation(gaussians, scene, threads=1)
        clip = run.run()
        if not clip.report["complete"]:
            continue
        if cells == 32:
            thick = local_thickness(run.particles.x, scene.spacing, FRACTIONS)
        clips.append(clip.means[:, : len(gaussians)])
        levels.append(cells)
        seconds.append(round(time.process_time() - begin, 2))
        torn.append(run.report()["balance"]["tearing"]["likely"])
    apart = distances(clips) / base.object.size if len(clips) > 1 else np.zeros((0, 0))
    return {
        "object": name,
        "scene": words,
        "kind": f"{base.material.law} {motion_of(base)}",
        "levels": levels,
        "torn": torn,
        "seconds": seconds,
        "apart": np.round(apart, 6).tolist(),
        "thickness": [round(value / base.object.size, 4) for value in thick],
        **{key: float(f"{value:.4g}") for key, value in severity(base).items()},
        "length": round(length(base), 4),
        "particles_per_axis": base.particles_per_axis,
        "machine": machine(),
        "date": date.today().isoformat(),
    }


def rows() -> list[dict[str, Any]]:
    """The rows that are there."""
    return [json.loads(line) for line in FILE.read_text().splitlines()] if FILE.exists() else []


def missing(names: list[str], scenes: list[str]) -> Iterator[tuple[str, str]]:
    """Objects and scenes that have no row."""
    there = {(row["object"], row["scene"]) for row in rows()}
    return (pair for pair in ((o, s) for s, o in product(scenes, names)) if pair not in there)


def main() -> None:
    """Measure what is missing, for some minutes."""
    known = objects()
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=50)
    parser.add_argument("--objects", nargs="+", default=list(known), choices=list(known))
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    args = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    end, made = time.monotonic() + 60 * args.minutes, {}
    for name, words in missing(args.objects, args.scenes):
        if time.monotonic() > end:
            break
        try:
            made.setdefault(name, gaussians_of(known[name]))
            text = json.dumps(row(name, made[name], words))
        except InputError as refusal:
            print(f"{name} {words}: {refusal}", file=sys.stderr)
            continue
        with FILE.open("a") as file:
            file.write(text + "\n")
        print(f"{name} {words}", flush=True)


if __name__ == "__main__":
    main()
