"""Parts: which material each particle is made of, if a scene names several.

A part is selected by a box in space, by a segmentation mask of the picture, by the Gaussians it
contains, or by several of these at once. Later parts win; whatever no part selects has the scene's
material. Static parts have no particles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.painted import WHOLE, Crop, sample_brightness
from phy124.particles import Particles
from phy124.scene import Part, Scene


def crop_of(cutout: Image.Image) -> Crop:
    """Where the object is in its picture, an RGBA cut-out."""
    opaque = np.asarray(cutout.getchannel("A")) > 127
    rows, columns = np.flatnonzero(opaque.any(axis=1)), np.flatnonzero(opaque.any(axis=0))
    if not len(rows):
        return WHOLE
    height, width = opaque.shape
    left, right = columns[0] / width, (columns[-1] + 1) / width
    return float(left), rows[0] / height, float(right), (rows[-1] + 1) / height


def assign(
    x: NDArray,
    gaussian: NDArray,
    parts: Sequence[Part],
    crop: Crop = WHOLE,
    means: NDArray | None = None,
) -> NDArray[np.int32]:
    """Index of each particle's material [P]: 0 for the scene's, i for the i-th part's (from 1).

    Args:
        x: Positions at rest [P,3], m; the object is upright and faces +x.
        gaussian: Index of the Gaussian that each particle is [P], or -1: it follows its nearest
            Gaussian.
        parts: The scene's parts.
        crop: Where the object is in the picture that masks were painted on.
        means: The Gaussians [N,3], m, for particles none of which is a Gaussian.

    Raises:
        InputError: If a mask cannot be read, or a part contains no particle.
    """
    chosen = np.zeros(len(x), np.int32)
    for number, part in enumerate(parts, 1):
        inside = np.ones(len(x), bool)
        if part.region is not None:
            if part.region.units == "file":
                raise InputError(
                    f"parts.{number - 1}.region.units", "file",
                    "the object was not read from a .ply file by `phy124 simulate`.",
                    "Give the region in metres.",
                )  # fmt: skip
            inside &= part.region.contains(x)
        if part.gaussians is not None:
            inside &= _held(x, gaussian, part.gaussians, means)
        if part.mask is not None:
            inside &= sample_brightness(x, part.mask, crop, field=f"parts.{number - 1}.mask") > 0.5
        if not inside.any() and not part.surroundings:
            raise InputError(
                f"parts.{number - 1}", part.data(), "it holds no particle.",
                "Give it a larger region, another mask or other Gaussians.",
            )  # fmt: skip
        chosen[inside] = number
    return chosen


def with_materials(
    particles: Particles, means: NDArray, scene: Scene, crop: Crop = WHOLE
) -> tuple[Particles, NDArray[np.bool_]]:
    """Each particle's material and density, and which Gaussians move [N].

    Args:
        particles: Made of all Gaussians, so that a cut leaves the inside of a solid filled.
        means: The Gaussians at rest [N,3], m.
        scene: Names the parts.
        crop: Where the object is in the picture that masks were painted on.

    Returns:
        The particles that move, sorted by law. Their Gaussians are numbered among those that move.

    Raises:
        InputError: If a part contains nothing, or everything is static.
    """
    every = np.ones(len(means), bool)
    if not scene.parts:
        return particles, every
    part = assign(particles.x, particles.gaussian, scene.parts, crop, means)
    static = np.array([False, *(section.static for section in scene.parts)])
    moves = every
    if static.any():
        seen = assign(means, np.arange(len(means)), scene.parts, crop)
        own = particles.gaussian >= 0
        # A Gaussian and its particle must agree, although fillers may enlarge a mask's extent.
        part[own] = seen[particles.gaussian[own]]
        moves = ~static[seen]
    kept = np.flatnonzero(~static[part])
    if not moves.any() or not len(kept):
        raise InputError(
            "parts", "static = true", "every Gaussian is static, so nothing moves.",
            "Leave a part of the object out.",
        )  # fmt: skip
    laws = [section.device_law.name for section in scene.materials]
    # Number of each part's material among those that move; static ones are not asked for.
    material = (np.cumsum(~static) - 1)[part[kept]]
    law = np.array([laws.index(name) for name in laws])[material]
    order = np.argsort(law, kind="stable")
    kept, material = kept[order], material[order]
    gaussian = particles.gaussian[kept]
    density = np.array([section.density for section in scene.materials])[material]
    found = Particles(
        x=particles.x[kept],
        volume=particles.volume[kept],
        density=density,
        material=material.astype(np.int32),
        gaussian=np.where(gaussian >= 0, (np.cumsum(moves) - 1)[gaussian], -1).astype(np.int32),
    )
    return found, moves


def _held(
    x: NDArray, gaussian: NDArray, span: tuple[int, int], means: NDArray | None
) -> NDArray[np.bool_]:
    """Particles of the Gaussians first <= i < last; fillers follow their nearest Gaussian."""
    owner = gaussian.copy()
    own, filler = gaussian >= 0, gaussian < 0
    if means is not None and not own.any():
        owner = scipy.spatial.KDTree(means).query(x)[1]
    elif filler.any() and own.any():
        nearest = scipy.spatial.KDTree(x[own]).query(x[filler])[1]
        owner[filler] = gaussian[own][nearest]
    return np.logical_and(owner >= span[0], owner < span[1])
