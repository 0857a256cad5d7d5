"""Bodies: the particles and looks of each object of a scene, joined for one solver.

Each object is made by itself, as if it were alone, on the grid of the whole scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians, as_objects
from phy124.generators.shapes import make_shape
from phy124.imaging.painted import WHOLE, Crop
from phy124.materials import AnyMaterial
from phy124.particles import Cleaning, Particles, clean, make_particles
from phy124.particles.thickness import relative_thickness
from phy124.scene import Scene, SceneObject
from phy124.simulation.appearance import Appearance, appearance
from phy124.simulation.materials import varied
from phy124.simulation.parts import with_materials
from phy124.simulation.placing import among_all, belongs, place, renumbered, stacked

DEEPEST = 1.0
"""Largest overlap of two objects at the start [cells]: as deep as surfaces are known."""
FEWEST = 8
"""An object of fewer cells across gets a note."""


class Body(NamedTuple):
    """One object, or all objects of a scene as one, ready for the solver."""

    numbered: Scene
    """The scene, in which parts name the Gaussians that are left."""
    cleaning: list[str]
    """What was done to the Gaussians, in sentences."""
    gaussians: Gaussians
    """At rest, in their place, N, m."""
    look: Appearance
    """How it is shown; it has the particles, too."""
    materials: Sequence[AnyMaterial]
    stiffness: NDArray | None
    """Fraction of its material's E that each particle has [P]; None: all of it."""


class _Placed(NamedTuple):
    """One object in its place."""

    scene: Scene
    """The scene with this object alone."""
    cleaned: Cleaning
    own: NDArray[np.bool_]
    """Which of its Gaussians are the object and not its surroundings [N]."""
    gaussians: Gaussians
    crop: Crop


def bodies(gaussians: Gaussians, scene: Scene, crop: Crop) -> Body:
    """All objects of a scene.

    Args:
        gaussians: The objects at any size, standing upright, facing +x; without `object_id` they
            are the first one. What is missing is a shape, or a copy of the first.
        scene: What is made of them.
        crop: Where the first object is in the picture that the masks of its parts were painted on.

    Raises:
        InputError: The Gaussians cannot be used for this scene.
    """
    if not scene.objects:
        return _made(_placed(replace(gaussians, object_id=None), scene, crop), scene.spacing)
    refuse_ids(gaussians, scene)
    placed = []
    for index, one in enumerate(scene.every_object):
        own_crop = one.crop if isinstance(one, SceneObject) else crop
        with named(scene, index):
            placed.append(_placed(_source(gaussians, scene, index), scene.alone(index), own_crop))
    standing = stacked([one.gaussians for one in placed], scene)
    made = []
    for index, (one, there) in enumerate(zip(placed, standing, strict=True)):
        one = one._replace(gaussians=there)
        with named(scene, index):
            still = getattr(scene.every_object[index], "scenery", False)
            made.append(_scenery(one) if still else _made(one, scene.spacing))
    return _joined(made, scene)


def thickness_of(gaussians: Gaussians, scene: Scene) -> float | None:
    """Return the local thickness of a scene's object relative to its size.

    It is None in scenes of several objects.

    Args:
        gaussians: The object at any size, standing upright.
        scene: What happens to it.

    Raises:
        InputError: The Gaussians cannot be used.
    """
    if scene.objects:
        return None
    placed = _placed(gaussians.of_object(0), scene, WHOLE)
    return relative_thickness(placed.gaussians.select(placed.own), scene.object.size)


@contextmanager
def named(scene: Scene, index: int) -> Iterator[None]:
    """Within this context, a refusal is about one of the further objects of a scene.

    Raises:
        InputError: The same, with the object's name.
    """
    try:
        yield
    except InputError as error:
        if index == 0:
            raise
        one = scene.objects[index - 1]
        field = f"objects.{index - 1} ({one.name}), {error.field}"
        raise InputError(field, error.value, error.limit, error.remedy) from error


def notes(scene: Scene) -> list[str]:
    """A sentence for each further object that the grid hardly resolves."""
    return [
        f"{one.name} is {one.size / scene.dx:.0f} cells long, which is coarse: the grid follows "
        f"the size of {scene.object.name}; a larger accuracy.cells resolves it."
        for one in scene.objects
        if one.size < FEWEST * scene.dx
    ]


def refuse_ids(gaussians: Gaussians, scene: Scene) -> None:
    """Make sure that the Gaussians are of no object that the scene does not have.

    Raises:
        InputError: Some are.
    """
    last = 0 if gaussians.object_id is None else int(gaussians.object_id.max(initial=0))
    if last >= len(scene.names):
        count = len(scene.names)
        limit = f"the Gaussians are of {last + 1} objects, the scene has {count}."
        raise InputError("objects", count, limit, "Add [[objects]] to the scene.")


def _source(gaussians: Gaussians, scene: Scene, index: int) -> Gaussians:
    """What an object is made from."""
    own = gaussians.of_object(index)
    one = scene.every_object[index]
    if len(own) or not isinstance(one, SceneObject):
        return own
    if one.shape is not None:
        return make_shape(one.shape, one.sides, one.colour)
    if not one.waits:
        remedy = "Make the Gaussians by `phy124.pipeline.static`, which reads what a scene names."
        raise InputError("gaussians", "missing", "nobody has read its file yet.", remedy)
    return gaussians.of_object(0)


def _placed(gaussians: Gaussians, scene: Scene, crop: Crop) -> _Placed:
    """Clean Gaussians in their place, without regard to other objects."""
    gaussians, cleaned = clean(gaussians)
    numbered = renumbered(scene, cleaned.survivors)
    own = belongs(numbered, len(gaussians))
    return _Placed(numbered, cleaned, own, place(gaussians, numbered, own), crop)


def _made(one: _Placed, spacing: float) -> Body:
    """The particles of one object and how it is shown."""
    scene, gaussians, own = one.scene, one.gaussians, one.own
    made = make_particles(
        gaussians.select(own),
        density=scene.material.density,
        spacing=spacing,
        binding=scene.binding,
    )
    made = among_all(made, own)
    particles, moves = with_materials(made, gaussians.means, scene, one.crop)
    particles, materials, stiffness = varied(
        particles, scene, gaussians.means,
        survivors=one.cleaned.survivors, own=own, crop=one.crop,
    )  # fmt: skip
    look = appearance(gaussians, particles, moves, materials, scene, spacing)
    return Body(scene, one.cleaned.sentences, gaussians, look, materials, stiffness)


def _scenery(one: _Placed) -> Body:
    """An object that is only seen."""
    nobody = np.zeros(0, np.int32)
    none = Particles(np.zeros((0, 3), np.float32), np.zeros(0), np.zeros(0), nobody, nobody)
    moves = np.zeros(len(one.gaussians), bool)
    each = {"max_stretch": np.zeros(0), "holds": np.zeros(0), "kinds": np.zeros(0, np.int64)}
    which = {"rounds": np.zeros(0, bool), "flows": np.zeros(0, bool)}
    look = Appearance(one.gaussians, none, moves, **each, **which)
    return Body(one.scene, one.cleaned.sentences, one.gaussians, look, [], None)


def _joined(made: list[Body], scene: Scene) -> Body:
    """All objects as one, the grains of all after the surfaces of all."""
    names = scene.names
    _refuse_overlap([one.look.particles for one in made], scene)
    cleaning = [
        f"{name}: {said}" for name, one in zip(names, made, strict=True) for said in one.cleaning
    ]
    numbered = scene.model_copy(
        update={
            "parts": made[0].numbered.parts,
            "objects": tuple(
                other.model_copy(update={"parts": one.numbered.parts})
                for other, one in zip(scene.objects, made[1:], strict=True)
            ),
        }
    )
    return Body(
        numbered,
        cleaning,
        as_objects({index: one.gaussians for index, one in enumerate(made)}),
        _shown(made),
        [section for one in made for section in one.materials],
        _fractions(made),
    )


def _fractions(made: list[Body]) -> NDArray | None:
    """The stiffness of all particles; None if it is nowhere reduced."""
    if all(one.stiffness is None for one in made):
        return None
    return np.concatenate(
        [
            np.ones(len(one.look.particles)) if one.stiffness is None else one.stiffness
            for one in made
        ]
    )


def _shown(made: list[Body]) -> Appearance:
    """How all objects are shown."""
    looks, surfaces = [one.look for one in made], [len(one.gaussians) for one in made]
    starts = np.cumsum([0, *(len(look.moves) for look in looks)])
    kinds = np.cumsum([0, *(len(one.materials) for one in made)])
    order = np.concatenate(
        [start + np.arange(count) for start, count in zip(starts, surfaces, strict=False)]
        + [
            start + np.arange(count, len(look.moves))
            for start, count, look in zip(starts, surfaces, looks, strict=False)
        ]
    )
    moves = np.concatenate([look.moves for look in looks])

    def every(values: Callable[[Appearance], NDArray]) -> NDArray:
        """Values of those that move, in the joint order."""
        whole = np.zeros(len(moves), values(looks[0]).dtype)
        whole[moves] = np.concatenate([values(look) for look in looks])
        return whole[order][moves[order]]

    number = np.empty(len(moves), np.int64)  # of each Gaussian among those that move
    number[order] = np.cumsum(moves[order]) - 1
    own = [number[starts[i] : starts[i + 1]][look.moves] for i, look in enumerate(looks)]
    of_law = np.repeat(kinds[:-1], [int(look.moves.sum()) for look in looks])
    together = as_objects({i: look.gaussians for i, look in enumerate(looks)})
    found = {name: every(lambda look, name=name: getattr(look, name)) for name in _PER_GAUSSIAN}
    whole = np.zeros(len(moves), np.int64)
    whole[moves] = of_law
    return Appearance(
        gaussians=together.select(order),
        particles=_all_particles([look.particles for look in looks], own, kinds),
        moves=moves[order],
        **{**found, "kinds": found["kinds"] + whole[order][moves[order]]},
    )


_PER_GAUSSIAN = ("max_stretch", "rounds", "flows", "holds", "kinds")
"""What an appearance says of each Gaussian that moves."""


def _all_particles(
    some: list[Particles], own: list[NDArray[np.int64]], kinds: NDArray
) -> Particles:
    """The particles of all objects, object by object.

    Args:
        some: Those of each.
        own: For each object the numbers of its moving Gaussians among all that move.
        kinds: The number of each object's first material among all.
    """

    def stack(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(one, name) for one in some])

    material = [one.material + first for one, first in zip(some, kinds, strict=False)]
    gaussian = [
        np.where(one.gaussian >= 0, numbers[one.gaussian], -1) if len(numbers) else one.gaussian
        for one, numbers in zip(some, own, strict=True)
    ]
    return Particles(
        x=stack("x"),
        volume=stack("volume"),
        density=stack("density"),
        material=np.concatenate(material).astype(np.int32),
        gaussian=np.concatenate(gaussian).astype(np.int32),
        body=np.repeat(np.arange(len(some), dtype=np.int32), [len(one) for one in some]),
    )


def _refuse_overlap(some: list[Particles], scene: Scene) -> None:
    """Make sure that no two objects are in the same place.

    Raises:
        InputError: Two are; it says which, and by how much.
    """
    cells = [np.unique(np.floor(one.x / scene.spacing).astype(np.int64), axis=0) for one in some]
    for (i, first), (j, second) in combinations(enumerate(cells), 2):
        shared = _shared(first, second)
        depth = 0.0 if not len(shared) else float((np.ptp(shared, axis=0) + 1).min())
        if depth * scene.spacing > DEEPEST * scene.dx:
            fraction = len(shared) / min(len(first), len(second))
            raise InputError(
                "objects", f"{scene.names[i]} and {scene.names[j]}",
                f"they overlap at the start by about {depth * scene.spacing:.2g} m "
                f"({fraction:.0%} of the smaller one).",
                f"Change place or lift, or let {scene.names[j]} stand on the other: "
                f'on = "{scene.names[i]}".',
            )  # fmt: skip


def _shared(first: NDArray, second: NDArray) -> NDArray:
    """The cells [K,3] that are in both lists [.,3], each without repetition."""
    both, count = np.unique(np.concatenate([first, second]), axis=0, return_counts=True)
    return both[count > 1]
