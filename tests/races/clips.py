"""Clips whose dependence on the order of threads is measured: every preset, law and solid."""

from collections.abc import Callable
from typing import Any

from phy124.io.clip import Clip
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation, prepare
from races.lattices import BESIDE, below
from races.runs import FALLING
from support.scenes import LAWS, OTHER_SOLIDS, SOLIDS, SWING
from support.shapes import ball

Clips = dict[str, Callable[[], Clip]]
SHORT = {"accuracy": {"cells": 8, "solver": "mpm"}, "time.frames": 8}


def clip(preset: str, **changes: Any) -> Clip:
    """Clips of a ball of particles."""
    scene = Scene.named(preset).replaced({**SHORT, **changes})
    return Simulation(prepare(ball(500), scene, RunContext(threads=1))).run()


def presets() -> Clips:
    """Clips of all presets, unchanged."""
    return {name: lambda name=name: clip(name) for name in preset_names()}


def laws() -> Clips:
    """A ball of each material hits the ground."""
    fall = {"object.lift": 0.02, "object.velocity": [0.5, 0.2, -2.0]}
    return {
        name: lambda material=material: clip("drop", material=material, **fall)
        for name, material in LAWS.items()
    }


def solids() -> Clips:
    """A ball hits each boundary, off its middle."""
    fall = {"object.lift": 0.02, "object.velocity": [0.5, 0.2, -2.0]}
    # A plate that comes down within 4 ms tears the ball, and rounding decides where.
    walls = {**SOLIDS, **OTHER_SOLIDS, "press": {**OTHER_SOLIDS["press"], "down": 0.03}}
    return {
        name: lambda wall=wall: clip("drop", boundaries=[wall], **fall)
        for name, wall in walls.items()
    }


def lattices() -> Clips:
    """A ball on its lattice meets a moving wall, a free solid and another ball."""
    swing = {"boundaries": [{**SOLIDS["sphere"], "motion": SWING}]}
    cases = {"wall": swing, "solid": below("box"), "ball": {"objects": [BESIDE]}}
    chosen = {"accuracy": {"cells": 8, "solver": "lattice"}, **FALLING}
    return {
        name: lambda changes=changes: clip("drop", **chosen, **changes)
        for name, changes in cases.items()
    }


def liquids() -> Clips:
    """A solid, an elastic body, and a body on its lattice fall into water with the object."""
    stone = {"name": "stone", "size": 0.5, "on": "object", "shape": "sphere"}
    free = {**stone, "motion": {"kind": "free", "density": 400}}
    elastic = {**stone, "material": {"law": "neo_hookean", "E": 1e5}}
    lattice = {"cells": 8, "solver": "lattice"}
    cases: dict[str, dict[str, Any]] = {
        "solid": {"objects": [free]},
        "body": {"objects": [elastic]},
        "body on a lattice": {"objects": [elastic], "accuracy": lattice},
    }
    return {
        name: lambda changes=changes: clip("water", **changes) for name, changes in cases.items()
    }


CLIPS: dict[str, Callable[[], Clips]] = {
    "presets": presets,
    "laws": laws,
    "solids": solids,
    "lattices": lattices,
    "liquids": liquids,
}
