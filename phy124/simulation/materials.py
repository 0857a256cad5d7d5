"""Assigns materials to particles, by parts of the scene, a properties file, or a stiffness field.

Later parts override earlier parts. Static parts have no particles.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from phy124.errors import InputError
from phy124.imaging.painted import Canvas, sample_brightness
from phy124.materials import AnyMaterial
from phy124.particles import Particles
from phy124.particles.shares import Parts
from phy124.properties import COLUMNS, FRACTION
from phy124.scene import Part, Scene
from phy124.schema.refusals import explain, shorten


def assign(
    x: NDArray,
    gaussian: NDArray,
    parts: Sequence[Part],
    canvas: Canvas,
    means: NDArray | None = None,
    *,
    refuse: bool = True,
) -> NDArray[np.int32]:
    """Return the material index of each particle [P]: 0 for the scene's material, i for part i.

    Args:
        x: Positions at rest [P,3], m.
        gaussian: Index of each particle's Gaussian [P]; -1: the nearest Gaussian is used.
        parts: The scene's parts.
        canvas: The front of the object, over which pictures are painted.
        means: Centres of the Gaussians [N,3], m; needed only for particles without a Gaussian.
        refuse: Whether a part without particles is refused.

    Raises:
        InputError: A mask cannot be read, or a part contains no particle.
    """
    chosen = np.zeros(len(x), np.int32)
    for number, part in enumerate(parts, 1):
        inside = np.ones(len(x), bool)
        if part.region is not None:
            if part.region.units == "file":
                limit = "the object was not read from a .ply file by `phy124 simulate`."
                field = f"parts.{number - 1}.region.units"
                raise InputError(field, "file", limit, "Define the region in metres.")
            inside &= part.region.contains(x)
        if part.gaussians is not None:
            inside &= _belong_to(x, gaussian, part.gaussians, means)
        if part.mask is not None:
            inside &= (
                sample_brightness(x, part.mask, canvas, field=f"parts.{number - 1}.mask") > 0.5
            )
        if refuse and not inside.any() and not part.surroundings:
            remedy = "Choose a larger region, another mask or other Gaussians."
            raise InputError(
                f"parts.{number - 1}", shorten(part.data()), "it holds no particle.", remedy
            )
        chosen[inside] = number
    return chosen


def parts_of(scene: Scene, means: NDArray, canvas: Canvas) -> Parts | None:
    """Return the parts among which the cells of a lattice are divided; None: there are no parts.

    Static parts end at whole cells, so that no cell is both static and moving.
    """
    if not scene.parts:
        return None

    def find(x: NDArray) -> NDArray[np.int32]:
        return assign(x, np.full(len(x), -1), scene.parts, canvas, means, refuse=False)

    return Parts(find, np.array([False, *(part.static for part in scene.parts)]))


def assign_materials(
    particles: Particles, means: NDArray, scene: Scene, canvas: Canvas
) -> tuple[Particles, NDArray[np.bool_]]:
    """Return the particles with their parts' materials, and the mask of the moving Gaussians [N].

    Args:
        particles: Particles of all Gaussians, including static Gaussians. Particles that stand for
            cells have the index of their part as material.
        means: The Gaussians at rest [N,3], m.
        scene: The scene, with its parts.
        canvas: The front of the object, over which pictures are painted.

    Returns:
        The moving particles, sorted by law, with indices into the moving Gaussians; and the mask.

    Raises:
        InputError: A part contains no particle, or all Gaussians are static.
    """
    every = np.ones(len(means), bool)
    if not scene.parts:
        return particles, every
    part, listed = particles.material, np.arange(len(scene.parts)) + 1
    if particles.cell is None or not np.isin(listed, part).all():
        at_centres = assign(particles.x, particles.gaussian, scene.parts, canvas, means)
        part = at_centres if particles.cell is None else part
    static = np.array([False, *(section.static for section in scene.parts)])
    moves = every
    if static.any():
        seen = assign(means, np.arange(len(means)), scene.parts, canvas)
        bound = particles.gaussian >= 0
        # A Gaussian and its particle must have the same material. Filler particles may extend a
        # mask.
        part[bound] = seen[particles.gaussian[bound]]
        moves = ~static[seen]
    kept = np.flatnonzero(~static[part])
    if not moves.any() or not len(kept):
        limit = "every Gaussian is static, so nothing moves."
        raise InputError(
            "parts", "static = true", limit, "Set static = false in at least one part."
        )
    laws = [section.device_law.name for section in scene.materials]
    # Index of each part's material among the materials of all moving parts.
    material = (np.cumsum(~static) - 1)[part[kept]]
    law = np.array([laws.index(name) for name in laws])[material]
    order = np.argsort(law, kind="stable")
    kept, material = kept[order], material[order]
    gaussian = particles.gaussian[kept]
    density = np.array([section.density for section in scene.materials])[material]
    moving = Particles(
        x=particles.x[kept],
        volume=particles.volume[kept],
        density=density,
        material=material.astype(np.int32),
        gaussian=np.where(gaussian >= 0, (np.cumsum(moves) - 1)[gaussian], -1).astype(np.int32),
        cell=None if particles.cell is None else particles.cell[kept],
        piece=None if particles.piece is None else particles.piece[kept],
    )
    return moving, moves


def _belong_to(
    x: NDArray, gaussian: NDArray, span: tuple[int, int], means: NDArray | None
) -> NDArray[np.bool_]:
    """Return a mask of the particles whose Gaussian, or nearest Gaussian, has an index in
    `span`.
    """
    owner = gaussian.copy()
    bound, filler = gaussian >= 0, gaussian < 0
    if means is not None and not bound.any():
        owner = scipy.spatial.KDTree(means).query(x)[1]
    elif filler.any() and bound.any():
        nearest = scipy.spatial.KDTree(x[bound]).query(x[filler])[1]
        owner[filler] = gaussian[bound][nearest]
    return np.logical_and(owner >= span[0], owner < span[1])


def vary_materials(
    particles: Particles,
    scene: Scene,
    means: NDArray,
    *,
    survivors: NDArray[np.bool_] | None,
    belonging: NDArray[np.bool_],
    canvas: Canvas,
) -> tuple[Particles, Sequence[AnyMaterial], NDArray[np.float64] | None]:
    """Apply the scene's properties file and stiffness. Return the particles, their materials, and
    the fraction of E for each particle [P] or None.

    Args:
        particles: The moving particles, with indices into the scene's materials.
        scene: The scene, with its properties file and its stiffness.
        means: All Gaussians at rest [N,3], m.
        survivors: Mask of the Gaussians that cleaning kept; None: all were kept.
        belonging: Mask of the object's Gaussians, without its surroundings [N].
        canvas: The front of the object, over which pictures are painted.

    Raises:
        InputError: Properties or stiffness cannot be used for these materials.
    """
    materials: Sequence[AnyMaterial] = scene.materials
    listed = None
    if scene.properties is not None:
        # The file describes the object before it is rotated in the scene.
        upright, centres = particles.x @ canvas.axes, means @ canvas.axes
        columns = scene.properties.columns(upright, centres, survivors, belonging)
        listed = columns.pop(FRACTION, None)
        particles, materials, order = with_properties(particles, columns, materials)
        listed = None if listed is None else listed[order]
    return (
        particles,
        materials,
        stiffness_fractions(particles, means[belonging], scene, canvas, listed),
    )


def with_properties(
    particles: Particles, columns: dict[str, NDArray[Any]], materials: Sequence[AnyMaterial]
) -> tuple[Particles, list[AnyMaterial], NDArray[np.intp]]:
    """Assign the materials of a properties file to particles. Return the particles sorted by law,
    the materials, and the previous index of each particle.

    Args:
        particles: The moving particles, with indices into `materials`.
        columns: The columns of the file by name: E, nu, density, damping and names of laws, each
            [P]. Columns may be missing.
        materials: The scene's materials; a column replaces the field of the same name.

    Raises:
        InputError: No law has a field for a column, or a value is outside its bounds.
    """
    bases, base = list(materials), particles.material.copy()
    for name in np.unique(columns.get("law", np.array([], str))).tolist():
        chosen = columns["law"] == name
        alike = np.array([section.law == name for section in bases])[base]
        base[chosen & ~alike] = _find_or_add(name, bases)
    listed = [name for name in COLUMNS if name in columns]
    has = np.array([[name in type(section).model_fields for name in listed] for section in bases])
    used = has[np.unique(base)].any(axis=0)
    if not used.all():
        name = listed[int(np.argmin(used))]
        limit = f"the law {bases[base[0]].law} has no {name}."
        raise InputError(
            "properties.file",
            name,
            limit,
            "Use another law, or remove this property from the file.",
        )
    values = (np.where(has[base, i], columns[name], 0.0) for i, name in enumerate(listed))
    rows = np.column_stack([base, *values])
    kinds, kind = np.unique(rows, axis=0, return_inverse=True)
    made = [
        _with_values(bases[int(row[0])], dict(zip(listed, row[1:], strict=True))) for row in kinds
    ]
    _check_extremes(kinds, listed, bases)
    laws = list(dict.fromkeys(section.device_law.name for section in (*bases, *made)))
    law = np.array([laws.index(section.device_law.name) for section in made])[kind.ravel()]
    order = np.argsort(law, kind="stable")
    kind = kind.ravel()[order]
    density = np.array([section.density for section in made])[kind]
    rest = {n: getattr(particles, n)[order] for n in ("x", "volume", "gaussian")}
    cell = None if particles.cell is None else particles.cell[order]
    ordered = replace(particles, **rest, density=density, material=kind.astype(np.int32), cell=cell)
    return ordered, made, order


def _find_or_add(name: str, bases: list[AnyMaterial]) -> int:
    for number, section in enumerate(bases):
        if section.law == name:
            return number
    try:
        bases.append(TypeAdapter(AnyMaterial).validate_python({"law": name}))
    except ValidationError:
        field, limit = "properties.file", "there is no such law."
        raise InputError(field, f"law {name}", limit, "See `phy124 scenes`.") from None
    return len(bases) - 1


def _with_values(base: AnyMaterial, values: dict[str, float]) -> AnyMaterial:
    fields = {name: value for name, value in values.items() if name in type(base).model_fields}
    same = all(getattr(base, name) == value for name, value in fields.items())
    return base if same else base.model_copy(update=fields)


def _check_extremes(kinds: NDArray, names: list[str], bases: list[AnyMaterial]) -> None:
    for number, section in enumerate(bases):
        rows = kinds[kinds[:, 0] == number]
        for column, name in enumerate(names, 1):
            if not len(rows) or name not in type(section).model_fields:
                continue
            for value in {float(rows[:, column].min()), float(rows[:, column].max())}:
                try:
                    type(section).model_validate({**section.model_dump(), name: value})
                except ValidationError as error:
                    wrong = explain(error, "material", type(section))
                    remedy = "Correct the file, or limit its values to the bounds."
                    raise InputError(
                        "properties.file", f"{name} = {value:g}", wrong.limit, remedy
                    ) from None


def stiffness_fractions(
    particles: Particles,
    means: NDArray,
    scene: Scene,
    canvas: Canvas,
    listed: NDArray[np.float64] | None = None,
) -> NDArray[np.float64] | None:
    """Return each particle's fraction of the material's E [P]; None if all fractions are 1.

    Args:
        particles: The particles that move.
        means: The object's Gaussians [N,3], m.
        scene: The scene, with its stiffness and materials.
        canvas: The front of the object, over which pictures are painted.
        listed: Fractions [P] from a properties file, multiplied by those of the stiffness.

    Raises:
        InputError: No material has an E that may vary, or a fraction of E is below a law's bounds.
    """
    if scene.stiffness is None and listed is None:
        return None
    varying = [section for section in scene.materials if section.scaled]
    if not varying:
        field = "properties.file" if scene.stiffness is None else "stiffness"
        kind = "fraction" if scene.stiffness is None else scene.stiffness.kind
        limit = f"the law {scene.material.law} has no Young's modulus that may vary."
        raise InputError(field, kind, limit, f"Use another law, or remove {kind}.")
    fractions = np.ones(len(particles)) if listed is None else listed
    if scene.stiffness is not None:
        fractions = fractions * scene.stiffness.fractions(particles.x, means, canvas)
    for section in varying:
        _refuse_too_soft(section, float(fractions.min()))
    return fractions


def refuse_profile(scene: Scene, materials: Sequence[AnyMaterial]) -> None:
    """Refuse a stiffness that changes over time if it would change no material.

    Raises:
        InputError: No material has an E that may vary.
    """
    profile = scene.stiffness_profile
    if profile is None or any(section.scaled for section in materials):
        return
    limit = f"the law {scene.material.law} has no Young's modulus that may vary."
    remedy = "Use another law, or remove stiffness_profile."
    raise InputError("stiffness_profile", profile.kind, limit, remedy)


def _refuse_too_soft(section: AnyMaterial, fraction: float) -> None:
    softened = {**section.model_dump(), "E": getattr(section, "E", 0.0) * fraction}
    try:
        type(section).model_validate(softened)
    except ValidationError as error:
        wrong = explain(error, "material", type(section))
        limit = f"{section.law} cannot be so soft; {wrong.field}: {wrong.limit}"
        remedy = "Raise the smallest fraction, or the material's E."
        raise InputError("stiffness", f"{fraction:g} of E", limit, remedy) from None
