"""Summarises a scene in one line."""

import re
from collections.abc import Iterable

from phy124.materials import AnyMaterial
from phy124.scene.scene import Scene
from phy124.schema.declaration import format_number

BINDINGS = {
    "lattice": "Gaussians on a lattice of particles",
    "particles": "each Gaussian a particle",
}


def summarise(scene: Scene, cells: str = "") -> str:
    """Return law, parameters, forces, boundaries, grid and frames in one line.

    If the grid is chosen later, `cells` is written in place of the number of cells.
    """
    items = [_describe_material(scene.material)]
    if scene.parts:
        kinds = (
            "static" if part.static else _describe_material(part.material) for part in scene.parts
        )
        items.append(f"parts {', '.join(kinds)}")
    items += [f"{other.name} {_describe_material(other.material)}" for other in scene.objects]
    if scene.stiffness is not None:
        items.append(f"stiffness {scene.stiffness.kind}")
    if scene.properties is not None:
        items.append(f"properties from {scene.properties.file.name}")
    items.append(_list_kinds(scene.forces) or "no forces")
    items.append(_list_kinds(scene.boundaries) or "no boundaries")
    accuracy, time = scene.resolution, scene.time
    items.append(
        f"{format_number(scene.object.size)} m over {cells or f'{accuracy.cells} cells'}, "
        f"{format_number(scene.particles_per_axis)} "
        f"particles per cell and axis, {scene.precision}, solver {_list_solvers(scene)}, "
        f"{BINDINGS[scene.binding]}"
    )
    return "; ".join([*items, f"{time.frames} frames at {format_number(time.fps)}/s"])


def _describe_material(material: AnyMaterial) -> str:
    values = []
    for name, info in type(material).model_fields.items():
        unit = re.search(r"\[(.*?)\]", info.description or "")
        number = getattr(material, name)
        # Tint and visibility change the appearance, not the motion.
        if name not in ("law", "tint", "visibility") and number is not None:
            value = format_number(number)
            values.append(f"{name} {value} {unit[1]}" if unit else f"{name} {value}")
    return f"{material.law} ({', '.join(values)})"


def _list_solvers(scene: Scene) -> str:
    by_mpm = scene.has_solids or not scene.projects
    used = {
        "lattice": scene.on_lattice,
        "mpm": scene.couples and not scene.projects if scene.on_lattice else by_mpm,
        "projection": scene.projects,
    }
    return " and ".join(name for name, uses in used.items() if uses)


def _list_kinds(sections: Iterable) -> str:
    return ", ".join(section.kind for section in sections)
