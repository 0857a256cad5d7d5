"""Checks whether the lattice solver supports a scene; errors name the unsupported field.

Arguments `scene` are of the class `phy124.scene.Scene`, which cannot be imported here, because
phy124.scene imports this module.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from phy124.errors import InputError
from phy124.materials import LAWS, Material
from phy124.materials.elastic import Elastic

TRANSFERS = ("transfer", "gradient", "rpic_damping")
"""Accuracy options that concern transfers, which the lattice solver does not have."""
REMEDY = 'Use accuracy.solver = "mpm", or remove {field}.'


class Refusal(NamedTuple):
    """An option that the lattice solver does not support."""

    field: str
    value: object
    limit: str
    remedy: str = ""


def reason_for_particles(scene: Any) -> str:
    """Return the reason why a scene's elastic objects cannot use lattices; empty if they can.

    The result does not depend on `accuracy.solver`, and needs no Gaussians. If the scene has a
    properties file, the constitutive laws are read from this file.

    Raises:
        InputError: The scene's properties file cannot be read.
    """
    accuracy = scene.resolution
    for name in TRANSFERS:
        value = getattr(accuracy, name)
        if value != type(accuracy).model_fields[name].default:
            return f"accuracy.{name} is {value}"
    # The liquid keeps its solver, so that the reason names a feature that this solver does not
    # support.
    chosen = {"solver": "lattice", "liquid": "projection" if scene.projects else accuracy.liquid}
    accuracy = accuracy.model_copy(update=chosen)
    scene = scene.model_copy(update={"accuracy": accuracy})
    if not any(scene.on_lattices):
        return "no object consists of elastic materials only"
    for section in scene.materials:
        if is_elastic(section) and section.may_collapse and not getattr(section, "damping", 0):
            return f"{section.law} without damping does not resist being squeezed flat"
    refusal = next(_refusals(scene, scene.materials), None)
    return f"{refusal.field} is {refusal.value}: {refusal.limit}" if refusal else ""


def refuse_for_lattice(scene: Any, materials: Sequence[Material]) -> None:
    """Check that the lattice solver supports a scene.

    Raises:
        InputError: The scene has a feature that the lattice solver does not support.
    """
    for refusal in _refusals(scene, materials):
        remedy = refusal.remedy or REMEDY.format(field=refusal.field)
        raise InputError(refusal.field, refusal.value, refusal.limit, remedy)


def _refusals(scene: Any, materials: Sequence[Material]) -> Iterator[Refusal]:
    if scene.couples:
        yield from (_refusals_of_immersed if scene.projects else _refusals_of_couples)(scene)
    yield from _refusals_of_materials(scene, materials)
    if scene.binding != "lattice":
        yield Refusal("binding", scene.binding, "its particles are not on a lattice.")
    accuracy = scene.resolution
    if accuracy.particles_per_axis not in (None, 2.0):
        limit = "a lattice always has two points per cell and axis."
        yield Refusal("accuracy.particles_per_axis", accuracy.particles_per_axis, limit)
    for boundary in scene.boundaries:
        if boundary.holds and boundary.contact != "sticky":
            field = f"boundaries.{boundary.kind}.contact"
            limit = "a body on a lattice can only be fixed in all directions."
            remedy = 'Use contact = "sticky", or accuracy.solver = "mpm".'
            yield Refusal(field, boundary.contact, limit, remedy)


def _refusals_of_materials(scene: Any, materials: Sequence[Material]) -> Iterator[Refusal]:
    remedy = 'Use accuracy.solver = "mpm", or an elastic law.'
    for section in materials:
        if not is_elastic(section) and not scene.couples:
            limit = "the lattice solver is for elastic laws, which do not yield."
            yield Refusal(_field_of(scene, section), getattr(section, "law", "?"), limit, remedy)
    if scene.properties is None or not scene.on_lattices[0]:
        return
    for law in sorted(scene.properties.laws() & LAWS.by_name.keys()):
        if not is_elastic(LAWS.by_name[law].model_validate({"law": law})):
            limit = "an object on a lattice must consist of elastic materials only."
            yield Refusal("properties.file", f"law {law}", limit, remedy)


def _field_of(scene: Any, section: Material) -> str:
    """Return the path of a material's law in the scene; the first one if several are equal."""
    owners = [("", scene), *((f"objects.{i}.", item) for i, item in enumerate(scene.objects))]
    for prefix, body in owners:
        parts = [(f"parts.{i}.", part) for i, part in enumerate(body.parts)]
        for inner, owner in (("", body), *parts):
            if owner.material == section:
                return f"{prefix}{inner}material.law"
    return "material.law"


def _refusals_of_couples(scene: Any) -> Iterator[Refusal]:
    """Yield the features that are not supported if a scene has both lattices and particles."""
    limit = "it is not supported if a scene has objects on lattices and objects made of particles."
    for number, force in enumerate(scene.acting):
        if not force.uniform:
            yield Refusal(f"forces.{number}", force.kind, limit)
    solids = ", ".join(body.name for body in scene.objects if body.free)
    if solids:
        yield Refusal("objects.motion", solids, limit)
    if scene.stiffness_profile is not None:
        yield Refusal("stiffness_profile", "set", limit)


def _refusals_of_immersed(scene: Any) -> Iterator[Refusal]:
    """Yield the features that are not supported if lattices are in a projected liquid."""
    sections = scene.materials
    if any(not is_elastic(section) and section.law != "fluid" for section in sections):
        limit = "the liquid also contains objects that yield, which are not on lattices."
        remedy = 'Use accuracy.liquid = "compressible", or accuracy.solver = "mpm".'
        yield Refusal("accuracy.liquid", "projection", limit, remedy)
    solids = ", ".join(body.name for body in scene.objects if body.free)
    if solids:
        limit = "free solids are not supported if lattices are in a liquid."
        yield Refusal("objects.motion", solids, limit)
    objects = zip(scene.names, scene.object_materials, strict=True)
    wet = [name for name, materials in objects if materials and materials[0].law == "fluid"]
    for number, force in enumerate(scene.acting):
        if len(wet) > 1 and force.object in wet:
            limit = "a force cannot act on one of several liquids if lattices are in the liquids."
            yield Refusal(f"forces.{number}.object", force.object, limit)


def not_immersed(scene: Any) -> bool:
    """Return whether a scene's projected liquid prevents the use of lattices."""
    return next(_refusals_of_immersed(scene), None) is not None


def is_elastic(section: Material) -> bool:
    """Return whether a material's law can run on a lattice, as the elastic laws of phy124 can."""
    return isinstance(section, Elastic) and section.device_law.project is None
