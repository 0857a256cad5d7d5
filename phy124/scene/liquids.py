"""Decides in which scenes the liquid is computed by pressure projection.

`scene` is a `Scene`, which imports this module.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from phy124.errors import InputError, Remedy
from phy124.lattice.refusals import not_immersed
from phy124.scene.accuracies import USUAL

REMEDY = Remedy("accuracy.liquid = compressible", {"accuracy.liquid": "compressible"})
"""The compressible solver supports all scenes."""


def reason_for_compressible(scene: Any) -> str:
    """Return the reason why a scene's liquid is computed as compressible. If the liquid is computed
    by pressure projection, return an empty text.
    """
    accuracy = scene.resolution
    if accuracy.liquid is not None:
        return "" if accuracy.liquid == "projection" else "accuracy.liquid is compressible"
    if accuracy.solver == "lattice" and not_immersed(scene):
        return f"accuracy.solver is {accuracy.solver}"
    for name, usual in USUAL.items():
        if getattr(accuracy, name) != usual:
            return f"accuracy.{name} is {getattr(accuracy, name)}"
    if scene.binding == "particles":
        return "binding is particles"
    if scene.properties is not None:
        return "it does not support materials that vary from point to point"
    for field, _, limit in _obstacles(scene, mixes=scene.has_solids):
        return f"it does not support {limit} ({field})"
    return ""


def note_compressible(scene: Any) -> str | None:
    """Return a note if a setting other than `accuracy.liquid` makes the liquid compressible."""
    fluid = any(section.law == "fluid" for section in scene.materials)
    if not fluid or scene.projects or scene.resolution.liquid is not None:
        return None
    return (
        f"Pressure projection is not used for the liquid: {reason_for_compressible(scene)}. In a "
        "compressible liquid, waves are too high, and other objects sink and rise too slowly. In a "
        "test, a block of metal sank by 0.16 m within 1 s, instead of 0.50 m with projection. To "
        "use projection, change this setting."
    )


def keep_solver(scene: Any, before: Any) -> Any:
    """Return `scene` with the solver that the scene `before` uses for the liquid."""
    if not any(section.law == "fluid" for section in scene.materials):
        return scene
    liquid = "projection" if before.projects else "compressible"
    accuracy = scene.resolution.model_copy(update={"liquid": liquid})
    return scene.model_copy(update={"accuracy": accuracy})


def refuse_unprojectable(scene: Any) -> None:
    """Check that pressure projection supports everything in the scene. `scene` must have a wall for
    each solid on a path.

    Raises:
        InputError: The scene contains something that only the compressible solver supports.
    """
    for field, value, limit in _obstacles(scene, mixes=scene.mixes):
        raise InputError(
            field,
            value,
            f"accuracy.liquid = projection does not support {limit}.",
            f"Set {REMEDY.words}.",
            [REMEDY],
        )


def _obstacles(scene: Any, *, mixes: bool) -> Iterator[tuple[str, object, str]]:
    """Yield field, value and description of unsupported features.

    `mixes` is true if some materials are not liquids.
    """
    yield from _of_objects(scene)
    named = zip(scene.names, scene.object_materials, strict=True)
    liquids = {name for name, materials in named if _is_liquid(materials)}
    for index, wall in enumerate(scene.boundaries):
        if mixes and wall.object not in liquids:
            continue
        if wall.holds:
            yield f"boundaries.{index}", wall.kind, "boundaries that hold material"
        if wall.object is not None:
            limit = "boundaries that act on a single object"
            yield f"boundaries.{index}.object", wall.object, limit
    if scene.keeps_contacts:
        field, value = ("contacts", "true") if scene.contacts else ("view.outputs", "force")
        yield field, value, "forces of walls on single particles"
    if scene.stiffness_profile is not None and not mixes:
        yield "stiffness_profile", scene.stiffness_profile.kind, "a stiffness that changes"


def _of_objects(scene: Any) -> Iterator[tuple[str, object, str]]:
    wet = [_is_liquid(materials) for materials in scene.object_materials]
    for index, (body, holds_liquid) in enumerate(zip(scene.every_object, wet, strict=True)):
        if body.held and holds_liquid:
            field = f"objects.{index - 1}.held" if index else "object.held"
            yield field, "true", "liquids that are held"
        if holds_liquid is None:
            field = f"objects.{index - 1}.parts" if index else "parts"
            yield field, f"parts of {body.name}", "objects that are partly liquid"
    moving = [w for w, body in zip(wet, scene.every_object, strict=True) if not body.scenery]
    order = [number for number, holds_liquid in enumerate(moving) if holds_liquid]
    if order and order[-1] - order[0] >= len(order):
        yield "objects", "the order", "other objects listed between two liquids"


def _is_liquid(materials: Sequence[Any]) -> bool | None:
    """Return whether an object is a liquid; None if only some parts are."""
    liquid = {section.law == "fluid" for section in materials}
    return None if len(liquid) > 1 else liquid == {True}
