"""Brings the object, and its surroundings with it, to the scene's size and height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.axes import euler, rotate_gaussians
from phy124.particles import Particles, size_transform
from phy124.scene import Scene


def belongs(scene: Scene, count: int) -> NDArray[np.bool_]:
    """Which of `count` Gaussians are the object and not its surroundings [count]."""
    own = np.ones(count, bool)
    for part in scene.parts:
        if part.surroundings and part.gaussians is not None:
            own[slice(*part.gaussians)] = False
    return own


def place(gaussians: Gaussians, scene: Scene, own: NDArray[np.bool_]) -> Gaussians:
    """Gaussians scaled to the scene's size and turned, in their place; only `own` is shifted."""
    body = scene.object
    standing = gaussians.moved(*placing(gaussians, scene, own))
    if any(body.turn):
        standing = rotate_gaussians(standing, euler(body.turn))
        scale, offset = placing(standing, scene, own)
        standing = standing.moved(1.0, offset / scale)
    return shifted(standing, own, (*body.place, body.lift))


def shifted(
    gaussians: Gaussians, own: NDArray[np.bool_], offset: tuple[float, float, float]
) -> Gaussians:
    """The Gaussians with `own` of them moved by an offset [m]; bit for bit the same along zeros."""
    if not any(offset):
        return gaussians
    means = gaussians.means.copy()
    for axis in np.flatnonzero(offset):
        means[own, axis] += np.float32(offset[axis])
    return replace(gaussians, means=means)


def placing(
    gaussians: Gaussians, scene: Scene, own: NDArray[np.bool_]
) -> tuple[float, NDArray[np.float64]]:
    """Scale and then offset [3] m that bring the object to its size on z = 0, before the lift."""
    object_ = gaussians if own.all() else gaussians.select(own)
    return size_transform(object_, scene.object.size)


def stacked(some: Sequence[Gaussians], scene: Scene) -> list[Gaussians]:
    """The objects of a scene, those that stand on another one raised until they touch it.

    Args:
        some: Each object in its place above the floor.
        scene: Says which stands on which, and with what lift.

    Raises:
        InputError: One is not above what it stands on.
    """
    found = list(some)
    objects, names = scene.every_object, scene.names
    waiting = [index for index, one in enumerate(objects) if one.on in names]
    while waiting:
        # Those below first; the scene has no circles.
        index = next(i for i in waiting if names.index(objects[i].on) not in waiting)
        waiting.remove(index)
        below = found[names.index(objects[index].on)]
        rise = _gap(below, found[index], scene.spacing)
        if rise is None:
            raise InputError(
                f"{names[index]}.on", objects[index].on, "it is not above that object.",
                f"Give {names[index]} the place of the object that it is to stand on.",
            )  # fmt: skip
        every = np.ones(len(found[index]), bool)
        up = -rise + objects[index].lift
        found[index] = shifted(found[index], every, (0.0, 0.0, up))
    return found


def _gap(below: Gaussians, above: Gaussians, cell: float) -> float | None:
    """Smallest height of one object over the other, over squares of a side [m]; None: nowhere."""
    tops, bottoms = _heights(below, cell, 1.0), _heights(above, cell, -1.0)
    gaps = [-bottoms[at] - tops[at] for at in tops.keys() & bottoms.keys()]
    return min(gaps, default=None)


def _heights(gaussians: Gaussians, cell: float, way: float) -> dict[tuple[int, int], float]:
    """The largest height, or with `way` -1 that of the lowest point negated, over each square."""
    squares = np.floor(gaussians.means[:, :2] / cell).astype(int)
    reach = np.sqrt(gaussians.covariances()[:, 2, 2])
    height = way * gaussians.means[:, 2] + reach
    found: dict[tuple[int, int], float] = {}
    for square, value in zip(map(tuple, squares.tolist()), height.tolist(), strict=True):
        found[square] = max(value, found.get(square, -np.inf))
    return found


def among_all(particles: Particles, own: NDArray[np.bool_]) -> Particles:
    """Particles of the object's Gaussians, with these numbered among all Gaussians."""
    if own.all():
        return particles
    gaussian = particles.gaussian
    every = np.where(gaussian >= 0, np.flatnonzero(own)[gaussian], -1).astype(np.int32)
    return replace(particles, gaussian=every)


def renumbered(scene: Scene, survivors: NDArray[np.bool_] | None) -> Scene:
    """The scene with parts that refer to Gaussians by their numbers after some were dropped."""
    if survivors is None or survivors.all():
        return scene
    before = np.concatenate([[0], np.cumsum(survivors)])
    last = len(survivors)
    parts = tuple(
        part
        if part.gaussians is None
        else part.model_copy(
            update={"gaussians": tuple(int(before[min(i, last)]) for i in part.gaussians)}
        )
        for part in scene.parts
    )
    return scene.model_copy(update={"parts": parts})
