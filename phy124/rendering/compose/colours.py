"""Fits the colours and sizes of Gaussians to the photograph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import SH_C0, Array, Gaussians
from phy124.kernels.splat import blend, screen
from phy124.rendering.compose.photograph import Photograph, likeness
from phy124.rendering.render import BLACK, MAX_PAIRS, Renderer, runs

ROUNDS = 12
SIZES = (1.0, 0.8)
"""Sizes of splats that are tried, relative to the original sizes; generators let splats overlap too
much.
"""
AROUND = 9
"""A Gaussian's colour is limited to the range of colours in a square of pixels around the Gaussian.
This is the side of the square [px].
"""
BEHIND = 0.03
"""Visible Gaussians are at most this far behind the front surface [depth of the object]."""


@dataclass(frozen=True, eq=False)
class ColourMatch:
    """Colours and sizes of the Gaussians that match a photograph best."""

    psnr: float
    """PSNR of the rendered picture inside the object [dB]."""
    sh: Array
    """Spherical-harmonic coefficients of the Gaussians' colours [N,K,3]."""
    sizes: Array
    """Sizes of the Gaussians relative to their original sizes [N]."""


def match_colours(
    gaussians: Gaussians,
    camera: Camera,
    photograph: Photograph,
    *,
    device: str = "cpu",
    each: Callable[[], object] = lambda: None,
) -> ColourMatch:
    """Fit colours and sizes to the photograph; unseen Gaussians do not change.

    Args:
        gaussians: The object as the photograph shows it.
        camera: The photograph's camera.
        photograph: The photograph.
        device: Warp's name of the device that renders.
        each: Function that is called before each correction. It may raise Cancelled.
    """
    renderer = Adjoint(device=device)
    seen = _seen(renderer, gaussians, camera, photograph)
    before = likeness(renderer, gaussians, camera, photograph)
    matches = [ColourMatch(before, gaussians.sh, np.ones(len(seen), np.float32))]
    for size in SIZES:
        sizes = np.where(seen, np.float32(size), np.float32(1))
        sized = replace(gaussians, scales=gaussians.scales * sizes[:, None])
        better = _fit_colours(renderer, sized, seen, camera, photograph, each)
        psnr = likeness(renderer, better, camera, photograph)
        matches.append(ColourMatch(psnr, better.sh, sizes))
    return max(matches, key=lambda match: match.psnr)


def _fit_colours(
    renderer: Adjoint,
    gaussians: Gaussians,
    seen: NDArray,
    camera: Camera,
    photograph: Photograph,
    each: Callable[[], object],
) -> Gaussians:
    """Fit the colours by SIRT with Nesterov's momentum: each step adds `(W^T r) / (W^T 1)`. The
    matrix W maps the colours of Gaussians to pixels, and r is the residual.
    """
    photo, inside = photograph.rgb / np.float32(255), photograph.alpha[..., None] > 0.9
    pixels, _ = camera.project(gaussians.means[seen].astype(float))
    # Without these bounds, rings would appear along edges in the picture.
    lowest = sample_maps(scipy.ndimage.minimum_filter(photo, (AROUND, AROUND, 1)), pixels) - 0.5
    highest = sample_maps(scipy.ndimage.maximum_filter(photo, (AROUND, AROUND, 1)), pixels) - 0.5
    now = ahead = gaussians.sh[seen, 0]
    for number in range(1, ROUNDS + 1):
        each()
        missing = (photo - renderer(_recolour(gaussians, seen, ahead), camera)) * inside
        sums, weights = renderer.sums(gaussians, camera, missing)
        step = sums[seen] / np.maximum(weights[seen, None], 1e-3)
        last, now = now, np.clip(SH_C0 * ahead + step, lowest, highest) / SH_C0
        ahead = now + (number - 1) / (number + 2) * (now - last)
    return _recolour(gaussians, seen, now)


def _recolour(gaussians: Gaussians, seen: NDArray[np.bool_], colours: NDArray) -> Gaussians:
    sh = gaussians.sh.copy()
    sh[seen, 0] = colours
    return replace(gaussians, sh=sh)


def _seen(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, photograph: Photograph
) -> NDArray[np.bool_]:
    pixels, depths = camera.project(gaussians.means.astype(float))
    depths = (depths - depths.min()) / max(float(np.ptp(depths)), 1e-9)
    g, grey = gaussians, np.repeat(depths[:, None], 3, axis=1)
    coded = Gaussians.from_rgb(g.means, g.quats, g.scales, g.opacities, grey)
    image = renderer(coded, camera, BLACK, alpha=True)
    nearest = image[..., :1] / np.maximum(image[..., 3:], 1e-3)
    maps = np.concatenate([nearest, image[..., 3:], photograph.alpha[..., None]], axis=2)
    depth, covered, inside = sample_maps(maps, pixels).T
    return (depths <= depth + BEHIND) & (covered > 0.5) & (inside > 0.9)


def sample_maps(maps: NDArray, pixels: NDArray) -> NDArray[np.float32]:
    """Interpolate maps [H,W,C] at pixel positions [N,2], clamped at the border; return [N,C]."""
    places = pixels[:, ::-1].T - 0.5
    channels = [
        scipy.ndimage.map_coordinates(maps[..., c], places, order=1, mode="nearest")
        for c in range(maps.shape[2])
    ]
    return np.stack(channels, axis=1).astype(np.float32)


class Adjoint(Renderer):
    """A renderer that can also sum pixel values for each Gaussian (the transpose of rendering)."""

    def sums(
        self, gaussians: Gaussians, camera: Camera, values: NDArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the weighted sums of pixel values for each Gaussian [N,3], and the sums of the
        weights [N].

        With the matrix W that maps the Gaussians' colours to pixels, these are `W^T values` and
        `W^T 1`. `values` is [H,W,3].
        """
        view, counts = self.prepare(gaussians, camera)
        pixels = self._upload(np.ascontiguousarray(values.reshape(-1, 3), np.float32), wp.vec3)
        sums = wp.zeros(len(gaussians), dtype=wp.vec3, device=self.device)
        weights = wp.zeros(len(gaussians), dtype=wp.float32, device=self.device)
        kernel, each = blend.gather_pixels, screen.TILE**2
        if self._vectorised:
            kernel, each = blend.gather_tiles_simd, 1
        for first, last in runs(counts, MAX_PAIRS):
            lists = self._bin(len(gaussians), view, counts, first, last)
            wp.launch(
                kernel,
                (last - first) * each,
                inputs=[view, first, pixels, *lists, self._buffers["splats"]],
                outputs=[sums, weights],
                device=self.device,
            )
        return np.asarray(sums.numpy(), np.float32), np.asarray(weights.numpy(), np.float32)
