"""A scene in one line: what will be computed, with every number the law was given."""

from __future__ import annotations

import re
from collections.abc import Iterable

from phy124.materials import AnyMaterial
from phy124.scene.declaration import number
from phy124.scene.scene import Scene

RIDES = {
    "lattice": "Gaussians riding on a lattice of particles",
    "particles": "every Gaussian a particle",
}
"""The bindings, in words."""


def summary(scene: Scene) -> str:
    """The law with its values, the forces, the boundaries, the grid and the frames, in one line."""
    said = [_material(scene.material)]
    if scene.parts:
        kinds = ("static" if part.static else _material(part.material) for part in scene.parts)
        said.append(f"parts {', '.join(kinds)}")
    said += [f"{one.name} {_material(one.material)}" for one in scene.objects]
    if scene.stiffness is not None:
        said.append(f"stiffness {scene.stiffness.kind}")
    if scene.properties is not None:
        said.append(f"properties from {scene.properties.file.name}")
    said += [_kinds(scene.forces, "no forces"), _kinds(scene.boundaries, "no boundaries")]
    accuracy, time = scene.resolution, scene.time
    said.append(
        f"{number(scene.object.size)} m over {accuracy.cells} cells, "
        f"{number(scene.particles_per_axis)} "
        f"particles per cell and axis, {accuracy.precision}, {RIDES[scene.binding]}"
    )
    return "; ".join([*said, f"{time.frames} frames at {number(time.fps)}/s"])


def _material(material: AnyMaterial) -> str:
    values = []
    for name, info in type(material).model_fields.items():
        unit = re.search(r"\[(.*)\]", info.description or "")
        if name != "law":
            value = number(getattr(material, name))
            values.append(f"{name} {value} {unit[1]}" if unit else f"{name} {value}")
    return f"{material.law} ({', '.join(values)})"


def _kinds(sections: Iterable, none: str) -> str:
    return ", ".join(section.kind for section in sections) or none
