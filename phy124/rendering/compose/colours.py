"""Colours of Gaussians that come closer to the photograph than those the generator gave them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, minimum_filter

from phy124.camera import Camera
from phy124.gaussians import SH_C0, Array, Gaussians
from phy124.rendering.compose.matching import likeness
from phy124.rendering.compose.photograph import Photograph
from phy124.rendering.render import BLACK, Renderer

ROUNDS = 16
"""Largest number of corrections; they end as soon as one makes the picture worse."""
STEP, BLUR = 1.5, 1.0
"""Part of the difference that a correction adds, and its blur, about as wide as a splat [px]."""
AROUND = 5
"""Side of the square whose colours a Gaussian may take [px]."""
BEHIND = 0.03
"""How far behind what is seen a Gaussian counts as seen, in depths of the object."""


def matched(
    gaussians: Gaussians, camera: Camera, photograph: Photograph, *, device: str = "cpu"
) -> tuple[Array, float]:
    """Harmonics [N,K,3] of the best match, and its PSNR inside the object, dB.

    What differs at a Gaussian's place in the picture is added to its colour, again and again
    (Landweber's iteration); Gaussians that the camera does not see keep theirs.

    Args:
        gaussians: The object as the photograph shows it.
        camera: The photograph's camera.
        photograph: The photograph.
        device: Warp's name of the device that draws.
    """
    renderer = Renderer(device=device)
    pixels, _ = camera.project(gaussians.means.astype(float))
    seen = _seen(renderer, gaussians, camera, photograph)
    best, quality = gaussians.sh, likeness(renderer, gaussians, camera, photograph)
    photo, inside = photograph.rgb / np.float32(255), photograph.alpha[..., None] > 0.9
    # Colours that the photograph has nearby: without these bounds edges get rings.
    lowest = sampled(minimum_filter(photo, (AROUND, AROUND, 1)), pixels[seen]) - 0.5
    highest = sampled(maximum_filter(photo, (AROUND, AROUND, 1)), pixels[seen]) - 0.5
    for _ in range(ROUNDS):
        missing = (photo - renderer(replace(gaussians, sh=best), camera)) * inside
        missing = gaussian_filter(missing, (BLUR, BLUR, 0))
        tried = best.copy()
        now = SH_C0 * best[seen, 0] + STEP * sampled(missing, pixels[seen])
        tried[seen, 0] = np.clip(now, lowest, highest) / SH_C0
        reached = likeness(renderer, replace(gaussians, sh=tried), camera, photograph)
        if reached <= quality:
            break
        best, quality = tried, reached
    return best, quality


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
        map_coordinates(maps[..., c], places, order=1, mode="nearest") for c in range(maps.shape[2])
    ]
    return np.stack(channels, axis=1).astype(np.float32)
