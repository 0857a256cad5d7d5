"""Computes the shadow of Gaussians on the floor by projecting them along the light.

The floor is lit by a soft lamp above and by the sky of a room. Gaussians are projected along the
lamp's direction, like splats (Zwicker et al. 2001), and sorted into layers by height. A layer hides
the layers above it from the floor. A layer at height h dims both lights:

- The layer dims the lamp by the layer's coverage, blurred by a Gaussian of standard deviation
  `SOFTNESS` h, because the lamp is not a point.
- The layer dims the sky by the layer's coverage, weighted with h^2 / (pi (h^2 + r^2)^2), the
  fraction of a uniform sky's light that passes at a distance r (ambient occlusion).
"""

import math
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Array, Gaussians
from phy124.kernels.splat.shadow import cover, cover_simd
from phy124.runtime.device import lock_gpu

CELLS = 128
"""Number of cells along a side of the shadow map."""
LAYERS = 7
"""Number of layers; the height of layer i above the floor is proportional to i^2."""
SLOPE = (-0.30, 0.22)
"""Displacement of the lamp's rays along x and y per metre of descent. The lamp is in front of, to
the left of and above the object.
"""
SOFTNESS = 0.25
"""Standard deviation of the penumbra of the lamp, per metre of height."""
LAMP, SKY = 0.22, 0.32
"""Fractions of the floor's light from the lamp and from the sky; the rest casts no shadow."""
SAMPLE = 65536
"""Largest number of Gaussians that cast shadows. If there are more Gaussians, a sample of the
Gaussians casts wider shadows.
"""
GLASS = 0.25
"""Opacity of boundaries, which are drawn as glass."""
FAINT = 2 / 255
"""A shadow that removes this fraction of the light is drawn half as dark; fainter shadows almost
vanish. The faint and wide shadow of the sky is thus limited in extent.
"""
UNSEEN = 0.1 / 255
"""Smallest fraction of the light whose removal is visible; fainter shadows are omitted."""
FAINTEST = 1e-4
"""Smallest value of a layer's frequency response that is not neglected."""
EDGE = 0.1
"""Fraction of the shadow map's side, at each border, over which the shadow fades."""
Glass = tuple[tuple[int, slice, slice], Array | float]
"""A rectangle of cells (layer, rows, columns), and the optical depth that glass adds there."""


def covering(device: str) -> tuple[Any, int]:
    """Return the kernel that projects Gaussians, and the number of Gaussians per thread."""
    return (cover_simd, 16) if wp.get_device(device).is_cpu else (cover, 1)


@dataclass(frozen=True)
class Caster:
    """Computes the shadow maps of a clip, on the same square of the floor for all frames."""

    middle: tuple[float, float]
    """Centre of the square that the shadow map covers, m."""
    reach: float
    """Half the side of the square that the shadow map covers, m."""
    tallest: float
    """Height above the floor of the highest layer of the shadow computation, m."""
    device: str = "cpu"

    @property
    def cell(self) -> float:
        """Side of a cell of the shadow map, m."""
        return 2 * self.reach / CELLS

    @property
    def heights(self) -> NDArray[np.float64]:
        """Heights of the layers above the floor [LAYERS], m."""
        return self.tallest * np.linspace(0, 1, LAYERS) ** 2

    def layer(self, height: float) -> tuple[int, float]:
        """Return the index of the layer below a height, and the weight of the next layer."""
        level = (LAYERS - 1) * min(height / self.tallest, 1.0) ** 0.5
        layer = min(int(level), LAYERS - 2)
        return layer, level - layer

    def shade(self, gaussians: Gaussians, floor: float, glass: Iterable[Glass] = ()) -> Array:
        """Return the fraction of light that the shadow removes [CELLS,CELLS]; the axes are x and y.

        The floor is at a height [m]; the optical depths of the boundaries are added.
        """
        depth = self._depth(gaussians, floor)
        for cells, dark in glass:
            depth[cells] += dark
        # Most rows of cells are empty, and empty rows are skipped.
        rows = np.flatnonzero(depth.sum(axis=0).any(axis=1))
        covered = slice(rows[0], rows[-1] + 1) if len(rows) else slice(0)
        depth = depth[:, covered]
        below, open = np.zeros_like(depth[0]), np.ones_like(depth[0])
        total, along_y = np.zeros((2, CELLS, CELLS // 2 + 1), np.complex64)
        # A layer is seen from the floor through all layers below. A single layer fits into the
        # cache.
        for layer, response in zip(depth, self._response, strict=True):
            below += layer
            through = np.exp(-below)
            along_y[covered] = np.asarray(scipy.fft.rfft(open - through))
            kept = response.shape[1]
            total[:, :kept] += np.asarray(scipy.fft.fft(along_y[:, :kept], axis=0)) * response
            open = through
        shade = np.asarray(scipy.fft.irfft2(total, (CELLS, CELLS))) * self._window
        np.clip(shade, 0, LAMP + SKY, out=shade)
        shade *= shade / (shade + FAINT)
        shade[shade < UNSEEN] = 0
        return shade

    @lock_gpu
    def _depth(self, gaussians: Gaussians, floor: float) -> Array:
        step = max(1, math.ceil(len(gaussians) / SAMPLE))
        layers = wp.zeros((LAYERS, CELLS, CELLS), dtype=float, device=self.device)

        def sample(array: Array, dtype: object) -> wp.array:
            values = np.ascontiguousarray(array[::step])
            return wp.array(values, dtype=dtype, device=self.device, copy=False)

        inputs = [wp.vec3(*np.subtract(self.middle, self.reach), floor), self.cell]
        inputs += [wp.vec2(*SLOPE), self.tallest, float(step)]
        inputs += [sample(gaussians.opacities, float), sample(gaussians.means, wp.vec3)]
        inputs += [sample(gaussians.quats, wp.vec4), sample(gaussians.scales, wp.vec3)]
        count = len(gaussians.opacities[::step])
        kernel, each = covering(self.device)
        threads = math.ceil(count / each)
        wp.launch(kernel, threads, inputs=inputs, outputs=[layers], device=self.device)
        return np.asarray(layers.numpy(), np.float32)

    @cached_property
    def _response(self) -> list[NDArray[np.complex64]]:
        """Frequency response [CELLS,K] of each layer, where K <= CELLS/2+1: higher layers are
        smoother and need fewer frequencies along y.
        """
        kx = 2 * np.pi * scipy.fft.fftfreq(CELLS, self.cell)[:, None]
        ky = 2 * np.pi * scipy.fft.rfftfreq(CELLS, self.cell)[None, :]
        h = self.heights[:, None, None]
        k = np.hypot(kx, ky)
        blur = np.exp(-0.5 * (SOFTNESS * h * k) ** 2)
        # The transform of h^2 / (pi (h^2 + r^2)^2), shifted back by the lamp's displacement.
        kh = np.maximum(k * h, 1e-9)
        sky = kh * scipy.special.k1(kh) * np.exp(1j * h * (kx * SLOPE[0] + ky * SLOPE[1]))
        smooth = np.exp(-0.5 * (0.7 * self.cell * k) ** 2)
        full = ((LAMP * blur + SKY * sky) * smooth).astype(np.complex64)
        ends = [1 + np.flatnonzero(np.abs(layer).max(axis=0) > FAINTEST).max() for layer in full]
        return [layer[:, :end].copy() for layer, end in zip(full, ends, strict=True)]

    @cached_property
    def _window(self) -> Array:
        """Factor for each cell [CELLS,CELLS] by which the shadow fades at the map's borders."""
        inwards = (np.arange(CELLS) + 0.5) / CELLS
        side = np.clip(np.minimum(inwards, 1 - inwards) / EDGE, 0, 1)
        side = side * side * (3 - 2 * side)
        return np.outer(side, side).astype(np.float32)

    @cached_property
    def cell_centres(self) -> tuple[Array, Array]:
        """Centres of the shadow map's cells along x and along y [CELLS], m."""
        along = (np.arange(CELLS, dtype=np.float32) + 0.5) * self.cell - self.reach
        return self.middle[0] + along, self.middle[1] + along

    def within(self, x: float, y: float, reach_x: float, reach_y: float) -> tuple[slice, slice]:
        """Return the rows and columns of the shadow map's cells around a position.

        Args:
            x: Position along x, m.
            y: Position along y, m.
            reach_x: Largest distance of a cell's centre from the position along x, m.
            reach_y: Largest distance of a cell's centre from the position along y, m.
        """
        ends = zip(self.cell_centres, (x, y), (reach_x, reach_y), strict=True)
        along_x, along_y = (
            slice(bisect_left(centres, at - reach), bisect_left(centres, at + reach))
            for centres, at, reach in ends
        )
        return along_x, along_y
