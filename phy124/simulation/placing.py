"""Scales, rotates and places objects together with their surroundings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.axes import euler, rotate_gaussians
from phy124.particles import Particles, size_transform
from phy124.scene import Scene


def mask_object(scene: Scene, count: int) -> NDArray[np.bool_]:
    """Return a mask [count] of the Gaussians of the object, without its surroundings."""
    belonging = np.ones(count, bool)
    for part in scene.parts:
        if part.surroundings and part.gaussians is not None:
            belonging[slice(*part.gaussians)] = False
    return belonging


def place(gaussians: Gaussians, scene: Scene, belonging: NDArray[np.bool_]) -> Gaussians:
    """Return scaled and rotated Gaussians; only the object is shifted, not its surroundings."""
    body = scene.object
    standing = gaussians.transform(*find_placement(gaussians, scene, belonging))
    if any(body.turn):
        standing = rotate_gaussians(standing, euler(body.turn))
        scale, offset = find_placement(standing, scene, belonging)
        standing = standing.transform(1.0, offset / scale)
    return shift(standing, belonging, (*body.place, body.lift))


def shift(
    gaussians: Gaussians, chosen: NDArray[np.bool_], offset: tuple[float, float, float]
) -> Gaussians:
    """Shift the chosen Gaussians by an offset [m]; zero leaves all Gaussians bitwise unchanged."""
    if not any(offset):
        return gaussians
    means = gaussians.means.copy()
    for axis in np.flatnonzero(offset):
        means[chosen, axis] += np.float32(offset[axis])
    return replace(gaussians, means=means)


def find_placement(
    gaussians: Gaussians, scene: Scene, belonging: NDArray[np.bool_]
) -> tuple[float, NDArray[np.float64]]:
    """Return the scale and the offset [3], m, that give the object its size and put it on z = 0."""
    object_ = gaussians if belonging.all() else gaussians.select(belonging)
    return size_transform(object_, scene.object.size)


def stack(placed: Sequence[Gaussians], scene: Scene) -> list[Gaussians]:
    """Move each object that stands on another object vertically until the two objects touch.

    Raises:
        InputError: An object is not above the object on which it stands.
    """
    raised = list(placed)
    objects, names = scene.every_object, scene.names
    waiting = [index for index, body in enumerate(objects) if body.on in names]
    while waiting:
        # Lower objects are moved first; a valid scene contains no cycles.
        index = next(i for i in waiting if names.index(objects[i].on) not in waiting)
        waiting.remove(index)
        below = raised[names.index(objects[index].on)]
        rise = _gap(below, raised[index], scene.spacing)
        if rise is None:
            limit = "it is not above the object on which it should stand."
            remedy = f"Set the `place` of {names[index]} to the `place` of the lower object."
            field = f"objects.{index - 1}.on" if index else "object.on"
            raise InputError(field, objects[index].on, limit, remedy)
        every = np.ones(len(raised[index]), bool)
        up = -rise + objects[index].lift
        raised[index] = shift(raised[index], every, (0.0, 0.0, up))
    return raised


def _gap(below: Gaussians, above: Gaussians, cell: float) -> float | None:
    """Return the smallest vertical gap between two objects [m]; None if neither is above
    the other.
    """
    tops, bottoms = _heights(below, cell, 1.0), _heights(above, cell, -1.0)
    gaps = [-bottoms[at] - tops[at] for at in tops.keys() & bottoms.keys()]
    return min(gaps, default=None)


def _heights(gaussians: Gaussians, cell: float, sign: float) -> dict[tuple[int, int], float]:
    """Return the largest height in each square of a horizontal grid.

    If `sign` is -1, return the smallest height, multiplied by -1.
    """
    squares = np.floor(gaussians.means[:, :2] / cell).astype(int)
    reach = np.sqrt(gaussians.covariances()[:, 2, 2])
    height = sign * gaussians.means[:, 2] + reach
    heights: dict[tuple[int, int], float] = {}
    for square, value in zip(map(tuple, squares.tolist()), height.tolist(), strict=True):
        heights[square] = max(value, heights.get(square, -np.inf))
    return heights


def number_among_all(particles: Particles, belonging: NDArray[np.bool_]) -> Particles:
    """Return the particles with indices into all Gaussians."""
    if belonging.all():
        return particles
    gaussian = particles.gaussian
    every = np.where(gaussian >= 0, np.flatnonzero(belonging)[gaussian], -1).astype(np.int32)
    return replace(particles, gaussian=every)


def renumber_parts(scene: Scene, survivors: NDArray[np.bool_] | None) -> Scene:
    """Return the scene with the indices that the parts' Gaussians have after cleaning."""
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
