"""Scenes that a liquid by pressure projection cannot compute yet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from phy124.errors import InputError, Remedy
from phy124.materials import AnyMaterial
from phy124.scene import Scene

REMEDY = Remedy("accuracy.liquid = compressible", {"accuracy.liquid": "compressible"})
"""The solver that computes all scenes."""


def refuse_unprojectable(scene: Scene, materials: Sequence[AnyMaterial]) -> None:
    """Check that a scene has a single liquid, and nothing that its solver cannot compute.

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
    yield from _of_liquids(materials)
    yield from _of_objects(scene)
    for wall in () if scene.mixes else scene.boundaries:
        if wall.holds:
            yield "boundaries", wall.kind, "boundaries that hold material"
        if wall.object is not None:
            yield "boundaries.object", wall.object, "boundaries of a single object"
    softens = scene.stiffness_profile is not None and not scene.mixes
    asked = {
        "contacts": (scene.keeps_contacts, "forces of walls on single particles"),
        "stiffness_profile": (softens, "a stiffness that changes"),
        "checks.energy": (scene.checks.energy, "the energy lost by cause"),
    }
    yield from ((field, "set", limit) for field, (wanted, limit) in asked.items() if wanted)


def _of_liquids(
    materials: Sequence[AnyMaterial],
) -> Iterator[tuple[str, object, str]]:
    """Yield the properties in which the liquids among some materials differ."""
    liquids = [section for section in materials if section.law == "fluid"]
    for name, plural in (("density", "densities"), ("viscosity", "viscosities")):
        values = sorted({getattr(section, name) for section in liquids})
        if len(values) > 1:
            yield f"material.{name}", values, f"liquids of different {plural}"


def _of_objects(scene: Scene) -> Iterator[tuple[str, object, str]]:
    """Yield the features of the objects that are not supported."""
    wet = [_is_liquid(item) for item in (scene, *scene.objects)]
    for body, holds_liquid in zip(scene.every_object, wet, strict=True):
        if body.held and holds_liquid:
            yield "object.held", body.name, "liquids that are held"
        if getattr(body, "free", False) and scene.mixes:
            yield "object.free", body.name, "free solids next to other materials"
        if holds_liquid is None:
            yield "material.law", body.name, "objects that are partly liquid"
    moving = [w for w, body in zip(wet, scene.every_object, strict=True) if not _is_scenery(body)]
    order = [number for number, holds_liquid in enumerate(moving) if holds_liquid]
    if order and order[-1] - order[0] >= len(order):
        yield "objects", "the order", "other objects listed between two liquids"


def _is_liquid(item: Any) -> bool | None:
    """Return whether an object is a liquid; None if only some of its parts are."""
    if _is_scenery(item):
        return False
    laws = {
        section.law == "fluid" for section in [item.material, *(p.material for p in item.parts)]
    }
    return None if len(laws) > 1 else laws.pop()


def _is_scenery(item: Any) -> bool:
    return getattr(item, "scenery", False)
