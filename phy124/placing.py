"""Brings the object, and its surroundings with it, to the scene's size and height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.particles import Particles, sizing
from phy124.scene import Scene


def belongs(scene: Scene, count: int) -> NDArray[np.bool_]:
    """Which of `count` Gaussians are the object and not its surroundings [count]."""
    own = np.ones(count, bool)
    for part in scene.parts:
        if part.surroundings and part.gaussians is not None:
            own[slice(*part.gaussians)] = False
    return own


def place(gaussians: Gaussians, scene: Scene, own: NDArray[np.bool_]) -> Gaussians:
    """Gaussians scaled to the scene's size, over the origin at its height; only `own` is lifted."""
    standing = gaussians.moved(*placing(gaussians, scene, own))
    if scene.object.lift == 0:
        return standing
    means = standing.means.copy()
    means[own, 2] += np.float32(scene.object.lift)
    return replace(standing, means=means)


def placing(
    gaussians: Gaussians, scene: Scene, own: NDArray[np.bool_]
) -> tuple[float, NDArray[np.float64]]:
    """Scale and then offset [3] m that bring the object to its size on z = 0, before the lift."""
    object_ = gaussians if own.all() else gaussians.select(own)
    return sizing(object_, scene.object.size)


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
