"""Parts of scenes by name: every law, boundary and force; and the presets."""

from typing import Any

import pytest

from phy124 import forces, materials
from phy124.scene import Scene, preset_names

UPPER = {"lower": [-1, -1, 0.5], "upper": [1, 1, 2]}
LAWS: dict[str, dict[str, Any]] = {
    **{law: {"law": law} for law in materials.LAWS.by_name},
    **{
        f"damped {law}": {"law": law, "damping": 10.0}
        for law, kind in materials.LAWS.by_name.items()
        if "damping" in kind.model_fields
    },
}
SWING = {"kind": "swing", "amplitude": [0.05, 0.02, 0.05], "frequency": 20.0}
SOLIDS: dict[str, dict[str, Any]] = {
    "ground": {"kind": "ground"},
    "half_space": {"kind": "half_space", "point": [0, 0, 0.15], "normal": [0.3, 0.2, 0.93]},
    "box": {"kind": "box", "lower": [-0.25, -0.3, -0.3], "upper": [0.3, 0.25, 0.2]},
    "sphere": {"kind": "sphere", "centre": [0.1, 0.05, 0.1], "radius": 0.25},
    "capsule": {"kind": "capsule", "start": [-0.4, 0, 0], "end": [0.4, 0.1, 0.1], "radius": 0.2},
    "container": {
        "kind": "container",
        "inside": {"lower": [-0.4, -0.4, 0.1], "upper": [0.4, 0.4, 2]},
    },
    "held": {"kind": "held", "upper": [10, 10, 0.3]},
    "held cylinder": {
        "kind": "held",
        "lower": [-0.2, -0.2, -1],
        "upper": [0.2, 0.2, 2],
        "cylinder": "z",
    },
    "foot": {"kind": "foot"},
}
OTHER_SOLIDS: dict[str, dict[str, Any]] = {
    "press": {"kind": "press", "top": 0.9, "down": 0.004},
    "gripper": {"kind": "gripper", "opening": 0.9, "closed": 0.6, "close": 0.004, "thick": 0.3},
    "foot that lets go": {"kind": "foot", "end": 0.004},
    "held in one direction": {"kind": "held", "upper": [10, 10, 0.3], "contact": "slip"},
}
OPTIONS: dict[str, dict[str, Any]] = {
    "acceleration": {"a": [0, 3, 0]},
    "force": {"f": [0, 1, 0], "region": UPPER},
    "impulse": {"p": [0, 0.1, 0], "region": UPPER},
    "particle_force": {"f": [0, 1e-4, 0]},
    "zone": {"place": UPPER},
    "wind": {"v": [3, 0, 0]},
    "set_velocity": {"v": [0, 0, 1], "region": UPPER, "end": 0.005},
    "grab": {"point": [0.2, 0, 0.6], "times": [0, 0.01], "targets": [[0, 0, 0], [0.05, 0, 0.05]]},
    "wrench": {"torque": [0, 0, 0.5]},
}
FORCES: dict[str, dict[str, Any]] = {
    **{kind: {"kind": kind, **OPTIONS.get(kind, {})} for kind in forces.FORCES.by_name},
    "varying acceleration": {
        "kind": "acceleration",
        "a": [0, 3, 0],
        "profile": {"kind": "sine", "frequency": 30.0},
    },
    "acceleration of a region": {"kind": "acceleration", "a": [0, 3, 0], "region": UPPER},
}
OF_ONE = [name for name in preset_names() if not Scene.named(name).objects]
"""Presets of one object."""
USUAL = "land_on_cushion"
"""The preset of several objects that the default tests include."""


def each_preset() -> list:
    """Return all presets; presets of several objects, except one, are slow tests."""
    slow = pytest.mark.slow
    others = [name for name in preset_names() if name not in (*OF_ONE, USUAL)]
    return [*OF_ONE, USUAL, *(pytest.param(name, marks=slow) for name in others)]
