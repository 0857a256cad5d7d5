"""Creates the solver for a setup at time 0, and lists the kernels of a scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Ground
from phy124.kernels.lattice.points import make_press
from phy124.lattice.refusals import is_elastic
from phy124.monitor import observers_for
from phy124.monitor.observer import Observer, Subject
from phy124.monitor.wrenches import wall_names
from phy124.motion import deform
from phy124.mpm import (
    Attachable,
    FreeBody,
    Model,
    Pair,
    Scheme,
    Solver,
    State,
    fluctuation,
    free,
    pairs,
    repair,
    substep,
    tracks,
)
from phy124.mpm.model import PRECISIONS, form_of
from phy124.particles import Particles
from phy124.scene import Object, Scene
from phy124.scene.lattices import choose_solver
from phy124.scene.objects import find_pair
from phy124.simulation.bodies import planes_for_free
from phy124.simulation.overlap import refuse_buried, refuse_empty, refuse_sunken
from phy124.simulation.setup import Setup

if TYPE_CHECKING:
    from phy124.liquid import AnySolver

FLOOR_NODE = 0.75
"""Distance between the floor and the first layer of nodes below the floor [cells]."""


def make_solver(setup: Setup, observers: Sequence[Observer]) -> AnySolver:
    """Return the solver at time 0.

    Raises:
        InputError: An object starts inside a wall, a force acts on no particle, or a wall is too
            thin for the grid.
    """
    scene, particles = setup.solid_scene, setup.particles
    x = particles.x.astype(np.float64)
    v, C = _initial_motion(x, particles, scene)
    fluid = np.array([section.law == "fluid" for section in setup.materials])
    floors = [wall.height for wall in scene.boundaries if isinstance(wall, Ground)]
    bodies, number = [0], None
    if particles.body is not None:
        # Scenery has an index but no particles, so the indices of the bodies have gaps.
        unique, number = np.unique(particles.body, return_inverse=True)
        bodies, number = unique.tolist(), number.reshape(-1)
    held = {index for index, body in enumerate(scene.every_object) if body.held}
    wet: list[int] = []
    if scene.mixes:
        flows = fluid[particles.material]
        wet = [place for place in range(len(bodies)) if flows[number == place].all()]
    elif scene.couples and not scene.projects:
        wet = [place for place, index in enumerate(bodies) if scene.on_lattices[index]]
    names, surface = [scene.names[index] for index in bodies], particles.surface
    if surface is not None:
        surface = surface.copy()
        surface[:, 6] = np.searchsorted(bodies, surface[:, 6])
    still = [place for place, index in enumerate(bodies) if index in held]
    model = Model.of(
        x,
        particles.volume,
        setup.materials,
        dx=scene.dx,
        material=particles.material,
        stiffness=setup.stiffness,
        body=number,
        wet=wet,
        names=names,
        tops=find_tops(names, surface, setup.free),
        free_mass=sum(solid.mass for solid in setup.free),
        held=still,
        origin=(0.0, 0.0, (floors[0] if floors else 0.0) - FLOOR_NODE * scene.dx),
        cfl=scene.resolution.fraction,
        precision=scene.precision,
        device=setup.context.device,
        gradient=scene.resolution.gradient,
    )
    refuse_empty(scene, model)
    refuse_buried(scene, model)
    refuse_sunken(setup.free, planes_for_free(scene), model)
    state = State.of(model, v, C)
    options: dict[str, Any] = {
        **wrap(scene, observers),
        "ceiling": scene.time.ceiling,
        "threads": setup.threads,
    }
    if scene.projects and not scene.mixes:
        from phy124.liquid.solver import LiquidSolver

        return LiquidSolver(model, state, **options, free=setup.free)
    options["pairs"] = list(_pairs(model.names, scene))
    steps = {"measure_every": scene.checks.measure, "scheme": scheme_of(scene)}
    if scene.on_lattice:
        assert surface is not None
        options["copies"] = particles.copies
        if scene.immerses:
            from phy124.liquid.immersed import ImmersedSolver

            return ImmersedSolver(model, surface, state, **options, still=still)
        if scene.couples:
            from phy124.lattice.coupled import CoupledSolver

            return CoupledSolver(model, surface, state, **options, **steps, still=still)
        from phy124.lattice.solver import LatticeSolver

        return LatticeSolver(model, surface, state, **options, free=setup.free)
    gathered = [observer for observer in observers if observer.in_gathers]
    options |= {**steps, "free": setup.free, "gathered": gathered}
    if scene.mixes:
        from phy124.liquid.mixed import MixedSolver

        return MixedSolver(model, state, **options)
    return Solver(model, state, **options)


def find_tops(
    names: Sequence[str], surface: NDArray | None, free: Sequence[FreeBody]
) -> dict[str, float]:
    """For each free solid and each body on a lattice, return the height of its top [m].

    `surface` [S,8] is described in `Particles.surface`.
    """
    up = np.array([0.0, 0.0, 1.0])
    tops = {solid.name: solid.place[2] + solid.reach(up) for solid in free}
    points = np.zeros((0, 8)) if surface is None else surface
    for number, name in enumerate(names):
        heights = points[points[:, 6] == number, 2]
        if len(heights):
            tops[name] = float(heights.max())
    return tops


def wrap(scene: Scene, observers: Sequence[Observer]) -> dict[str, Any]:
    """Return the arguments for the solver's `bind`: forces and boundaries, wrapped by the
    observers.
    """
    forces: Sequence[Attachable] = scene.acting
    walls: Sequence[Attachable] = scene.boundaries
    for observer in observers:
        forces = observer.wrap_forces(forces)
        walls = observer.wrap_walls(scene.boundaries, walls)
    sums = [observer for observer in observers if observer.in_substeps]
    options = {"forces": forces, "accumulators": sums, "planes": planes_for_free(scene)}
    named = zip(wall_names(scene.boundaries), scene.boundaries, strict=True)
    of_liquid = [(name, wall) for name, wall in named if not wall.holds and wall.object is None]
    if scene.immerses:
        return {**options, "boundaries": scene.boundaries, "walls": of_liquid}
    if scene.mixes:
        return {
            **options, "on_liquid": scene.acting, "boundaries": walls, "walls": of_liquid,
        }  # fmt: skip
    if scene.couples:
        return {**options, "boundaries": walls, "uniform": scene.acting, "walls": scene.boundaries}
    return {**options, "boundaries": of_liquid if scene.projects else walls}


def kernels(scene: Scene, device: str = "cpu") -> Iterator[Any]:
    """Yield the kernels of one thread in a run of a scene.

    Kernels of grabs and wrenches on a part of the object are omitted. If a run needs such a kernel,
    compiling the kernel takes 0.3 s.
    """
    scene = choose_solver(scene, device)
    precision = scene.precision
    real = PRECISIONS[precision]
    form = form_of(precision, device, scene.resolution.gradient)
    subject = Subject(scene, scene.materials)
    yield from tracks.kernels(real)
    if scene.projects:
        from phy124.liquid.kernels import kernels as liquid_kernels

        solids = [body.shape or "" for body in scene.objects if body.free]
        pushed = any(not force.uniform for force in scene.acting)
        options = {"mixed": scene.mixes, "pushed": pushed}
        yield from liquid_kernels(scene.boundaries, solids, real, form, device, **options)
        yield from free.kernels_of(solids, real)
    yield from repair.kernels(subject.laws, real)
    yield from deform.kernels(real, scene.binding, device)
    for observer in observers_for(scene):
        if observer.called_for(subject):
            yield from observer.kernels(subject, real)
    if scene.projects and not scene.mixes:
        return
    if scene.on_lattice:
        from phy124.lattice import kernels, material

        elastic = [section for section in scene.materials if is_elastic(section)]
        shapes = [body.shape or "" for body in scene.objects if body.free]
        yield from kernels.of_bodies(
            elastic,
            scene.boundaries,
            shapes,
            real,
            device,
            dx=scene.dx,
            several=bool(scene.objects),
        )
        if not scene.couples:
            return
        if scene.projects:
            yield make_press(real)
            return
        yield from material.kernels_of(real, device)
    yield from substep.kernels(subject.laws, real, form)
    yield from fluctuation.kernels(scheme_of(scene), real, form)
    for boundary in scene.boundaries:
        yield from boundary.kernels(real, scene.dx)
    if scene.objects:
        yield from pairs.kernels(real)
    yield from free.kernels_of((body.shape or "" for body in scene.objects if body.free), real)


def scheme_of(scene: Scene) -> Scheme:
    """Return the transfer scheme of a scene."""
    accuracy = scene.resolution
    return Scheme(accuracy.passes, accuracy.share, accuracy.rpic_damping)


def _pairs(names: Sequence[str], scene: Scene) -> Iterator[Pair]:
    for first, second in combinations(range(len(names)), 2):
        contact = find_pair(scene.pairs, names[first], names[second])
        yield Pair(first, second, contact.friction, contact.contact == "sticky")


def _initial_motion(x: NDArray, particles: Particles, scene: Scene) -> tuple[NDArray, NDArray]:
    """Return velocities [P,3], m/s, and their gradients [P,3,3], 1/s."""
    if particles.body is None:
        return _rigid_motion(x, particles.mass, scene.object)
    v, C = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
    for index, body in enumerate(scene.every_object):
        chosen = particles.body == index
        if chosen.any():
            v[chosen], C[chosen] = _rigid_motion(x[chosen], particles.mass[chosen], body)
    return v, C


def _rigid_motion(x: NDArray, mass: NDArray, body: Object) -> tuple[NDArray, NDArray]:
    wx, wy, wz = body.spin
    gradient = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    centre = (mass[:, None] * x).sum(axis=0) / mass.sum()
    v = np.array(body.velocity) + (x - centre) @ gradient.T
    return v, np.broadcast_to(gradient, (len(x), 3, 3))
