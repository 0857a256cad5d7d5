"""Scenes that a liquid by pressure projection cannot compute yet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from phy124.errors import InputError, Remedy
from phy124.materials import AnyMaterial
from phy124.scene import Scene

REMEDY = Remedy("accuracy.liquid = compressible", {"accuracy.liquid": "compressible"})
"""The solver that computes all scenes."""


def refuse_unprojectable(scene: Scene, materials: Sequence[AnyMaterial]) -> None:
    """Check that everything that moves in a scene is one liquid.

    Args:
        scene: The scene, with solids on a path as walls.
        materials: Materials of the particles.

    Raises:
        InputError: The scene has something that needs the compressible solver.
    """
    for field, value, limit in _obstacles(scene, materials):
        raise InputError(
            field,
            value,
            f"accuracy.liquid = projection does not support {limit}.",
            f"Set {REMEDY.words}.",
            [REMEDY],
        )


def _obstacles(scene: Scene, materials: Sequence[AnyMaterial]) -> Iterator[tuple[str, object, str]]:
    """Yield field, value and description of everything that is not supported."""
    yield from _of_materials(materials)
    for body in scene.every_object:
        if body.held:
            yield "object.held", body.name, "liquids that are held"
    for wall in scene.boundaries:
        if wall.holds:
            yield "boundaries", wall.kind, "boundaries that hold material"
        if wall.object is not None:
            yield "boundaries.object", wall.object, "boundaries of a single object"
    asked = {
        "contacts": (scene.keeps_contacts, "forces of walls on single particles"),
        "stiffness_profile": (scene.stiffness_profile is not None, "a stiffness that changes"),
        "checks.energy": (scene.checks.energy, "the energy lost by cause"),
    }
    yield from ((field, "set", limit) for field, (wanted, limit) in asked.items() if wanted)


def _of_materials(materials: Sequence[AnyMaterial]) -> Iterator[tuple[str, object, str]]:
    """Yield the unsupported features of some materials."""
    for section in materials:
        if section.law != "fluid":
            yield "material.law", section.law, "materials other than fluid in the same scene"
    densities = sorted({section.density for section in materials})
    if len(densities) > 1:
        yield "material.density", densities, "liquids of different densities"
    viscosities = sorted({s.viscosity for s in materials if s.law == "fluid"})
    if len(viscosities) > 1:
        yield "material.viscosity", viscosities, "liquids of different viscosities"
