"""Finds the material at a position in a live run, and the position of each object."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phy124.errors import InputError
from phy124.gaussians import quaternions
from phy124.io.axes import euler
from phy124.monitor.watchdog import Watchdog
from phy124.monitor.wrenches import pair_names
from phy124.motion.scenery import INSTANT
from phy124.scene import Scene
from phy124.schema.region import Vector
from phy124.simulation import Setup, Simulation

if TYPE_CHECKING:
    from phy124.lattice.solver import LatticeSolver
    from phy124.liquid.solver import LiquidSolver
    from phy124.mpm.solver import Solver


class NearestMaterial(NamedTuple):
    """The particle nearest to a position."""

    rest: Vector
    """Position at rest [m]."""
    object: str | None
    """Name of the particle's object; None if there is only one object."""
    modulus: float
    """Modulus of pressure waves at the start of the run [Pa]."""


def find_material(
    run: Simulation, field: str, place: Vector, radius: float, name: str | None
) -> NearestMaterial:
    """Find the particle nearest to a position.

    Args:
        run: The live run.
        field: Name of the position in error messages.
        place: The position [m].
        radius: Largest distance between the position and the particle [m].
        name: Name of the particle's object; None: any object that can move.

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
        raise InputError(field, [*place], limit, f"The object's nearest point is now {near}.")
    px, py, pz = run.solver.model.rest[index].tolist()
    of = run.scene.names[body[index]] if run.scene.objects else None
    return NearestMaterial((px, py, pz), of, _modulus(run.setup, index))


def _modulus(setup: Setup, index: int) -> float:
    """Return the modulus of pressure waves in a particle [Pa]."""
    section = setup.materials[setup.particles.material[index]]
    factor = 1.0 if setup.stiffness is None else float(setup.stiffness[index])
    return factor * section.density * section.sound_speed() ** 2


def list_points(run: Simulation) -> dict[str, NDArray[np.float64]]:
    """Return the positions of each object's particles [P,3], m, or the centre of a rigid object."""
    x, body = _positions(run), _objects(run)
    points = {run.scene.names[number]: x[body == number] for number in np.unique(body)}
    return {name: motion.place[None] for name, motion in _list_rigid(run).items()} | points


class Motion(NamedTuple):
    """The motion of an object, approximated as rigid."""

    place: NDArray[np.float64]
    """Centre of mass [3], m."""
    quat: NDArray[np.float64]
    """Unit quaternion wxyz of the best-fitting rotation from rest [4]."""
    velocity: NDArray[np.float64]
    """Velocity of the centre of mass [3], m/s."""
    spin: NDArray[np.float64]
    """Angular velocity about the centre of mass [3], rad/s."""


def list_motions(run: Simulation) -> dict[str, Motion]:
    """Return the motion of each object by name."""
    v = np.asarray(run.solver.state.v.numpy(), dtype=np.float64)
    x, rest, mass = _positions(run), run.solver.model.rest, run.setup.particles.mass
    motions, body = {}, _objects(run)
    for number in np.unique(body):
        mask = body == number
        m = mass[mask, None].astype(np.float64)
        place, velocity = ((m * values[mask]).sum(0) / m.sum() for values in (x, v))
        arm, start = x[mask] - place, rest[mask] - (m * rest[mask]).sum(0) / m.sum()
        rotation = Rotation.align_vectors(arm, start, m[:, 0])[0]
        inertia = (m * arm).T @ -arm
        inertia -= np.eye(3) * np.trace(inertia)
        spin = np.linalg.lstsq(inertia, (m * np.cross(arm, v[mask])).sum(0), rcond=None)[0]
        quat = rotation.as_quat()[[3, 0, 1, 2]]
        motions[run.scene.names[number]] = Motion(place, quat, velocity, spin)
    return motions | _list_rigid(run)


def _list_rigid(run: Simulation) -> dict[str, Motion]:
    """Return the motion of each object that has no particles: a static object, an object on a path,
    or a free solid.
    """
    scenery, free, motions = run.setup.scenery, run.solver.free, {}
    tracks, time = dict(scenery.tracks), run.solver.clock.time
    for number, item in enumerate(run.scene.every_object):
        if item.scenery:
            of_item = scenery.gaussians.object_id == number
            place = scenery.gaussians.means[of_item].mean(axis=0, dtype=np.float64)
            velocity, quat = np.zeros(3), quaternions(euler(item.turn)[None])[0]
            if number in tracks:
                moved, later = tracks[number].values(np.array([time, time + INSTANT]))
                place, velocity = place + moved, (later - moved) / INSTANT
            motions[item.name] = Motion(place, quat, velocity, np.zeros(3))
    for solid, pose, motion in zip(free.all, free.poses(), free.motions(), strict=True):
        motions[solid.name] = Motion(pose[:3], pose[3:], motion[:3], motion[3:])
    return motions


def set_motion(run: Simulation, name: str, motion: Motion, *, twist: bool) -> None:
    """Move and rotate an object as a rigid body, and keep its deformation.

    Args:
        run: The run.
        name: Name of the object.
        motion: New position and orientation, and new velocities.
        twist: Whether to set the velocities; if not, the current velocities are rotated with the
            object.

    Raises:
        InputError: There is no such object, it never moves, it has no particles, or the scene
            couples lattices with particles.
    """
    solver, solids = run.solver, [solid.name for solid in run.solver.free.all]
    number = None if name in solids else _object_number(run.scene, "state.entity", name)
    before = list_motions(run)[name]
    new, old = (Rotation.from_quat(each.quat[[1, 2, 3, 0]]) for each in (motion, before))
    R = (new * old.inv()).as_matrix()

    def carry(x: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        """Return positions [m] and velocities [m/s] after the rigid motion."""
        arm = (x - before.place) @ R.T
        rotated = motion.velocity + np.cross(motion.spin, arm) if twist else v @ R.T
        return motion.place + arm, rotated

    if number is None:
        velocity, spin = motion[2:] if twist else (R @ before.velocity, R @ before.spin)
        solver.free.put(solids.index(name), (motion.place, motion.quat, velocity, spin))
        solver.clock.expire()
    elif run.scene.couples and not (run.scene.immerses and run.scene.on_lattices[number]):
        limit = "an object on a lattice cannot be moved immediately if other objects are particles."
        raise InputError("state.entity", name, limit, 'Use accuracy.solver = "mpm".')
    elif run.scene.on_lattice:
        body = int(np.flatnonzero(np.unique(_objects(run)) == number)[0])
        cast("LatticeSolver", solver).carry_nodes(carry, body)
    else:
        of_object, moving = _objects(run) == number, motion if twist else None
        _carry_particles(cast("Solver | LiquidSolver", solver), of_object, carry, R, moving)
    watchdog = run.find(Watchdog)
    if watchdog is not None:
        watchdog.restart()


def _carry_particles(
    solver: Solver | LiquidSolver,
    mask: NDArray[np.bool_],
    carry: Any,
    R: NDArray[np.float64],
    set_to: Motion | None,
) -> None:
    """Move the particles `mask` [P] as a rigid body with the rotation `R` [3,3].

    If `set_to` is not None, the particles also get this motion's velocities.
    """
    state = solver.state
    arrays = {key: np.array(array.numpy()) for key, array in state.arrays().items()}
    arrays["x"][mask], arrays["v"][mask] = carry(arrays["x"][mask], arrays["v"][mask])
    arrays["residue"][mask] = 0
    for key in filter(lambda key: len(arrays[key]), ("F", "total")):
        arrays[key][mask] = R @ arrays[key][mask]
    turned = R @ arrays["C"][mask] @ R.T if set_to is None else np.cross(np.eye(3), set_to.spin)
    arrays["C"][mask] = turned
    for key, array in state.arrays().items():
        array.assign(arrays[key])
    solver.renew()


def check_object(scene: Scene, field: str, name: str | None) -> str | None:
    """Check the name of the object to move; return the name, or None if there is only one object.

    Raises:
        InputError: There is no such object, or it never moves.
    """
    _object_number(scene, field, name)
    return name if scene.objects else None


def compute_centres(run: Simulation) -> dict[str, NDArray[np.float64]]:
    """Return the centre of mass [3], m, of each object with particles and each free rigid solid."""
    x, mass, body = _positions(run), run.setup.particles.mass.astype(float), _objects(run)
    numbers = [number for number in range(len(run.scene.names)) if (body == number).any()]
    free, poses = run.solver.free, run.solver.free.poses()
    return {
        run.scene.names[n]: mass[body == n] @ x[body == n] / mass[body == n].sum() for n in numbers
    } | {solid.name: pose[:3] for solid, pose in zip(free.all, poses, strict=True)}


def list_pairs(run: Simulation) -> dict[str, str]:
    """Return the object on which each contact force acts, by the name of the force."""
    solver = run.solver
    acted_on = [solver.model.names[pair.second] for pair in solver.pairs.all]
    acted_on += [solid for _, solid in solver.free.pairs]
    return dict(zip(pair_names(run.solver), acted_on, strict=True))


def _objects(run: Simulation) -> NDArray[np.int32]:
    """Return the index of each particle's object [P]."""
    body = run.setup.particles.body
    return np.zeros(len(run.setup.particles), np.int32) if body is None else body


def _positions(run: Simulation) -> NDArray[np.float64]:
    return np.asarray(run.solver.state.x.numpy(), dtype=np.float64)


def _list_movable(scene: Scene) -> list[int]:
    """Return the indices of the objects that are not fixed. If all objects are fixed, return the
    indices of all objects.
    """
    numbers = [i for i, item in enumerate(scene.every_object) if not (item.held or item.scenery)]
    return numbers or list(range(len(scene.names)))


def _object_number(scene: Scene, field: str, name: str | None) -> int | None:
    field = field.partition(".")[0] + ".object"
    if name is None:
        return None
    if name not in scene.names:
        names = ", ".join(scene.names[number] for number in _list_movable(scene))
        raise InputError(field, name, "there is no such object.", f"Choose one of: {names}.")
    number = scene.names.index(name)
    if scene.every_object[number].scenery:
        limit = "it has no particles to hold."
        raise InputError(field, name, limit, "Choose an object that is made of a material.")
    if number not in _list_movable(scene):
        raise InputError(field, name, "it is held in place.", "Choose an object that moves.")
    return number
