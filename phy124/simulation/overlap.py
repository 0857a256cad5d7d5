"""Refuses bodies that overlap at the start, because contact cannot separate overlapping bodies.
Also refuses forces and clamps whose regions contain no material.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.boundaries.planes import Plane
from phy124.errors import InputError
from phy124.lattice.clamps import distances
from phy124.mpm import FreeBody, Model
from phy124.particles import Particles
from phy124.scene import Scene

DEEPEST = 1.0
"""Largest overlap allowed at the start [cells]; surfaces are known to within one cell."""
INSIDE = 1 / 3
"""Largest fraction of an object that may start inside an object on a lattice. Even if an object
thinner than a cell is completely inside another object, the two objects share at most one layer of
cells.
"""
MOST = 0.1
"""Largest fraction of the material that may start deeper than `DEEPEST` inside a wall."""


class Buried(NamedTuple):
    """A wall that contains material at the start."""

    number: int
    """Index of the wall among the scene's boundaries."""
    kind: str
    material: str
    """Name of the material in a message. If there are several objects, it is the object's name."""
    fraction: float
    """Fraction of the material more than `DEEPEST` cells behind the wall's surface."""
    depth: float
    """Depth of the deepest particle [m]."""

    @property
    def what(self) -> str:
        """Describe the overlap, as a clause of a message."""
        return (
            f"{self.fraction:.1%} of {self.material} starts inside it, up to {self.depth:.2g} m "
            "deep"
        )


def refuse_empty(scene: Scene, model: Model) -> None:
    """Check that the regions of forces, and the clamps of lattices, contain material at the start.

    In scenes that are not simulated on lattices alone, a clamp may be empty, because the clamp also
    holds material that arrives later.

    Raises:
        InputError: A region or a clamp contains no material.
    """
    for index, force in enumerate(scene.forces):
        if force.region is not None and not force.idle:
            force.chosen(model, f"forces.{index}.region")
    for index, wall in enumerate(scene.boundaries):
        if wall.holds and scene.on_lattice and not scene.couples:
            x = model.rest_of(wall.object)
            if not (distances(wall, model, x)[:, 3] < 0).any():
                limit = "at the start, it contains no material that it could hold."
                remedy = "Enlarge it, or move it onto the object's initial position."
                raise InputError(f"boundaries.{index}", wall.kind, limit, remedy)


def refuse_buried(scene: Scene, model: Model) -> None:
    """Check that no object starts inside a wall.

    `scene` has a boundary for each object on a path, after all other boundaries.

    Raises:
        InputError: More than the fraction `MOST` of an object starts inside a wall.
    """
    led = [number for number, item in enumerate(scene.objects) if item.path is not None]
    for wall in find_buried(scene.boundaries, model):
        if wall.fraction > MOST:
            limit = f"{wall.what}; a wall stops the material, but does not push it out."
            remedy = "Move the wall, or move the object (place, lift)."
            after = wall.number - (len(scene.boundaries) - len(led))
            field = f"boundaries.{wall.number}" if after < 0 else f"objects.{led[after]}"
            raise InputError(field, wall.kind, limit, remedy)


def notes(boundaries: Sequence[Boundary], model: Model) -> list[str]:
    """Return a note for each wall that contains some material at the start."""
    return [
        f"The {wall.kind}: {wall.what}, and stays there." for wall in find_buried(boundaries, model)
    ]


def find_buried(boundaries: Sequence[Boundary], model: Model) -> Iterator[Buried]:
    """Yield each wall and object, if material of the object starts deeper than `DEEPEST` in the
    wall.

    A bounded solid with sticky contact is a clamp and may overlap the material.
    """
    moves = model.moves
    for index, boundary in enumerate(boundaries):
        for wall in boundary.parts():
            if wall.contact == "sticky" and not isinstance(wall, Plane):
                continue
            track = wall.track(model)
            shift = np.zeros(3) if track is None else track.values(np.zeros(1))[0]
            names = [wall.object] if wall.object is not None else [*model.names] or [None]
            for name in names:
                chosen = model.named(name)
                depth = wall.measure_depth(model.rest[chosen][moves[chosen]] - shift, model)
                deep = depth > DEEPEST * model.dx
                if deep.any():
                    kind = type(boundary).__name__.lower()
                    what = "the material" if len(model.names) < 2 else f"{name}"
                    fraction, deepest = float(deep.mean()), float(depth.max())
                    yield Buried(index, kind, what, fraction, deepest)


def refuse_solids(solids: Sequence[FreeBody], x: NDArray, scene: Scene) -> None:
    """Check that no material is inside a rigid solid at the start; the material would stay there.

    Raises:
        InputError: Some material is inside a solid; the message gives the depth.
    """
    for solid in solids:
        deepest = solid.measure_depth(x).max(initial=-np.inf)
        if deepest > DEEPEST * scene.dx:
            limit = f"it overlaps another object or a wall by {deepest:.2g} m at the start."
            remedy = 'Change place or lift, or let the object stand on the other one: on = "...".'
            raise InputError("objects", solid.name, limit, remedy)


def refuse_sunken(solids: Sequence[FreeBody], planes: Sequence[Plane], model: Model) -> None:
    """Check that no rigid solid starts behind a flat wall; the wall would push the solid out
    abruptly.

    Raises:
        InputError: A solid starts more than `DEEPEST` cells behind a wall.
    """
    for solid, wall in product(solids, planes):
        point, normal, _ = (np.array(vector) for vector in wall.geometry(model))
        track = wall.track(model)
        shift = np.zeros(3) if track is None else track.values(np.zeros(1))[0]
        depth = solid.reach(normal) - float((solid.place - point - shift) @ normal)
        if depth > DEEPEST * model.dx:
            limit = f"it starts {depth:.2g} m deep in a wall ({type(wall).__name__.lower()})."
            remedy = "Move the wall or the object (place, lift)."
            raise InputError("objects", solid.name, limit, remedy)


def refuse_objects(objects: Sequence[Particles], scene: Scene) -> None:
    """Check that no objects overlap at the start.

    Raises:
        InputError: Two objects overlap; the message gives their names and the overlap.
    """
    cells = [
        np.unique(np.floor(particles.x / scene.spacing).astype(np.int64), axis=0)
        for particles in objects
    ]
    for i, j in combinations(range(len(objects)), 2):
        first, second = cells[i], cells[j]
        both, count = np.unique(np.concatenate([first, second]), axis=0, return_counts=True)
        shared = both[count > 1]
        if not len(shared):
            continue
        depth = float((np.ptp(shared, axis=0) + 1).min()) * scene.spacing
        inside = max(_measure_inside(objects[a], objects[b]) for a, b in ((i, j), (j, i)))
        if depth > DEEPEST * scene.dx:
            fraction = len(shared) / min(len(first), len(second))
            limit = f" by about {depth:.2g} m ({fraction:.0%} of the smaller one)."
        elif inside > INSIDE:
            limit = f": {inside:.0%} of one of them is inside the other."
        else:
            continue
        upper, lower = scene.names[j], scene.names[i]
        limit = f"they overlap at the start{limit}"
        remedy = f'Change place or lift, or let {upper} stand on the other: on = "{lower}".'
        raise InputError("objects", f"{lower} and {upper}", limit, remedy)


def _measure_inside(particles: Particles, other: Particles) -> float:
    """Return the fraction of the material that is inside another object's surface. If the other
    object is not on a lattice, return 0.
    """
    if other.surface is None or not len(other.surface):
        return 0.0
    points, normals = other.surface[:, :3], other.surface[:, 3:6]
    near = np.all((particles.x > points.min(axis=0)) & (particles.x < points.max(axis=0)), axis=1)
    if not near.any():
        return 0.0
    x = particles.x[near]
    nearest = scipy.spatial.KDTree(points).query(x)[1]
    behind = ((x - points[nearest]) * normals[nearest]).sum(axis=1) < 0
    return float(particles.volume[near][behind].sum() / particles.volume.sum())
