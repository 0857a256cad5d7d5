"""The solver of a scene: its particles with their materials, forces and walls, at the start."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Ground
from phy124.materials import AnyMaterial
from phy124.monitor.observer import Observer
from phy124.mpm import Accumulator, Attachable, Model, Pair, Scheme, Solver, State
from phy124.mpm.free import FreeBody, Plane
from phy124.particles import Particles
from phy124.scene import Object, Scene
from phy124.scene.objects import find_pair
from phy124.simulation import props
from phy124.simulation.buried import refuse_buried

FLOOR_NODE = 0.75
"""Depth of a layer of nodes below the floor [cells]."""


def solver_of(
    particles: Particles,
    materials: Sequence[AnyMaterial],
    stiffness: NDArray | None,
    scene: Scene,
    device: str,
    threads: int | None,
    observers: Sequence[Observer] = (),
    free: Sequence[FreeBody] = (),
) -> Solver:
    """The solver at time 0.

    Args:
        particles: The particles that move, sorted by law.
        materials: What they are made of.
        stiffness: Fraction of its material's E that each particle has [P]; None: all of it.
        scene: What happens to them.
        device: Warp device, "cpu" or "cuda:0".
        threads: CPU threads; None: as many as have a free core and enough particles.
        observers: The observers of the run.
        free: Rigid solids that move freely.

    Raises:
        InputError: The object starts inside a wall.
    """
    x = particles.x.astype(np.float64)
    v, C = _motion(x, particles, scene)
    floors = [b.height for b in scene.boundaries if isinstance(b, Ground)]
    ceiling = math.inf if scene.time.substep is None else scene.time.substep
    names, still = names_of(particles, scene), {b.name for b in scene.every_object if b.held}
    model = Model.of(
        x,
        particles.volume,
        materials,
        dx=scene.dx,
        material=particles.material,
        stiffness=stiffness,
        body=numbered(particles.body),
        names=names,
        held=[index for index, name in enumerate(names) if name in still],
        origin=(0.0, 0.0, (floors[0] if floors else 0.0) - FLOOR_NODE * scene.dx),
        cfl=scene.resolution.fraction,
        precision=scene.resolution.precision,
        device=device,
        gradient=scene.resolution.gradient,
    )
    refuse_buried(scene.boundaries, model)
    return Solver(
        model,
        State.of(model, v, C),
        **acting(scene, observers)._asdict(),
        pairs=list(pairs_of(model.names, scene)),
        free=free,
        ceiling=ceiling,
        threads=threads,
        measure_every=scene.checks.measure,
        gathered=[one for one in observers if one.in_gathers],
        scheme=scheme_of(scene),
    )


def scheme_of(scene: Scene) -> Scheme:
    """How velocities come back from the grid of a scene."""
    given = scene.resolution
    return Scheme(given.passes, given.share, given.rpic_damping)


def numbered(body: NDArray | None) -> NDArray | None:
    """Bodies numbered without gaps [P]: scenery has a number in the scene and no particles."""
    return None if body is None else np.unique(body, return_inverse=True)[1].reshape(-1)


def names_of(particles: Particles, scene: Scene) -> tuple[str, ...]:
    """Names of the objects that have particles, in the order of the solver's bodies."""
    found = [0] if particles.body is None else np.unique(particles.body).tolist()
    return tuple(scene.names[index] for index in found)


def pairs_of(names: Sequence[str], scene: Scene) -> Iterator[Pair]:
    """How the bodies of these names touch."""
    for first, second in combinations(range(len(names)), 2):
        how = find_pair(scene.pairs, names[first], names[second])
        yield Pair(first, second, how.friction, how.contact == "sticky")


class Acting(NamedTuple):
    """What acts on a state, as the solver takes it."""

    forces: Sequence[Attachable]
    boundaries: Sequence[Attachable]
    accumulators: Sequence[Accumulator]
    planes: Sequence[Plane]


def acting(scene: Scene, observers: Sequence[Observer]) -> Acting:
    """Return the forces and boundaries of a scene, wrapped by the observers that measure them."""
    forces: Sequence[Attachable] = scene.acting
    walls: Sequence[Attachable] = scene.boundaries
    for observer in observers:
        forces = observer.wrap_forces(forces)
        walls = observer.wrap_walls(scene.boundaries, walls)
    sums = [observer for observer in observers if observer.in_substeps]
    return Acting(forces, walls, sums, props.planes(scene))


def _motion(x: NDArray, particles: Particles, scene: Scene) -> tuple[NDArray, NDArray]:
    """Velocities [P,3], m/s, and their gradients [P,3,3], 1/s, of the rigid motion at the start."""
    if particles.body is None:
        return _rigid(x, particles.mass, scene.object)
    v, C = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
    for index, one in enumerate(scene.every_object):
        own = particles.body == index
        if own.any():
            v[own], C[own] = _rigid(x[own], particles.mass[own], one)
    return v, C


def _rigid(x: NDArray, mass: NDArray, body: Object) -> tuple[NDArray, NDArray]:
    """The same of one object."""
    wx, wy, wz = body.spin
    gradient = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    middle = (mass[:, None] * x).sum(axis=0) / mass.sum()
    v = np.array(body.velocity) + (x - middle) @ gradient.T
    return v, np.broadcast_to(gradient, (len(x), 3, 3))


def judged_as(scene: Scene, materials: Sequence[AnyMaterial]) -> Scene:
    """The scene whose cost is forecast: of properties from a file, the material that costs most."""
    if scene.properties is None:
        return scene
    fastest = max(materials, key=lambda section: section.wave_speed())
    return scene.model_copy(update={"material": fastest, "parts": ()})
