"""The material of each particle, where a file or a field of stiffness lets it vary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from phy124.errors import InputError
from phy124.imaging.painted import WHOLE, Crop
from phy124.materials import AnyMaterial
from phy124.particles import Particles
from phy124.properties import COLUMNS, FRACTION
from phy124.scene import Scene
from phy124.schema.refusals import explain


def varied(
    particles: Particles,
    scene: Scene,
    means: NDArray,
    *,
    survivors: NDArray[np.bool_] | None,
    own: NDArray[np.bool_],
    crop: Crop,
) -> tuple[Particles, Sequence[AnyMaterial], NDArray[np.float64] | None]:
    """Particles and materials as the scene's properties have them, and fractions of E [P].

    Args:
        particles: The particles that move; their materials are indices into the scene's.
        scene: Names the file of properties and the stiffness.
        means: All Gaussians at rest [N,3], m.
        survivors: Which of the Gaussians that were given are among them; None: all.
        own: Which of them are the object and not its surroundings [N].
        crop: Where the object is in its picture.

    Raises:
        InputError: Properties or stiffness cannot be used for these materials.
    """
    materials: Sequence[AnyMaterial] = scene.materials
    listed = None
    if scene.properties is not None:
        columns = scene.properties.columns(particles.x, means, survivors, own)
        listed = columns.pop(FRACTION, None)
        particles, materials, order = with_properties(particles, columns, materials)
        listed = None if listed is None else listed[order]
    return particles, materials, stiffnesses(particles, means[own], scene, crop, listed)


def with_properties(
    particles: Particles, columns: dict[str, NDArray[Any]], materials: Sequence[AnyMaterial]
) -> tuple[Particles, list[AnyMaterial], NDArray[np.intp]]:
    """Particles with the materials that a file gives them, sorted by law, and these materials.

    The order of the particles comes third.

    Args:
        particles: The particles that move; their materials are indices into `materials`.
        columns: E, nu, density, damping [P] and names of laws [P], as far as the file has them.
        materials: What the scene says; a column replaces the field of its name.

    Raises:
        InputError: If no law has a field of a column, or a value is beyond its bounds.
    """
    bases, base = list(materials), particles.material.copy()
    for name in np.unique(columns.get("law", np.array([], str))).tolist():
        chosen = columns["law"] == name
        alike = np.array([section.law == name for section in bases])[base]
        base[chosen & ~alike] = _of_law(name, bases)
    given = [name for name in COLUMNS if name in columns]
    has = np.array([[name in type(section).model_fields for name in given] for section in bases])
    used = has[np.unique(base)].any(axis=0)
    if not used.all():
        name = given[int(np.argmin(used))]
        limit = f"the law {bases[base[0]].law} has no {name}."
        raise InputError("properties.file", name, limit, "Use another law, or leave it out.")
    rows = np.column_stack([base, *(np.where(has[base, i], columns[name], 0.0)
                                    for i, name in enumerate(given))])  # fmt: skip
    kinds, kind = np.unique(rows, axis=0, return_inverse=True)
    made = [_made(bases[int(row[0])], dict(zip(given, row[1:], strict=True))) for row in kinds]
    _check_extremes(kinds, given, bases)
    laws = list(dict.fromkeys(section.device_law.name for section in bases))
    law = np.array([laws.index(section.device_law.name) for section in made])[kind.ravel()]
    order = np.argsort(law, kind="stable")
    kind = kind.ravel()[order]
    density = np.array([section.density for section in made])[kind]
    moved = {n: getattr(particles, n)[order] for n in ("x", "volume", "gaussian")}
    return replace(particles, **moved, density=density, material=kind.astype(np.int32)), made, order


def _of_law(name: str, bases: list[AnyMaterial]) -> int:
    """The number of a material of a law, which is added with its defaults if there is none."""
    for number, section in enumerate(bases):
        if section.law == name:
            return number
    try:
        bases.append(TypeAdapter(AnyMaterial).validate_python({"law": name}))
    except ValidationError:
        raise InputError(
            "properties.file", f"law {name}", "there is no such law.", "See `phy124 scenes`."
        ) from None
    return len(bases) - 1


def _made(base: AnyMaterial, values: dict[str, float]) -> AnyMaterial:
    own = {name: value for name, value in values.items() if name in type(base).model_fields}
    same = all(getattr(base, name) == value for name, value in own.items())
    return base if same else base.model_copy(update=own)


def _check_extremes(kinds: NDArray, given: list[str], bases: list[AnyMaterial]) -> None:
    """Raise InputError if a column's least or largest value is beyond the bounds of its field."""
    for number, section in enumerate(bases):
        rows = kinds[kinds[:, 0] == number]
        for column, name in enumerate(given, 1):
            if not len(rows) or name not in type(section).model_fields:
                continue
            for value in {float(rows[:, column].min()), float(rows[:, column].max())}:
                try:
                    type(section).model_validate({**section.model_dump(), name: value})
                except ValidationError as error:
                    wrong = explain(error, "material", type(section))
                    raise InputError(
                        "properties.file", f"{name} = {value:g}", wrong.limit,
                        "Correct the file, or clip its values.",
                    ) from None  # fmt: skip


def stiffnesses(
    particles: Particles,
    means: NDArray,
    scene: Scene,
    crop: Crop = WHOLE,
    listed: NDArray[np.float64] | None = None,
) -> NDArray[np.float64] | None:
    """Fraction of its material's E that each particle has [P]; None if all have the whole.

    Args:
        particles: The particles that move.
        means: The object's Gaussians [N,3], m.
        scene: Names the stiffness and the materials.
        crop: Where the object is in its picture.
        listed: Fractions [P] of a file of properties, which multiply those of the stiffness.

    Raises:
        InputError: If no material of the scene has an E that may vary, or none can be that soft.
    """
    if scene.stiffness is None and listed is None:
        return None
    varying = [section for section in scene.materials if section.scaled]
    if not varying:
        field = "properties.file" if scene.stiffness is None else "stiffness"
        given = "fraction" if scene.stiffness is None else scene.stiffness.kind
        raise InputError(
            field, given, f"the law {scene.material.law} has no Young's modulus that may vary.",
            f"Use another law, or leave {given} out.",
        )  # fmt: skip
    fractions = np.ones(len(particles)) if listed is None else listed
    if scene.stiffness is not None:
        fractions = fractions * scene.stiffness.fractions(particles.x, means, crop)
    for section in varying:
        _refuse_too_soft(section, float(fractions.min()))
    return fractions


def _refuse_too_soft(section: AnyMaterial, fraction: float) -> None:
    """Refuse a fraction for which a material's own bounds do not hold."""
    softened = {**section.model_dump(), "E": getattr(section, "E", 0.0) * fraction}
    try:
        type(section).model_validate(softened)
    except ValidationError as error:
        wrong = explain(error, "material", type(section))
        raise InputError(
            "stiffness", f"{fraction:g} of E",
            f"{section.law} cannot be so soft; of {wrong.field}, {wrong.limit}",
            "Raise the least fraction, or the material's E.",
        ) from None  # fmt: skip
