"""Creates the particles and visible Gaussians of the objects in a scene, and joins all objects.

Each object is created as if it were alone in the scene, but with the grid spacing of the whole
scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Container
from phy124.boundaries.base import vector
from phy124.boundaries.motion import Free
from phy124.boundaries.planes import Plane
from phy124.errors import InputError
from phy124.gaussians import Gaussians, as_objects, quaternions
from phy124.generators.shapes import make_shape
from phy124.imaging.painted import WHOLE, Canvas, Crop
from phy124.io.axes import euler
from phy124.lattice.refusals import refuse_for_lattice
from phy124.materials import AnyMaterial
from phy124.motion.scenery import Scenery
from phy124.mpm import FreeBody
from phy124.particles import Cleaning, Particles, clean, make_particles
from phy124.particles.lattice import PER_CELL, cells_of, lattice_of, points_of, repeat_for_points
from phy124.particles.scatter import scatter
from phy124.particles.shares import find_excess
from phy124.particles.solid import Solid, find_interior
from phy124.particles.thickness import Proportions, measure_proportions
from phy124.scene import Scene, SceneObject
from phy124.scene.objects import ANY, find_pair
from phy124.simulation.appearance import Appearance, make_appearance
from phy124.simulation.materials import assign_materials, parts_of, vary_materials
from phy124.simulation.overlap import refuse_objects
from phy124.simulation.placing import mask_object, number_among_all, place, renumber_parts, stack

GRAINY = 24_000
"""Approximate number of Gaussians of a shape whose grains differ in brightness."""
FEWEST = 8
"""A further object with fewer cells along its longest side causes a note about a coarse grid."""
NOTICEABLE = 0.02
"""Smallest relative difference of the mass of the moving parts that causes a note."""
BRIDGED = 0.1
"""Smallest fraction of the volume inside a shell with openings that causes a note."""
PER_GAUSSIAN = ("max_stretch", "rounds", "flows", "holds", "kinds")


class Placed(NamedTuple):
    """One object in its position in the scene."""

    scene: Scene
    cleaned: Cleaning
    belonging: NDArray[np.bool_]
    """Mask of the Gaussians that do not belong to the surroundings [N]."""
    gaussians: Gaussians
    crop: Crop
    interior: Solid | None = None
    """The interior of the object; None if the interior is not known yet."""

    def within(self, scene: Scene) -> Placed:
        """Return a copy with another scene, but with the same parts."""
        return self._replace(scene=scene.model_copy(update={"parts": self.scene.parts}))


class Body(NamedTuple):
    """One object, or all objects of a scene combined, ready for the solver."""

    scene: Scene
    """The parts of this scene select Gaussians by their indices after cleaning."""
    cleaning: list[str]
    notes: list[str]
    """Notes about pieces that cleaning dropped."""
    gaussians: Gaussians
    """The N Gaussians at rest [m]."""
    appearance: Appearance
    materials: Sequence[AnyMaterial]
    stiffness: NDArray | None
    """Factor on Young's modulus for each particle [P]; None: all are 1."""
    interiors: Sequence[tuple[Solid, float]] = ()
    """For each moving object, its interior and its longest side [m], both without surroundings."""
    placed: Placed | None = None
    """The single object in its position; None if there are several objects."""


def make_body(gaussians: Gaussians, scene: Scene, crop: Crop, placed: Placed | None = None) -> Body:
    """Create all objects of a scene.

    Args:
        gaussians: The Gaussians of the objects, of any size, upright and facing +x. Without
            `object_id`, all Gaussians belong to the first object. Objects without Gaussians are
            shapes or copies of the first object.
        scene: The scene.
        crop: Position of the first object in its picture.
        placed: The scene's single object in its position, if it was placed before.

    Raises:
        InputError: The Gaussians cannot be used for this scene.
    """
    if not scene.objects:
        alone = placed and placed.within(scene)
        alone = alone or _clean_and_place(replace(gaussians, object_id=None), scene, crop)
        return _with_particles(alone, scene.spacing)
    refuse_ids(gaussians, scene)
    every = []
    for index, body in enumerate(scene.every_object):
        object_crop = body.crop if isinstance(body, SceneObject) else crop
        with errors_prefixed_with(scene, index):
            source = _source(gaussians, scene, index)
            every.append(_clean_and_place(source, scene.alone(index), object_crop))
    standing = stack([item.gaussians for item in every], scene)
    bodies = []
    for index, (item, there) in enumerate(zip(every, standing, strict=True)):
        item = item._replace(gaussians=there)
        with errors_prefixed_with(scene, index):
            still = scene.every_object[index].scenery
            bodies.append(
                _without_particles(item) if still else _with_particles(item, scene.spacing)
            )
    return _join(bodies, scene)


def proportions_of(gaussians: Gaussians, scene: Scene) -> Proportions | None:
    """Return the objects' proportions; None if all objects are scenery.

    Raises:
        InputError: The Gaussians cannot be used.
    """
    interiors = []
    for index, body in enumerate(scene.every_object):
        if body.scenery:
            continue
        with errors_prefixed_with(scene, index):
            placed = _clean_and_place(_source(gaussians, scene, index), scene.alone(index), WHOLE)
            interior = find_interior(placed.gaussians.select(placed.belonging), body.inside)
        interiors.append((interior, body.size))
    return measure_proportions(*interiors) if interiors else None


@contextmanager
def errors_prefixed_with(scene: Scene, index: int) -> Iterator[None]:
    """Within this context, errors begin with the object's name, except for the first object.

    Raises:
        InputError: The original error, with the object's name added.
    """
    try:
        yield
    except InputError as error:
        if index == 0:
            raise
        field = f"objects.{index - 1} ({scene.objects[index - 1].name}), {error.field}"
        raise InputError(field, error.value, error.limit, error.remedy) from error


def notes(scene: Scene) -> list[str]:
    """Return a note for each further object that has too few cells."""
    return [
        f"{body.name} is {body.size / scene.dx:.0f} cells long, which is coarse: the grid spacing "
        f"follows from the size of {scene.object.name}; a larger accuracy.cells means "
        f"more cells."
        for body in scene.objects
        if body.size < FEWEST * scene.dx
    ]


def refuse_ids(gaussians: Gaussians, scene: Scene) -> None:
    """Check that all Gaussians belong to objects of the scene.

    Raises:
        InputError: Some Gaussians belong to an object that the scene does not have.
    """
    last = 0 if gaussians.object_id is None else int(gaussians.object_id.max(initial=0))
    count = len(scene.names)
    if last >= count:
        limit = f"the Gaussians belong to {last + 1} objects, but the scene has {count}."
        raise InputError("objects", count, limit, "Add [[objects]] to the scene.")


def free_indices(scene: Scene) -> tuple[int, ...]:
    """Return the indices of the freely moving rigid objects."""
    return tuple(index for index, body in enumerate(scene.objects, 1) if body.free)


def make_free(scene: Scene, gaussians: Gaussians) -> Iterator[FreeBody]:
    """Yield the freely moving rigid solids of a scene."""
    for index in free_indices(scene):
        body, inside = scene.objects[index - 1], gaussians.object_id == index
        contact = find_pair(scene.pairs, body.name, ANY)
        assert isinstance(body.motion, Free) and body.shape is not None
        w, x, y, z = quaternions(euler(body.turn)[None])[0].tolist()
        yield FreeBody(
            body.name,
            body.shape,
            vector(body.half),
            vector(gaussians.means[inside].mean(axis=0, dtype=np.float64)),
            turn=(w, x, y, z),
            density=body.motion.density,
            velocity=body.velocity,
            spin=body.spin,
            friction=contact.friction,
            sticky=contact.contact == "sticky",
        )


def make_scenery(scene: Scene, shown: Gaussians, moves: NDArray[np.bool_]) -> Scenery:
    """Return the scenery: all Gaussians that the solver does not move."""
    paths = ((index, body.path) for index, body in enumerate(scene.objects, 1))
    tracks = tuple((index, path.track()) for index, path in paths if path is not None)
    return Scenery(shown, moves, tracks, free_indices(scene))


def planes_for_free(scene: Scene) -> list[Plane]:
    """Return the flat walls that are not limited to one object."""
    if not free_indices(scene):
        return []
    planes: list[Plane] = []
    for wall in scene.boundaries:
        if isinstance(wall, Container):
            planes += wall.sides()
        elif isinstance(wall, Plane):
            planes.append(wall)
    return [plane for plane in planes if plane.object is None]


def _source(gaussians: Gaussians, scene: Scene, index: int) -> Gaussians:
    present = gaussians.of_object(index)
    body = scene.every_object[index]
    if len(present) or not isinstance(body, SceneObject):
        return present
    if body.shape is not None:
        # In drops and grains, a pattern or shading would spread like a dye.
        patterned = not body.material.grains
        count = GRAINY if body.material.shade else None
        return make_shape(body.shape, body.sides, body.colour, patterned=patterned, count=count)
    if not body.waits:
        remedy = "Make the Gaussians with `phy124.pipeline.make_gaussians`, which reads the file."
        raise InputError("gaussians", "missing", "the object's file has not been read.", remedy)
    return gaussians.of_object(0)


def _clean_and_place(gaussians: Gaussians, scene: Scene, crop: Crop) -> Placed:
    gaussians, cleaned = clean(gaussians)
    renumbered = renumber_parts(scene, cleaned.survivors)
    belonging = mask_object(renumbered, len(gaussians))
    placed = place(gaussians, renumbered, belonging)
    return Placed(renumbered, cleaned, belonging, placed, crop)


def _with_particles(placed: Placed, spacing: float) -> Body:
    scene, gaussians, belonging = placed.scene, placed.gaussians, placed.belonging
    alone, points, excess = gaussians.select(belonging), None, 0.0
    interior = placed.interior or find_interior(alone, scene.object.inside)
    canvas = Canvas.of(alone.means, placed.crop, euler(scene.object.turn))
    if all(scene.on_lattices):
        density, solid = scene.material.density, interior.resample(spacing, per_cell=2)
        parts = parts_of(scene, gaussians.means, canvas)
        points = lattice_of(solid, density=density, dx=2 * spacing, parts=parts)
        if parts is not None and parts.static.any():
            excess = find_excess(points, solid, parts)
        particles = cells_of(points)
    else:
        particles = make_particles(
            alone, interior, density=scene.material.density, spacing=spacing, binding=scene.binding
        )
    particles = number_among_all(particles, belonging)
    particles, moves = assign_materials(particles, gaussians.means, scene, canvas)
    particles, materials, stiffness = vary_materials(
        particles,
        scene,
        gaussians.means,
        survivors=placed.cleaned.survivors,
        belonging=belonging,
        canvas=canvas,
    )
    if points is not None:
        refuse_for_lattice(scene, materials)
        particles, stiffness = points_of(particles, points), repeat_for_points(stiffness)
    elif scene.binding == "lattice":
        particles = scatter(particles, interior, materials, spacing=spacing, seed=scene.seed)
    appearance = make_appearance(gaussians, particles, moves, materials, scene, spacing)
    notes = [
        *placed.cleaned.notes,
        *interior.islands(2 * spacing).notes(),
        *_note_excess(excess),
        *_note_bridged(interior, scene),
    ]
    interiors = [(interior, scene.object.size)]
    placed = placed._replace(interior=interior)
    return Body(
        scene,
        placed.cleaned.sentences,
        notes,
        gaussians,
        appearance,
        materials,
        stiffness,
        interiors,
        placed,
    )


def _note_excess(excess: float) -> list[str]:
    if abs(excess) < NOTICEABLE:
        return []
    more = "more" if excess > 0 else "less"
    return [
        f"The moving parts have {abs(excess):.0%} {more} mass than the material in their regions, "
        "because static parts end at whole cells on a lattice; a larger accuracy.cells reduces "
        "this difference."
    ]


def _note_bridged(interior: Solid, scene: Scene) -> list[str]:
    if scene.object.inside != "auto" or interior.bridged < BRIDGED:
        return []
    return [
        "The surface of the object has openings. Its inside, "
        f"{interior.bridged:.0%} of the volume, was filled. If the object is hollow, set its field "
        "`inside` to shell, as by --set object.inside=shell."
    ]


def _without_particles(placed: Placed) -> Body:
    empty = np.zeros(0, np.int32)
    particles = Particles(np.zeros((0, 3), np.float32), np.zeros(0), np.zeros(0), empty, empty)
    still = np.zeros(len(placed.gaussians), bool)
    real = {"max_stretch": np.zeros(0), "holds": np.zeros(0), "kinds": np.zeros(0, np.int64)}
    flags = {"rounds": np.zeros(0, bool), "flows": np.zeros(0, bool)}
    appearance = Appearance(placed.gaussians, particles, still, **real, **flags)
    cleaned = placed.cleaned.sentences, placed.cleaned.notes
    return Body(placed.scene, *cleaned, placed.gaussians, appearance, [], None)


def _join(bodies: list[Body], scene: Scene) -> Body:
    """Combine all objects: first all surfaces, then all grains."""
    refuse_objects([body.appearance.particles for body in bodies], scene)
    pairs = zip(scene.objects, bodies[1:], strict=True)
    objects = [item.model_copy(update={"parts": body.scene.parts}) for item, body in pairs]
    update = {"parts": bodies[0].scene.parts, "objects": tuple(objects)}
    named = list(zip(scene.names, bodies, strict=True))
    stiffness = None
    if any(body.stiffness is not None for body in bodies):
        stiffness = np.concatenate(
            [
                np.ones(len(body.appearance.particles))
                if body.stiffness is None
                else body.stiffness
                for body in bodies
            ]
        )
    return Body(
        scene.model_copy(update=update),
        [f"{name}: {sentence}" for name, body in named for sentence in body.cleaning],
        [f"{name}: {note}" for name, body in named for note in body.notes],
        as_objects({index: body.gaussians for index, body in enumerate(bodies)}),
        _join_appearances(bodies),
        [section for body in bodies for section in body.materials],
        stiffness,
        [interior for body in bodies for interior in body.interiors],
    )


def _join_appearances(bodies: list[Body]) -> Appearance:
    looks, surfaces = [body.appearance for body in bodies], [len(body.gaussians) for body in bodies]
    counts = [len(look.moves) for look in looks]
    starts = np.cumsum([0, *counts])
    first_kinds = np.cumsum([0, *(len(body.materials) for body in bodies)])
    spans = list(zip(starts, surfaces, counts, strict=False))
    order = np.concatenate(
        [start + np.arange(surface) for start, surface, _ in spans]
        + [start + np.arange(surface, count) for start, surface, count in spans]
    )
    moves = np.concatenate([look.moves for look in looks])

    def reorder(values: NDArray) -> NDArray:
        """Return a value for each moving Gaussian of all objects, in the order of the joined
        appearance.
        """
        every = np.zeros(len(moves), values.dtype)
        every[moves] = values
        return every[order][moves[order]]

    joint = {
        name: reorder(np.concatenate([getattr(look, name) for look in looks]))
        for name in PER_GAUSSIAN
    }
    offsets = np.repeat(first_kinds[:-1], [int(look.moves.sum()) for look in looks])
    joint["kinds"] = joint["kinds"] + reorder(offsets)
    number = np.empty(len(moves), np.int64)  # index of each Gaussian among the moving Gaussians
    number[order] = np.cumsum(moves[order]) - 1
    numbers = [number[starts[i] : starts[i + 1]][look.moves] for i, look in enumerate(looks)]
    return Appearance(
        gaussians=as_objects({i: look.gaussians for i, look in enumerate(looks)}).select(order),
        particles=_join_particles([look.particles for look in looks], numbers, first_kinds),
        moves=moves[order],
        **joint,
    )


def _join_particles(
    objects: list[Particles], numbers: list[NDArray[np.int64]], first_kinds: NDArray
) -> Particles:
    def join(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(particles, name) for particles in objects])

    material = [each.material + first for each, first in zip(objects, first_kinds, strict=False)]
    gaussian = [
        np.where(each.gaussian >= 0, number[each.gaussian], -1) if len(number) else each.gaussian
        for each, number in zip(objects, numbers, strict=True)
    ]
    counts = [len(particles) for particles in objects]
    surfaces = [
        each.surface + np.array([0, 0, 0, 0, 0, 0, index, 0])
        for index, each in enumerate(objects)
        if each.surface is not None
    ]
    copies = [
        np.zeros((len(each) // PER_CELL, 27), np.int8) if each.copies is None else each.copies
        for each in objects
        if each.surface is not None
    ]
    pieces = [
        np.zeros(len(each), np.int32) if each.piece is None else each.piece for each in objects
    ]
    return Particles(
        x=join("x"),
        volume=join("volume"),
        density=join("density"),
        material=np.concatenate(material).astype(np.int32),
        gaussian=np.concatenate(gaussian).astype(np.int32),
        body=np.repeat(np.arange(len(objects), dtype=np.int32), counts),
        surface=np.concatenate(surfaces) if surfaces else None,
        copies=np.concatenate(copies) if any(part.any() for part in copies) else None,
        piece=np.concatenate(pieces) if any(each.piece is not None for each in objects) else None,
    )
