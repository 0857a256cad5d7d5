"""Measures what may be promised: the error of each law in each kind of motion, grid by grid.

Writes phy124/accuracy/measured.json (`make accuracy`), from which `phy124.accuracy.promises`
reads. Each scene is run on a series of grids with its Gaussians riding along; the errors are those
of `phy124.accuracy.convergence`, the worst of the scenes of a kind, a quarter larger. Grids that
may be torn, and scenes that do not converge, promise nothing. `promises.py fluid sand` measures
only these laws and keeps the others.
"""

import json
import sys
from collections.abc import Iterator
from datetime import date
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from phy124 import pipeline
from phy124.accuracy.convergence import distances, richardson
from phy124.accuracy.promises import length, motion_of
from phy124.accuracy.severity import damping, poisson, violence, yielding
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.materials import LAWS
from phy124.materials.elastic import Springy
from phy124.scene import Scene
from phy124.simulation import Simulation

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import DOCS, machine, markdown, renew

ROOT = Path(__file__).parents[2]
FILE = ROOT / "phy124/accuracy/measured.json"
OBJECT = "duck"
LEVELS = (12, 16, 24, 32, 48)
SAFETY = 1.25
"""On the errors measured: other objects are not the duck."""
SPRINGY = [law for law, kind in LAWS.by_name.items() if issubclass(kind, Springy)]
FLOWING = [law for law, kind in LAWS.by_name.items() if kind().device_law.project]
STAND: dict[str, Any] = {"object.lift": 0.0, "time.fps": 24.0}
SCENES = {
    **{
        f"{law} {name}": (name, law, {})
        for law in SPRINGY
        for name in ("press", "drop", "bounce", "push_right", "spin", "sway")
    },
    **{f"{law} {name}": (name, law, {}) for law in FLOWING for name in ("drop", "press")},
    **{f"{law} standing": ("drop", law, STAND) for law in ("sand", "snow", "fluid", "foam")},
}
"""Name -> preset, law, changes."""


def scene_of(preset: str, law: str, changes: dict[str, Any]) -> Scene:
    """A preset's beginning with another law: springy ones as it has them, others as they are."""
    base = beginning(preset)
    plain: dict[str, Any] = {"law": law}
    if law in SPRINGY:
        plain |= base.material.model_dump(exclude={"law"})
    return base.replaced({"material": plain, **changes})


def measured(gaussians: Gaussians, scene: Scene) -> dict[str, float | None]:
    """Error of each grid as a fraction of the size, None where there is none."""
    clips, whole = [], []
    for cells in LEVELS:
        accuracy = scene.resolution.model_copy(update={"cells": cells})
        run = Simulation(gaussians, scene.model_copy(update={"accuracy": accuracy}))
        clip = run.run()
        if clip.report["complete"] and not clip.report["balance"]["tearing"]["likely"]:
            # Without grains, of which each grid has its own.
            clips.append(clip.means[:, : len(gaussians)])
            whole.append(cells)
    if len(whole) < 3:
        return {}
    found = richardson([1 / n for n in whole], distances(clips) / scene.object.size)
    return dict(zip(map(str, whole), found.errors, strict=False))


def worst(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The row of a kind of scene: the least that was measured, the largest error."""
    grids = {cells for row in rows for cells in row["errors"]}
    errors = {}
    for cells in sorted(grids, key=int):
        each = [row["errors"].get(cells) for row in rows]
        errors[cells] = None if None in each else round(max(each), 4)
    return {
        "errors": errors if all(row["errors"] for row in rows) else {},
        **{name: max(row[name] for row in rows) for name in ("violence", "yielding", "nu")},
        "damping": min(row["damping"] for row in rows),
        "length": max(row["length"] for row in rows),
        "particles_per_axis": max(row["particles_per_axis"] for row in rows),
        "from": [row["name"] for row in rows],
    }


def severity(scene: Scene) -> dict[str, float]:
    """How hard a scene is on its material."""
    return {
        "violence": violence(scene),
        "yielding": yielding(scene),
        "nu": poisson(scene),
        "damping": damping(scene),
    }


def rows(gaussians: Gaussians, laws: list[str]) -> Iterator[dict[str, Any]]:
    """One row per scene, as measured."""
    for name, (preset, law, changes) in SCENES.items():
        if laws and law not in laws:
            continue
        scene = scene_of(preset, law, changes)
        try:
            errors = measured(gaussians, scene.model_copy(update={"binding": "lattice"}))
        except InputError as refusal:
            print(f"{name}: {refusal}", flush=True)
            errors = {}
        errors = {cells: SAFETY * error for cells, error in errors.items() if error is not None}
        row = {
            "kind": f"{law} {motion_of(scene)}",
            "name": name.removeprefix(f"{law} "),
            "errors": errors,
            **severity(scene),
            "length": length(scene),
            "particles_per_axis": scene.particles_per_axis,
        }
        print(json.dumps(row), flush=True)
        yield row


def table(kinds: dict[str, Any]) -> str:
    """For the page: a row per kind of scene, per cent of the size on each grid."""
    heads = ["law", "motion", *(f"D/{cells}" for cells in LEVELS), "measured on"]
    lines = []
    for kind, row in sorted(kinds.items()):
        errors = [row["errors"].get(str(cells)) for cells in LEVELS]
        said = ["none" if error is None else f"{100 * error:.1f} %" for error in errors]
        lines.append([*kind.split(), *said, ", ".join(row["from"])])
    return markdown(heads, lines)


def main(laws: list[str]) -> None:
    """Measure all, or some laws."""
    wp.config.log_level = wp.LOG_ERROR
    np.seterr(all="raise", under="ignore")
    gaussians = pipeline.static(ROOT / f"demo/examples/{OBJECT}.png").gaussians
    known = json.loads(FILE.read_text()) if FILE.exists() else {"scenes": {}}
    kinds, found = known["scenes"] if laws else {}, []
    for row in rows(gaussians, laws):
        found = sorted([*found, row], key=lambda row: row["kind"])
        for kind, group in groupby(found, key=lambda row: row["kind"]):
            kinds[kind] = worst(list(group))
        about = {"machine": machine(), "date": date.today().isoformat(), "object": f"the {OBJECT}"}
        renew(DOCS / "results/accuracy.md", "promises", table(kinds))
        text = json.dumps({**about, "scenes": dict(sorted(kinds.items()))}, indent=1)
        FILE.write_text(text + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
