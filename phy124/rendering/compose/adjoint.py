"""A renderer that also goes backwards: from what a picture lacks to colours that would give it."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.kernels.splat import blend, screen
from phy124.rendering.render import MAX_PAIRS, Renderer, runs


class Adjoint(Renderer):
    """Draws Gaussians, and sums a picture's pixels by the Gaussians that show in them."""

    def sums(
        self, gaussians: Gaussians, camera: Camera, values: NDArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Each Gaussian's part in a picture's pixels times their values [N,3], and alone [N].

        With W, which takes colours to pixels, these are W^T values and W^T 1.

        Args:
            gaussians: What is drawn.
            camera: Where from.
            values: Of the pixels [H,W,3].
        """
        view, counts = self.prepared(gaussians, camera)
        pixels = self._given(np.ascontiguousarray(values.reshape(-1, 3), np.float32), wp.vec3)
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
