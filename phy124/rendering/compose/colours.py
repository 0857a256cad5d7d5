"""Colours and sizes of Gaussians that come closer to the photograph than their generator's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import SH_C0, Array, Gaussians
from phy124.rendering.compose.adjoint import Adjoint
from phy124.rendering.compose.matching import likeness
from phy124.rendering.compose.photograph import Photograph
from phy124.rendering.render import BLACK, Renderer

ROUNDS = 12
"""Number of corrections."""
SIZES = (1.0, 0.8)
"""Sizes of the splats that are tried: generators let them overlap more than they must."""
AROUND = 9
"""Side of the square whose colours a Gaussian may take [px]."""
BEHIND = 0.03
"""How far behind what is seen a Gaussian counts as seen, in depths of the object."""


@dataclass(frozen=True, eq=False)
class Matched:
    """How Gaussians come closest to a photograph."""

    psnr: float
    """Of their picture inside the object, dB."""
    sh: Array
    """Their harmonics [N,K,3]."""
    sizes: Array
    """Their sizes, relative to those they had [N]."""


def matched(
    gaussians: Gaussians,
    camera: Camera,
    photograph: Photograph,
    *,
    device: str = "cpu",
    each: Callable[[], object] = lambda: None,
) -> Matched:
    """Colours and sizes that come closest to the photograph.

    Gaussians that the camera does not see keep theirs.

    Args:
        gaussians: The object as the photograph shows it.
        camera: The photograph's camera.
        photograph: The photograph.
        device: Warp's name of the device that draws.
        each: Called before each correction; may raise Cancelled.
    """
    renderer = Adjoint(device=device)
    seen = _seen(renderer, gaussians, camera, photograph)
    found = [
        Matched(
            likeness(renderer, gaussians, camera, photograph),
            gaussians.sh,
            np.ones(len(seen), np.float32),
        )
    ]
    for size in SIZES:
        sizes = np.where(seen, np.float32(size), np.float32(1))
        sized = replace(gaussians, scales=gaussians.scales * sizes[:, None])
        better = _fitted(renderer, sized, seen, camera, photograph, each)
        found.append(Matched(likeness(renderer, better, camera, photograph), better.sh, sizes))
    return max(found, key=lambda one: one.psnr)


def _fitted(
    renderer: Adjoint, gaussians: Gaussians, seen: NDArray, camera: Camera, photograph: Photograph,
    each: Callable[[], object],
) -> Gaussians:  # fmt: skip
    """With the colours of the least squares, which are near those that the photograph has nearby.

    With W, which takes colours to pixels, the mean of what a Gaussian's pixels lack, W^T r / W^T 1,
    is added to its colour (SIRT), with Nesterov's momentum.
    """
    photo, inside = photograph.rgb / np.float32(255), photograph.alpha[..., None] > 0.9
    pixels, _ = camera.project(gaussians.means[seen].astype(float))
    # Without these bounds edges get rings.
    lowest = sampled(scipy.ndimage.minimum_filter(photo, (AROUND, AROUND, 1)), pixels) - 0.5
    highest = sampled(scipy.ndimage.maximum_filter(photo, (AROUND, AROUND, 1)), pixels) - 0.5
    now = ahead = gaussians.sh[seen, 0]
    for number in range(1, ROUNDS + 1):
        each()
        missing = (photo - renderer(_coloured(gaussians, seen, ahead), camera)) * inside
        sums, weights = renderer.sums(gaussians, camera, missing)
        step = sums[seen] / np.maximum(weights[seen, None], 1e-3)
        last, now = now, np.clip(SH_C0 * ahead + step, lowest, highest) / SH_C0
        ahead = now + (number - 1) / (number + 2) * (now - last)
    return _coloured(gaussians, seen, now)


def _coloured(gaussians: Gaussians, seen: NDArray[np.bool_], colours: NDArray) -> Gaussians:
    """Gaussians of which those that are seen have these constant harmonics."""
    sh = gaussians.sh.copy()
    sh[seen, 0] = colours
    return replace(gaussians, sh=sh)


def _seen(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, photograph: Photograph
) -> NDArray[np.bool_]:
    """Which Gaussians the camera sees at a place of the object [N], by a picture of depths."""
    pixels, depths = camera.project(gaussians.means.astype(float))
    depths = (depths - depths.min()) / max(float(np.ptp(depths)), 1e-9)
    coded = Gaussians.from_rgb(
        gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities,
        np.repeat(depths[:, None], 3, axis=1),
    )  # fmt: skip
    image = renderer(coded, camera, BLACK, alpha=True)
    nearest = image[..., :1] / np.maximum(image[..., 3:], 1e-3)
    maps = np.concatenate([nearest, image[..., 3:], photograph.alpha[..., None]], axis=2)
    depth, covered, inside = sampled(maps, pixels).T
    return (depths <= depth + BEHIND) & (covered > 0.5) & (inside > 0.9)


def sampled(maps: NDArray, pixels: NDArray) -> NDArray[np.float32]:
    """Values [N,C] of maps [H,W,C] at places [N,2] in pixels, those outside at the border."""
    places = pixels[:, ::-1].T - 0.5
    channels = [
        scipy.ndimage.map_coordinates(maps[..., c], places, order=1, mode="nearest")
        for c in range(maps.shape[2])
    ]
    return np.stack(channels, axis=1).astype(np.float32)
