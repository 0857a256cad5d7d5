"""Props: shapes without particles, which follow a path or move freely as rigid solids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Container
from phy124.boundaries.base import vector
from phy124.boundaries.motion import Free
from phy124.boundaries.planes import Plane
from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions
from phy124.io.axes import euler
from phy124.mpm import FreeBody
from phy124.mpm.tracks import Track
from phy124.particles.scenery import Scenery
from phy124.scene import Scene
from phy124.scene.objects import ANY, find_pair
from phy124.simulation.bodies import DEEPEST


def tracks(scene: Scene) -> Iterator[tuple[int, Track]]:
    """The objects with a path, by number, and their displacement over time [m]."""
    for index, one in enumerate(scene.objects, 1):
        if one.path is not None:
            yield index, one.path.track()


def scenery(scene: Scene, shown: Gaussians, moves: NDArray[np.bool_]) -> Scenery:
    """What completes a frame of the Gaussians that move in the solver.

    Args:
        scene: Says which objects have a motion.
        shown: All Gaussians at rest.
        moves: Which of them move in the solver [N].
    """
    return Scenery(shown, moves, tuple(tracks(scene)), numbers(scene))


def numbers(scene: Scene) -> tuple[int, ...]:
    """The numbers of the objects that move freely."""
    return tuple(index for index, one in enumerate(scene.objects, 1) if one.free)


def free_bodies(scene: Scene, gaussians: Gaussians) -> Iterator[FreeBody]:
    """The rigid solids of a scene where their Gaussians are placed."""
    for index in numbers(scene):
        one, own = scene.objects[index - 1], gaussians.object_id == index
        how = find_pair(scene.pairs, one.name, ANY)
        assert isinstance(one.motion, Free) and one.shape is not None
        w, x, y, z = quaternions(euler(one.turn)[None])[0].tolist()
        yield FreeBody(
            one.name,
            one.shape,
            vector(one.half),
            vector(gaussians.means[own].mean(axis=0, dtype=np.float64)),
            turn=(w, x, y, z),
            density=one.motion.density,
            velocity=one.velocity,
            spin=one.spin,
            friction=how.friction,
            sticky=how.contact == "sticky",
        )


def refuse_overlap(free: Sequence[FreeBody], x: NDArray, scene: Scene) -> None:
    """Make sure that no material is inside a rigid solid at the start, which would stay there.

    Args:
        free: The rigid solids.
        x: Where all particles are [P,3], m.
        scene: Says how deep is too deep.

    Raises:
        InputError: Some is; it says where and how deep.
    """
    for one in free:
        inside = one.depth(x)
        if inside.max(initial=-np.inf) > DEEPEST * scene.dx:
            raise InputError(
                "objects", one.name,
                f"it overlaps what it would meet at the start by {inside.max():.2g} m.",
                'Change place or lift, or let it stand on that object: on = "...".',
            )  # fmt: skip


def planes(scene: Scene) -> list[Plane]:
    """The flat walls that free solids meet: those that are not about one object."""
    if not numbers(scene):
        return []
    found: list[Plane] = []
    for wall in scene.boundaries:
        if isinstance(wall, Container):
            found += wall.sides()
        elif isinstance(wall, Plane):
            found.append(wall)
    return [wall for wall in found if wall.object is None]
