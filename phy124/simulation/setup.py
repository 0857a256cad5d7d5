"""Prepares a scene for a run: places objects, makes particles, and rejects bad input."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phy124.budget.cost import Estimate
from phy124.budget.limits import check_limits
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.lattice.refusals import refuse_for_lattice
from phy124.materials import AnyMaterial
from phy124.monitor import observers_for
from phy124.monitor.observer import Observer, Subject
from phy124.motion.scenery import Scenery
from phy124.mpm import FreeBody
from phy124.mpm.workers import layers, usable_workers
from phy124.particles import Particles
from phy124.particles.solid import Solid
from phy124.particles.thickness import Proportions, measure_proportions
from phy124.runtime.context import RunContext
from phy124.runtime.cores import refuse_threads
from phy124.scene import Scene
from phy124.scene.lattices import choose_solver, reason_for_mpm
from phy124.scene.liquids import refuse_unprojectable
from phy124.simulation.appearance import Appearance
from phy124.simulation.bodies import Placed, make_body, make_free, make_scenery
from phy124.simulation.materials import refuse_profile
from phy124.simulation.overlap import refuse_solids


@dataclass(frozen=True, eq=False)
class Setup:
    """All data that determine a run; a setup can be used for many runs."""

    source: Gaussians
    crop: Crop
    """Position of the object in the picture with the masks of parts."""
    scene: Scene
    """The scene, with the solver that the device uses for elastic objects."""
    no_lattice: str
    """Reason why no object is simulated on a lattice, or empty."""
    solid_scene: Scene
    """The scene, with a wall for each object on a path."""
    cleaned_scene: Scene
    """The scene, whose parts select Gaussians by the indices after cleaning."""
    cleaning: list[str]
    notes: list[str]
    """Notes about pieces that cleaning dropped."""
    gaussians: Gaussians
    """The cleaned Gaussians at rest [m]."""
    interiors: Sequence[tuple[Solid, float]]
    """See `Body.interiors`."""
    placed: Placed | None
    """The object in its position, which further setups can use; None if there are several objects.
    """
    appearance: Appearance
    particles: Particles
    """Particles of the solver at rest, in the order of the solver's slabs."""
    materials: Sequence[AnyMaterial]
    stiffness: NDArray[np.float64] | None
    """Factor on Young's modulus for each particle [P]; None: all are 1."""
    free: tuple[FreeBody, ...]
    """Freely moving rigid solids."""
    scenery: Scenery
    """All Gaussians at rest, including the Gaussians that the solver does not move."""
    estimate: Estimate
    context: RunContext
    """Particles are sorted for the threads of this context."""
    threads: int
    along: int
    """Axis along which the particles are sorted."""
    keep: bool
    shapes: bool
    """Whether frames contain deformed Gaussians instead of the Gaussians at rest."""
    changes: bool
    """Whether forces, boundaries and stiffness may change during the run."""
    observers: tuple[type[Observer], ...]
    """Classes of observers; the scene determines which of these classes are used."""

    @property
    def shown(self) -> Gaussians:
        """All Gaussians at rest, including grains."""
        return self.appearance.gaussians

    @cached_property
    def proportions(self) -> Proportions | None:
        """Proportions of the objects; None if all objects are scenery."""
        if not self.interiors:
            return None
        with self.context.watch.stage("thickness"):
            return measure_proportions(*self.interiors)

    @property
    def subject(self) -> Subject:
        """Properties that decide which observers the run needs."""
        return Subject(self.solid_scene, self.materials, self.changes)


def prepare(
    gaussians: Gaussians,
    scene: Scene,
    context: RunContext | None = None,
    *,
    crop: Crop = WHOLE,
    along: int | None = None,
    keep: bool = True,
    shapes: bool = True,
    changes: bool = False,
    observers: Sequence[type[Observer]] | None = None,
    placed: Placed | None = None,
) -> Setup:
    """Place the objects of a scene, create their particles, and estimate the cost of the run.

    Args:
        gaussians: The object, of any size, upright and facing +x; or several objects (`object_id`).
            Objects without Gaussians are shapes or copies of the first object.
        scene: Materials, forces, boundaries and accuracy.
        context: Device, number of threads, progress and timer.
        crop: Position of the object in the picture with the masks of parts.
        along: Axis along which particles are sorted; None: chosen by the number of threads.
        keep: Whether to keep all frames for a clip; if not, the frames may exceed the memory.
        shapes: Whether to deform the Gaussians of each frame.
        changes: Whether to allow `Simulation.change`.
        observers: Classes of observers to choose from; None: the observers of the scene's solver.
        placed: A single object in its position, from an earlier setup of the same Gaussians.

    Raises:
        InputError: The Gaussians or the scene cannot be used, or the run would exceed its time
            budget or the free memory.
    """
    context = context or RunContext()
    no_lattice = reason_for_mpm(scene, context.device)
    scene = choose_solver(scene, context.device)
    if observers is None:
        observers = observers_for(scene)
    refuse_threads(context.threads)
    if scene.on_lattice:
        refuse_for_lattice(scene, scene.materials)
    with context.watch.stage("particles"):
        body = make_body(gaussians, scene, crop, placed)
        refuse_profile(scene, body.materials)
        look, shown = body.appearance, body.appearance.gaussians
        solid_scene = scene.with_solids()
        threads = usable_workers(len(look.particles), context.device, context.threads)
        if scene.on_lattice:
            along = 0  # The cells stay in lattice order.
        along = slab_axis(look.particles, threads) if along is None else along
        particles, stiffness = sort_for_slabs(
            look.particles, body.materials, body.stiffness, scene.dx, along
        )
        if solid_scene.projects:
            refuse_unprojectable(solid_scene)
        free = tuple(make_free(scene, shown))
        refuse_solids(free, particles.x, scene)
        judged = costliest_scene(solid_scene, body.materials)
        estimate = check_limits(shown, particles, judged, context.device, keep=keep)
        return Setup(
            source=gaussians,
            crop=crop,
            scene=scene,
            no_lattice=no_lattice,
            solid_scene=solid_scene,
            cleaned_scene=body.scene,
            cleaning=body.cleaning,
            notes=body.notes,
            gaussians=body.gaussians,
            interiors=body.interiors,
            placed=body.placed,
            appearance=look,
            particles=particles,
            materials=body.materials,
            stiffness=stiffness,
            free=free,
            scenery=make_scenery(scene, shown, look.moves),
            estimate=estimate,
            context=context,
            threads=threads,
            along=along,
            keep=keep,
            shapes=shapes,
            changes=changes,
            observers=tuple(observers),
        )


def slab_axis(particles: Particles, threads: int) -> int:
    """Return the axis of sorting: x for one thread, otherwise the longest axis."""
    return int(np.argmax(np.ptp(particles.x, axis=0))) if threads > 1 else 0


def sort_for_slabs(
    particles: Particles,
    materials: Sequence[AnyMaterial],
    stiffness: NDArray | None,
    dx: float,
    axis: int,
) -> tuple[Particles, NDArray | None]:
    """Return the particles, sorted by slabs (layers of cells).

    Args:
        particles: Particles sorted by law, and along x within each law; the order of laws is kept.
        materials: Materials of the particles.
        stiffness: One value per particle [P], or None.
        dx: Thickness of a layer [m].
        axis: The axis perpendicular to the layers; 0: the order stays the same.
    """
    if axis == 0:
        return particles, stiffness
    laws = [section.device_law.name for section in materials]
    law = np.array([laws.index(name) for name in laws])[particles.material]
    body = np.zeros_like(law) if particles.body is None else particles.body
    changes = (np.diff(law, prepend=law[0]) != 0) | (np.diff(body, prepend=body[0]) != 0)
    order = np.lexsort((layers(particles.x, axis, dx), np.cumsum(changes)))
    arrays = {field.name: getattr(particles, field.name) for field in fields(particles)}
    ordered = {name: array[order] for name, array in arrays.items() if array is not None}
    return replace(particles, **ordered), None if stiffness is None else stiffness[order]


def costliest_scene(scene: Scene, materials: Sequence[AnyMaterial]) -> Scene:
    """Return the scene from which the cost of the run is estimated. A properties file is replaced
    by its material with the fastest waves.
    """
    if scene.properties is None:
        return scene
    fastest = max(materials, key=lambda section: section.wave_speed())
    return scene.model_copy(update={"material": fastest, "parts": ()})
