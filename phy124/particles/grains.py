"""Adds grains: small round Gaussians inside materials that separate, such as sand.

The Gaussians of a generator lie on the surface. When sand, snow or foam separates, the background
would be visible between the Gaussians. Grains do not affect the motion.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import SH_C0, Gaussians, join
from phy124.materials import AnyMaterial
from phy124.particles.seeding import Particles

SIZE = 0.55
"""Standard deviation of a grain, in particle spacings. With this size, regular arrangements of
grains look opaque.
"""
CLEARANCE = 2.5
"""Smallest depth of a grain below the surface, in standard deviations of the grain."""
NEAREST = 0.5
"""Smallest distance between a grain and a Gaussian, in particle spacings."""
OPACITY = 0.95
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in the luminance (Rec. 709)."""
PATCH = 0.06
"""Standard deviation of the filter for brightness, relative to the object's size."""
CELLS = 48
"""Number of cells along each axis of the grid for the filter."""
BRIGHTEST = 99.0
"""Percentage of the tinted Gaussians whose colours are at most as bright as white."""
COARSEST = 0.005
"""Largest size of the grains of a rough surface, relative to the object's longest side."""
FINE = 0.006
"""Largest standard deviation of a Gaussian that still shows a single grain, relative to the
object's longest side.
"""
IDENTITY = (1, 0, 0, 0)


def add_grains(
    gaussians: Gaussians,
    particles: Particles,
    moves: NDArray[np.bool_],
    materials: Sequence[AnyMaterial],
    spacing: float,
) -> tuple[Gaussians, Particles]:
    """Append a Gaussian for each inner particle of a material that separates into grains.

    Args:
        gaussians: The object at rest, N Gaussians.
        particles: The simulated particles.
        moves: Mask of the moving Gaussians [N], to which `particles.gaussian` refers.
        materials: Materials of the particles.
        spacing: Distance between neighbouring particles, m.

    Returns:
        N + G Gaussians, and the particles with the indices of the G new Gaussians.
    """
    loose = np.array([section.grains for section in materials])[particles.material]
    inside = np.flatnonzero(loose & (particles.gaussian < 0))
    if not len(inside):
        return gaussians, particles
    inside = inside[leave_room(gaussians, particles.x[inside], spacing)]
    grains, _ = make_grains(gaussians, particles.x[inside], spacing)
    if (particles.gaussian >= 0).any():
        owner = particles.gaussian.copy()
        owner[inside] = moves.sum() + np.arange(len(inside))
        particles = replace(particles, gaussian=owner)
    return join([gaussians, grains]), particles


def leave_room(gaussians: Gaussians, x: NDArray, spacing: float) -> NDArray[np.bool_]:
    """Return a mask [P] of the points [P,3], m, that are far enough from all Gaussians for
    a grain.
    """
    # A search within a small distance is fast. A search for the nearest Gaussian would be slow near
    # the centre of a ball, where all Gaussians are about equally far away.
    tree = scipy.spatial.KDTree(gaussians.means)
    nearest, _ = tree.query(x, distance_upper_bound=NEAREST * spacing, workers=-1)
    return np.isinf(nearest)


def make_grains(
    gaussians: Gaussians, x: NDArray, spacing: float
) -> tuple[Gaussians, NDArray[np.int64]]:
    """Return grains at inner points x [P,3], m, and the index of the Gaussian nearest to each
    grain.
    """
    depth, above = map(np.asarray, scipy.spatial.KDTree(gaussians.means).query(x, workers=-1))
    return _round_gaussians(gaussians, x, above, depth, spacing), above


def vary_brightness(gaussians: Gaussians, amounts: NDArray, seed: int) -> Gaussians:
    """Change the brightness of each Gaussian at random, with standard deviations `amounts` [N].

    A Gaussian larger than `FINE` shows the mean brightness of several grains, and the mean varies
    less.
    """
    noise = np.random.default_rng(seed).standard_normal(len(gaussians))
    size = gaussians.scales.max(axis=1) / np.ptp(gaussians.means, axis=0).max()
    contrast = amounts * np.minimum(FINE / size, 1)
    brighter = (1 + contrast * noise.clip(-2, 2))[:, None]
    sh = gaussians.sh.copy()
    sh[:, 0] = ((0.5 + SH_C0 * sh[:, 0]) * brighter - 0.5) / SH_C0
    return replace(gaussians, sh=sh)


def roughen(gaussians: Gaussians, amounts: NDArray, seed: int) -> Gaussians:
    """Shift Gaussians at random, so that a surface looks as if it were made of grains.

    `amounts` [N] are the standard deviations of the shifts along each axis, relative to each
    Gaussian's largest standard deviation, or to `COARSEST` if this is smaller. The shift does not
    depend on the accuracy, so results of different accuracies can be compared.
    """
    shifts = np.random.default_rng([seed, 1]).standard_normal(gaussians.means.shape).clip(-2, 2)
    most = COARSEST * float(np.ptp(gaussians.means, axis=0).max())
    reach = (amounts * np.minimum(gaussians.scales.max(axis=1), most))[:, None]
    return replace(gaussians, means=gaussians.means + (reach * shifts).astype(np.float32))


def tint(
    gaussians: Gaussians, chosen: NDArray, colour: Sequence[float], shading: float, fine: bool
) -> Gaussians:
    """Tint Gaussians in the colour of the material, and keep some of the picture's light and shade.

    If more than 1 % of the colours would be brighter than white, all Gaussians are darkened.

    Args:
        gaussians: N Gaussians.
        chosen: Mask of the Gaussians to tint [N].
        colour: Red, green and blue, 0..1.
        shading: Fraction of the contrast in brightness that is kept.
        fine: Whether contrast is kept only for small dark features, such as eyes.
    """
    brightness = gaussians.rgb[chosen] @ LUMINANCE
    if not len(brightness):
        return gaussians
    usual = _average(gaussians.means[chosen], brightness) if fine else brightness.mean()
    relative = brightness / np.maximum(usual, 1e-6)
    if fine:
        relative = np.minimum(relative, 1)
    tinted = np.outer(1 + shading * (relative - 1), colour)
    tinted = np.clip(tinted / max(np.percentile(tinted.max(axis=1), BRIGHTEST), 1), 0, 1)
    sh = gaussians.sh.copy()
    sh[chosen] = 0
    sh[chosen, 0] = (tinted - 0.5) / SH_C0
    return replace(gaussians, sh=sh)


def _average(x: NDArray, values: NDArray) -> NDArray[np.float64]:
    low, size = x.min(axis=0), max(float(np.ptp(x, axis=0).max()), 1e-9)
    place = np.rint((x - low) / size * CELLS).astype(int).T
    shape = tuple(place.max(axis=1) + 1)
    flat: Any = np.ravel_multi_index(tuple(place), shape)
    sums = [np.bincount(flat, weights, minlength=math.prod(shape)) for weights in (values, None)]
    sigma = PATCH * CELLS
    total, count = (scipy.ndimage.gaussian_filter(s.reshape(shape) * 1.0, sigma) for s in sums)
    return (total / np.maximum(count, 1e-12)).reshape(-1)[flat]


def _round_gaussians(
    gaussians: Gaussians, x: NDArray, above: NDArray, depth: NDArray, spacing: float
) -> Gaussians:
    sh = np.zeros((len(x), *gaussians.sh.shape[1:]), gaussians.sh.dtype)
    sh[:, 0] = gaussians.sh[above, 0]
    size = np.minimum(SIZE * spacing, depth / CLEARANCE)
    return Gaussians(
        x,
        np.tile(np.array(IDENTITY, np.float32), (len(x), 1)),
        np.repeat(size[:, None], 3, axis=1),
        np.full(len(x), OPACITY),
        sh,
        None if gaussians.object_id is None else gaussians.object_id[above],
    )
