"""Places in a live run: which material is where a hand points, and where each object is now."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.monitor.wrenches import pair_names
from phy124.scene import Scene
from phy124.schema.region import Vector
from phy124.simulation import Simulation


class Found(NamedTuple):
    """The material nearest to a place."""

    rest: Vector
    """Where it is at rest [m]."""
    object: str | None
    """Name of its object; None if there is only one."""


def found(run: Simulation, field: str, place: Vector, radius: float, name: str | None) -> Found:
    """The material nearest to a place.

    Args:
        run: The run, as it is now.
        field: What an error calls the place.
        place: [m]
        radius: Farthest that it may be away [m].
        name: Of the object it must belong to; None: of any that can move.

    Raises:
        InputError: There is none, or the object never moves.
    """
    number = _number(run.scene, field, name)
    x, body = _where(run), _body(run)
    own = np.isin(body, _movable(run.scene) if number is None else [number])
    away = np.where(own, np.linalg.norm(x - np.array(place), axis=1), np.inf)
    index = int(away.argmin())
    if away[index] > radius:
        limit = f"the object is {away[index]:.3g} m away from it, beyond {radius:g} m."
        near = [round(float(c), 4) for c in x[index]]
        raise InputError(field, [*place], limit, f"Its nearest point now is {near}.")
    px, py, pz = run.solver.model.rest[index].tolist()
    return Found((px, py, pz), run.scene.names[body[index]] if run.scene.objects else None)


def checked(scene: Scene, field: str, name: str | None) -> str | None:
    """The name of an object to be moved; None if there is only one.

    Raises:
        InputError: There is no such object, or it never moves.
    """
    _number(scene, field, name)
    return name if scene.objects else None


def centres(run: Simulation) -> dict[str, NDArray[np.float64]]:
    """The centre of mass now of each object that has particles, or is a free solid [3], m."""
    x, mass, body = _where(run), run.particles.mass.astype(np.float64), _body(run)
    numbers = [number for number in range(len(run.scene.names)) if (body == number).any()]
    free, poses = run.solver.free, run.solver.free.poses()
    return {
        run.scene.names[n]: mass[body == n] @ x[body == n] / mass[body == n].sum() for n in numbers
    } | {one.name: pose[:3] for one, pose in zip(free.all, poses, strict=True)}


def pairs(run: Simulation) -> dict[str, str]:
    """Names of the wrenches between objects, each with the name of the object that it acts on."""
    solver = run.solver
    acted_on = [solver.model.names[pair.second] for pair in solver.pairs.all]
    acted_on += [name.rpartition("_on_")[2] for name in solver.free.names]
    return dict(zip(pair_names(run.solver), acted_on, strict=True))


def _body(run: Simulation) -> NDArray[np.int32]:
    """The number of each particle's object [P]."""
    body = run.particles.body
    return np.zeros(len(run.particles), np.int32) if body is None else body


def _where(run: Simulation) -> NDArray[np.float64]:
    """All particles now [P,3], m."""
    return np.asarray(run.solver.state.x.numpy(), dtype=np.float64)


def _movable(scene: Scene) -> list[int]:
    """Numbers of the objects of particles that are not held; all if they all are."""
    numbers = [
        i
        for i, one in enumerate(scene.every_object)
        if not (one.held or getattr(one, "scenery", False))
    ]
    return numbers or list(range(len(scene.names)))


def _number(scene: Scene, field: str, name: str | None) -> int | None:
    field = field.partition(".")[0] + ".object"
    if name is None:
        return None
    if name not in scene.names:
        raise InputError(field, name, "there is no such object.", f"({', '.join(scene.names)})")
    number = scene.names.index(name)
    if getattr(scene.every_object[number], "scenery", False):
        limit = "it has no particles that a hand could take hold of."
        raise InputError(field, name, limit, "Choose one that is made of a material.")
    if number not in _movable(scene):
        raise InputError(field, name, "it is held in its place.", "Choose one that moves.")
    return number
