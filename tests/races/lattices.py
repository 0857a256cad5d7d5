"""Groups of small scenes with bodies on lattices, and with other bodies in a liquid.

The forms of a GPU are chosen before this module is imported (gpu_forms.py).
"""

from typing import Any

import numpy as np

from phy124.boundaries import Held
from races.runs import FALLING, Runs, simulate
from support.lattices import block, make
from support.scenes import FORCES, SOLIDS, SWING

SHORT = {"time.frames": 4, "time.fps": 48.0}
"""Several substeps at 8 cells."""
WALLS: dict[str, dict[str, Any]] = {
    "ground": {"friction": 0.5},
    "half_space": {"contact": "sticky", "motion": SWING},
    "box": {"contact": "slip"},
    "sphere": {"friction": 0.3, "motion": SWING},
    "capsule": {"contact": "sticky"},
    "container": {"contact": "slip", "motion": SWING},
    "held": {"motion": SWING},
    "held cylinder": {},
}
"""Each contact, at rest and in motion, on flat and on curved walls."""
ON_POINTS = ("particle_force", "wind", "impulse", "grab")
"""Forces that act on points, not on nodes."""
SUMS = {"contacts": True, "wrenches": True, "checks.energy": True}


BESIDE = {"name": "beside", "place": [0, 1.01], "velocity": [0, -2.5, 0]}
"""An object that hits the first one."""


WATER = {
    **{"name": "water", "shape": "box", "size": 1.6, "sides": [1, 1, 0.35]},
    "material": {"law": "fluid"},
}
"""The water of the preset `oil`."""


def on_lattice(preset: str = "drop", **changes: Any) -> Any:
    """Run a few frames of a scene whose elastic objects are on lattices."""
    lattice = {"accuracy": {"cells": 8, "solver": "lattice"}}
    return simulate(preset, **{**lattice, **SHORT, **changes})


def lattices() -> Runs:
    """Return runs with each kind of contact, force and sum of bodies on lattices."""
    walls = {name: {**SOLIDS[name], **met} for name, met in WALLS.items()}
    gravity = {"kind": "gravity"}
    changes: dict[str, dict[str, Any]] = {
        **{f"on a {name}": {"boundaries": [wall]} for name, wall in walls.items()},
        **{name: {"forces": [gravity, FORCES[name]], "checks.energy": True} for name in ON_POINTS},
        "sums": SUMS,
        "a clamp with sums": {"boundaries": [walls["held"], {"kind": "ground"}], **SUMS},
        "without damping": {"material": {"law": "neo_hookean", "E": 1e5}},
        "another law": {"material": {"law": "hencky", "damping": 10.0}},
        **{f"below a {shape}": below(shape) for shape in ("sphere", "capsule", "box")},
    }
    runs: Runs = {
        name: lambda options=options: on_lattice(**{**FALLING, **options})
        for name, options in changes.items()
    }
    runs["two objects"] = collide
    runs["two objects that stick"] = lambda: collide(contact="sticky")
    runs["two prongs"] = clap
    runs["below sand"] = lambda: on_lattice("bury", wrenches=True)
    return runs


def below(shape: str) -> dict[str, Any]:
    """Return changes by which a rigid solid falls on the object."""
    motion = {"kind": "free", "density": 400}
    solid = {"name": "solid", "shape": shape, "size": 0.6, "on": "object", "motion": motion}
    sides = [0.7, 0.7, 1] if shape == "capsule" else [1, 1, 1]
    place = {"sides": sides, "lift": 0.01, "place": [0.2, 0], "turn": [20, 60, 0]}
    return {"objects": [{**solid, **place}], "checks.energy": True}


def collide(**pair: Any) -> None:
    """Let two objects that are almost in contact collide."""
    second = {"name": "right", "place": [0, 0.51], "velocity": [0, -2.5, 0]}
    pairs = [{"friction": 0.2, **pair}]
    on_lattice(
        "collide", **{"object.place": [0, -0.51], "objects": [second], "pairs": pairs, **SUMS}
    )


def clap() -> None:
    """Slam the two prongs of a fork together, whose root a clamp holds."""
    fork = block((0.5, 0.2, 0.6))
    fork.fraction[2:8, :, 2:] = 0
    clamp = Held(lower=(-1, -1, -1), upper=(1, 1, 0.15))
    solver = make(fork, precision="float32", boundaries=[clamp])
    solver.keep_works()
    solver.carry_nodes(lambda x, v: (x, v - 6 * np.sign(x - [0.25, 0, 0]) * [1, 0, 0]))
    solver.advance(0.04)
    assert solver.meetings.of_bodies[0].most > 0


def liquids() -> Runs:
    """Return runs with other bodies in a liquid."""
    stone = {"name": "stone", "size": 0.5, "on": "object", "shape": "sphere"}
    free = {**stone, "motion": {"kind": "free", "density": 400}}
    elastic = {**stone, "material": {"law": "neo_hookean", "E": 1e5}}
    floats = {**free, "name": "beside", "place": [0.5, 0]}
    stir = {**SOLIDS["sphere"], "motion": SWING}
    return {
        "a free solid": lambda: simulate("water", objects=[free], **SHORT),
        "a body and a free solid": lambda: simulate("water", objects=[elastic, floats], **SHORT),
        "moving walls": lambda: simulate("water", boundaries=[stir, SOLIDS["ground"]], **SHORT),
        "a body on a lattice": lambda: on_lattice("water", objects=[elastic]),
        "two liquids": lambda: simulate("oil", objects=[WATER, elastic], **SHORT),
        "a zone": lambda: simulate("water", forces=[{"kind": "gravity"}, FORCES["zone"]], **SHORT),
        "two workers": lambda: simulate("water", threads=2, **SHORT, **{"checks.energy": True}),
    }


GROUPS = {"lattices": lattices, "liquids": liquids}
