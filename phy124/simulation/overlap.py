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
from phy124.monitor.wrenches import kind_of
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
"""Largest fraction of the material that may start inside a boundary, if some of this material is
deeper than `DEEPEST`.
"""


class Buried(NamedTuple):
    """A boundary that contains material at the start."""

    number: int
    """Index of the boundary among the scene's boundaries."""
    kind: str
    sides: str
    """Names of the boundary's simple walls that contain the material; empty if there is one."""
    material: str
    """Name of the material in a message. If there are several objects, it is the object's name."""
    fraction: float
    """Fraction of the material behind the boundary's surfaces."""
    depth: float
    """Depth of the deepest particle [m]."""

    @property
    def what(self) -> str:
        """Describe the overlap, as a clause of a message."""
        return (
            f"{self.fraction:.1%} of {self.material} starts inside it{self.sides}, up to "
            f"{self.depth:.2g} m deep"
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
            from phy124.lattice.clamps import distances

            x = model.rest_of(wall.object)
            if not (distances(wall, model, x)[:, 3] < 0).any():
                limit = "at the start, it contains no material that it could hold."
                remedy = "Enlarge it, or move it onto the object's initial position."
                raise InputError(f"boundaries.{index}", wall.kind, limit, remedy)


def refuse_buried(scene: Scene, model: Model) -> None:
    """Check that no object starts inside a wall.

    `scene` has a boundary for each object on a path, after all other boundaries.

    Raises:
        InputError: More than the fraction `MOST` of an object starts inside a boundary.
    """
    led = [number for number, item in enumerate(scene.objects) if item.path is not None]
    for wall in find_buried(scene, model):
        if wall.fraction > MOST:
            limit = f"{wall.what}; a wall stops the material, but does not push it out."
            remedy = "Move the wall, or move the object (place, lift)."
            after = wall.number - (len(scene.boundaries) - len(led))
            field = f"boundaries.{wall.number}" if after < 0 else f"objects.{led[after]}"
            raise InputError(field, wall.kind, limit, remedy)


def notes(scene: Scene, model: Model) -> list[str]:
    """Return a note for each boundary that contains some material at the start, and for each clamp
    that is too thin for the grid.
    """
    from phy124.lattice.clamps import THINNEST, thickness_of

    effect, least = "it may contain no grid node, and then holds nothing", 1.0
    if scene.on_lattice:
        effect, least = (
            f"it holds material as if it were {2 * THINNEST:g} cells thick",
            2 * THINNEST,
        )
    clamps = [
        (wall.kind, thickness_of(wall, model) / model.dx) for wall in scene.boundaries if wall.holds
    ]
    return [
        f"The {wall.kind}: {wall.what}, and stays there. If it should start outside, move the wall "
        "or the object (place, lift)."
        for wall in find_buried(scene, model)
    ] + [
        f"The {kind} is {thickness:.2g} cells thick: {effect}. Use more cells, or enlarge it."
        for kind, thickness in clamps
        if thickness < least
    ]


def find_buried(scene: Scene, model: Model) -> Iterator[Buried]:
    """Yield each boundary and object, if material of the object starts deeper than `DEEPEST` in the
    boundary.

    A bounded solid with sticky contact is a clamp and may overlap the material.
    """
    moves = model.moves
    for index, boundary in enumerate(scene.boundaries):
        parts = zip(boundary.part_names(), boundary.parts(), strict=True)
        walls = [(n, w) for n, w in parts if w.contact != "sticky" or isinstance(w, Plane)]
        if not walls:
            continue
        names = [boundary.object] if boundary.object is not None else [*model.names] or [None]
        for name in names:
            chosen = model.named(name)
            x = model.rest[chosen][moves[chosen]]
            depths = [wall.measure_depth(x - _start(wall, model), model) for _, wall in walls]
            deep = [(depth > DEEPEST * model.dx).any() for depth in depths]
            if any(deep):
                depth = np.max(depths, axis=0)
                sides = [side for (side, _), inside in zip(walls, deep, strict=True) if inside]
                yield Buried(
                    index,
                    kind_of(boundary),
                    f" at {', '.join(sides)}" if len(walls) > 1 else "",
                    "the material" if len(model.names) < 2 else f"{name}",
                    float((depth > 0).mean()),
                    float(depth.max()),
                )


def _start(wall: Boundary, model: Model) -> NDArray[np.float64]:
    """Return the displacement of a wall at the start [3], m."""
    track = wall.track(model)
    shift: NDArray[np.float64] = np.zeros(3) if track is None else track.values(np.zeros(1))[0]
    return shift


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
        depth = solid.reach(normal) - float((solid.place - point - _start(wall, model)) @ normal)
        if depth > DEEPEST * model.dx:
            limit = f"it starts {depth:.2g} m deep in a wall ({kind_of(wall)})."
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
    inside = other.surface[:, 7] == 0
    points, normals = other.surface[inside, :3], other.surface[inside, 3:6]
    near = np.all((particles.x > points.min(axis=0)) & (particles.x < points.max(axis=0)), axis=1)
    if not near.any():
        return 0.0
    x = particles.x[near]
    nearest = scipy.spatial.KDTree(points).query(x)[1]
    behind = ((x - points[nearest]) * normals[nearest]).sum(axis=1) < 0
    return float(particles.volume[near][behind].sum() / particles.volume.sum())
