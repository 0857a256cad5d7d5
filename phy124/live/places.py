"""Find the material at a position in a live run, and the position of each object."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.monitor.wrenches import pair_names
from phy124.scene import Scene
from phy124.schema.region import Vector
from phy124.simulation import Simulation


class NearestMaterial(NamedTuple):
    """The particle nearest to a position."""

    rest: Vector
    """Position at rest [m]."""
    object: str | None
    """Name of its object; None if there is only one."""


def find_material(
    run: Simulation, field: str, place: Vector, radius: float, name: str | None
) -> NearestMaterial:
    """Find the particle nearest to a position.

    Args:
        run: The run.
        field: Name of the position in error messages.
        place: Position [m].
        radius: Largest distance of the particle [m].
        name: Name of the object to which it belongs; None: any object that can move.

    Raises:
        InputError: No particle is within `radius`, or the object never moves.
    """
    number = _object_number(run.scene, field, name)
    x, body = _positions(run), _objects(run)
    allowed = np.isin(body, _list_movable(run.scene) if number is None else [number])
    away = np.where(allowed, np.linalg.norm(x - np.array(place), axis=1), np.inf)
    index = int(away.argmin())
    if away[index] > radius:
        limit = (
            f"the object is {away[index]:.3g} m away from this point, "
            f"beyond the radius of {radius:g} m."
        )
        near = [round(float(c), 4) for c in x[index]]
        raise InputError(field, [*place], limit, f"Its nearest point now is {near}.")
    px, py, pz = run.solver.model.rest[index].tolist()
    return NearestMaterial(
        (px, py, pz), run.scene.names[body[index]] if run.scene.objects else None
    )


def check_object(scene: Scene, field: str, name: str | None) -> str | None:
    """Check the name of an object to be moved; return None if there is only one object.

    Raises:
        InputError: There is no such object, or it never moves.
    """
    _object_number(scene, field, name)
    return name if scene.objects else None


def compute_centres(run: Simulation) -> dict[str, NDArray[np.float64]]:
    """Return the centre of mass [3], m, of each object with particles and each free rigid solid."""
    x, mass, body = (
        _positions(run),
        run.setup.particles.mass.astype(np.float64),
        _objects(run),
    )
    numbers = [number for number in range(len(run.scene.names)) if (body == number).any()]
    free, poses = run.solver.free, run.solver.free.poses()
    return {
        run.scene.names[n]: mass[body == n] @ x[body == n] / mass[body == n].sum() for n in numbers
    } | {solid.name: pose[:3] for solid, pose in zip(free.all, poses, strict=True)}


def list_pairs(run: Simulation) -> dict[str, str]:
    """Map each wrench between objects to the name of the object that it acts on."""
    solver = run.solver
    acted_on = [solver.model.names[pair.second] for pair in solver.pairs.all]
    acted_on += [name.rpartition("_on_")[2] for name in solver.free.names]
    return dict(zip(pair_names(run.solver), acted_on, strict=True))


def _objects(run: Simulation) -> NDArray[np.int32]:
    """Return the index of each particle's object [P]."""
    body = run.setup.particles.body
    return np.zeros(len(run.setup.particles), np.int32) if body is None else body


def _positions(run: Simulation) -> NDArray[np.float64]:
    """Return the positions of all particles [P,3], m."""
    return np.asarray(run.solver.state.x.numpy(), dtype=np.float64)


def _list_movable(scene: Scene) -> list[int]:
    """Return the indices of the objects that are not held in place; all if all are held."""
    numbers = [
        i
        for i, item in enumerate(scene.every_object)
        if not (item.held or getattr(item, "scenery", False))
    ]
    return numbers or list(range(len(scene.names)))


def _object_number(scene: Scene, field: str, name: str | None) -> int | None:
    field = field.partition(".")[0] + ".object"
    if name is None:
        return None
    if name not in scene.names:
        raise InputError(field, name, "there is no such object.", f"({', '.join(scene.names)})")
    number = scene.names.index(name)
    if getattr(scene.every_object[number], "scenery", False):
        limit = "it has no particles to hold."
        raise InputError(field, name, limit, "Choose an object that is made of a material.")
    if number not in _list_movable(scene):
        raise InputError(field, name, "it is held in place.", "Choose an object that moves.")
    return number
