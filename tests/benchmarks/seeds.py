"""Runs random scenes of elastic objects on lattices, and tests the remedies of runs that stop.

Objects are the files of a folder, which stand on -y, and the pictures of demo/examples. A seed
determines the scene. Each scene gives one JSON line: how the run ended, notes about torn material,
non-finite frames, the largest depth of a surface point inside a wall, and, if the run ended with a
message, how the run ended with each of the remedies:

    python tests/benchmarks/seeds.py --objects ../shared/objects 30000 30040
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.formats import read_gaussians
from phy124.lattice.solver import LatticeSolver
from phy124.pipeline import make_gaussians
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

EXAMPLES = Path(__file__).parents[2] / "demo/examples"
SECONDS = 600.0
"""Longest processor time of a run [s]."""
LAWS = "neo_hookean", "neo_hookean", "fixed_corotated", "hencky"


def decades(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform, with three digits."""
    return float(f"{10 ** rng.uniform(np.log10(low), np.log10(high)):.3g}")


def direction(rng: np.random.Generator, length: float) -> list[float]:
    """Draw a vector of a length."""
    way = rng.normal(size=3)
    return [round(float(x), 4) for x in length * way / np.linalg.norm(way)]


def draw_material(rng: np.random.Generator) -> dict[str, Any]:
    """Draw an elastic material."""
    density, E = decades(rng, 100, 4000), decades(rng, 3e3, 3e6)
    damped = rng.choice([0.0, 0.01, 0.04]) * density * np.sqrt(E / density)
    law = str(rng.choice(LAWS))
    nu = round(float(rng.uniform(0, 0.45)), 3)
    return {"law": law, "density": density, "E": E, "nu": nu, "damping": float(f"{damped:.3g}")}


def draw_boundary(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a clamp or a wall near an object of 1 m, which may move."""
    contact: dict[str, Any] = {
        "contact": str(rng.choice(["separate", "separate", "slip", "sticky"]))
    }
    contact["friction"] = round(float(rng.uniform(0, 1.5)), 2)
    swing = {"kind": "swing", "amplitude": direction(rng, decades(rng, 0.02, 0.3))}
    swing["frequency"] = decades(rng, 0.3, 10)
    kinds: list[dict[str, Any]] = [
        {"kind": "press", "depth": round(float(rng.uniform(0.1, 0.8)), 2),
         "down": decades(rng, 0.03, 0.4), "up": decades(rng, 0.03, 0.3), **contact},
        {"kind": "gripper", "closed": round(float(rng.uniform(0.2, 0.7)), 2),
         "close": decades(rng, 0.05, 0.4), "friction": contact["friction"]},
        {"kind": "foot", "fraction": round(float(rng.uniform(0.05, 0.4)), 2)},
        {"kind": "foot", "fraction": round(float(rng.uniform(0.05, 0.4)), 2), "motion": swing},
        {"kind": "held", "lower": [-2, -2, 0.7], "upper": [2, 2, 2], "end": decades(rng, 0.05, 1)},
        {"kind": "sphere", "centre": [*direction(rng, 0.7)[:2], round(float(rng.uniform(0, 1)), 2)],
         "radius": 0.2, "motion": swing, **contact},
        {"kind": "half_space", "point": [0, 0, 1.15], "normal": [0.0, 0.2, -1.0], "motion":
         {"kind": "path", "times": [0, decades(rng, 0.05, 0.5)],
          "points": [[0, 0, 0], [0, 0, -round(float(rng.uniform(0.1, 0.7)), 2)]]}, **contact},
    ]  # fmt: skip
    return kinds[rng.integers(len(kinds))]


def draw_force(rng: np.random.Generator) -> dict[str, Any]:
    """Draw a force, a grab or a wind."""
    place = [round(float(x), 2) for x in (*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.1, 0.9))]
    to = [round(a + b, 3) for a, b in zip(place, direction(rng, decades(rng, 0.1, 1)), strict=True)]
    kinds: list[dict[str, Any]] = [
        {"kind": "grab", "point": place, "targets": [place, to], "radius": 0.25,
         "times": [0, decades(rng, 0.05, 0.5)], "stiffness": decades(rng, 1e2, 1e5)},
        {"kind": "wind", "v": direction(rng, decades(rng, 1, 40)), "rate": decades(rng, 0.1, 30)},
        {"kind": "acceleration", "a": direction(rng, decades(rng, 1, 60)), "end": 0.15},
        {"kind": "wrench", "torque": direction(rng, decades(rng, 1, 1e3))},
        {"kind": "attraction", "g": decades(rng, 1, 50), "radius": 0.5},
    ]  # fmt: skip
    return kinds[rng.integers(len(kinds))]


def draw_scene(seed: int, number: int) -> tuple[int, Scene]:
    """Draw the index of an object and a scene.

    Args:
        seed: The seed.
        number: Number of objects from which to choose.
    """
    rng = np.random.default_rng(seed)
    chosen = int(rng.integers(number))
    boundaries: list[dict[str, Any]] = [{"kind": "ground", "friction": 0.6}]
    boundaries += [draw_boundary(rng) for _ in range(rng.integers(0, 3))]
    objects = []
    if rng.random() < 0.25:
        shape, size = str(rng.choice(["box", "sphere"])), round(float(rng.uniform(0.4, 1.2)), 2)
        place = [round(float(x), 2) for x in rng.uniform(-0.5, 0.5, 2)]
        other = {"name": "other", "shape": shape, "size": size, "place": place, "lift": 1.1}
        objects = [{**other, "material": draw_material(rng)}]
    moving: dict[str, Any] = {}
    if rng.random() < 0.4:
        velocity = direction(rng, decades(rng, 0.3, 6))
        moving = {"velocity": velocity, "spin": direction(rng, decades(rng, 0.3, 20))}
    data = {
        "object": {"lift": float(rng.choice([0.0, 0.2])), **moving},
        "material": draw_material(rng),
        "boundaries": boundaries,
        "forces": [{"kind": "gravity"}, *(draw_force(rng) for _ in range(rng.integers(0, 3)))],
        "objects": objects,
        "accuracy": {"cells": int(rng.integers(10, 21))},
        "time": {"frames": 12, "fps": 24.0, "budget": SECONDS / 2},
    }
    return chosen, Scene.from_data(data)


def run(gaussians: Gaussians, scene: Scene) -> dict[str, Any]:
    """Run a scene; return how it ended, its notes, and the largest depth inside a wall [cells]."""
    start, deepest = time.process_time(), 0.0

    def record(simulation: Simulation) -> None:
        nonlocal deepest
        solver: Any = simulation.solver
        if isinstance(solver, LatticeSolver):
            deepest = max(deepest, solver.walls.depth()[0])

    try:
        simulation = Simulation(prepare(gaussians, scene, RunContext(threads=1)))
        clip = simulation.run(record=record)
    except InputError as error:
        return {"refused": str(error)}
    arrays = clip.means, clip.scales, clip.quats
    notes = simulation.report().get("notes", [])
    return {
        "lattice": isinstance(simulation.solver, LatticeSolver),
        "frames": len(clip.times),
        "stopped": simulation.stopped,
        "remedies": [(remedy.words, remedy.changes) for remedy in simulation.remedies],
        "finite": all(bool(np.isfinite(a).all()) for a in arrays),
        "torn": [note for note in notes if "torn" in note or "tear" in note],
        "depth": round(deepest, 3),
        "seconds": round(time.process_time() - start, 1),
    }


def main() -> None:
    """Run the scenes of a range of seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", type=Path, required=True, help="folder of .splat files")
    parser.add_argument("first", type=int, help="first seed")
    parser.add_argument("last", type=int, help="seed after the last one")
    asked = parser.parse_args()
    files = [*sorted(asked.objects.glob("*.splat")), *sorted(EXAMPLES.glob("*.png"))]
    for seed in range(asked.first, asked.last):
        chosen, scene = draw_scene(seed, len(files))
        file = files[chosen]
        if file.suffix == ".splat":
            gaussians = read_gaussians(file, up="-y").gaussians
        else:
            gaussians = make_gaussians(file).gaussians
        row: dict[str, Any] = {"seed": seed, "object": file.stem}
        try:
            row |= run(gaussians, scene)
            remedies = row.pop("remedies", [])
            row["with"] = {
                words: run(gaussians, scene.replaced(changes)) for words, changes in remedies
            }
        except Exception as error:
            row["traceback"] = repr(error)
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
