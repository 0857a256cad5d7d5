"""Renderer: draws Gaussians from a camera, with the same kernels on CPU and CUDA.

EWA splatting (Zwicker et al. 2001) with the conventions of 3D Gaussian Splatting (Kerbl et al.
2023): screen covariance plus 0.3 px^2 (or the filter of Mip-Splatting), front-to-back blending in
the order of the centres' depths, alpha at most 0.99, contributions below 1/255 skipped.
Every splat is drawn exactly as far as it reaches 1/255, so that no cut-off is visible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Array, Gaussians
from phy124.kernels.splat import blend, project, screen, stage
from phy124.rendering.pinhole import NEAR as NEAR
from phy124.rendering.pinhole import pinhole
from phy124.rendering.stage.draw import Surroundings
from phy124.rendering.stage.frame import StageFrame
from phy124.runtime.compiling import compile_missing
from phy124.runtime.device import one_at_a_time

Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
BLACK: Colour = (0.0, 0.0, 0.0)
MAX_PAIRS = 1 << 24
"""Number of tile entries held at once; larger scenes are blended in several runs of tiles."""
BLENDS = {
    "simd": blend.blend_tiles_simd,
    "plain": blend.blend_tiles,
    "pixel": blend.blend_pixels,
}
"""Forms of the last stage: a tile per thread in vectorised C++ (CPU only), the same in Warp,
and a pixel per thread (what CUDA runs)."""
BLEND_STAGED = stage.blend_staged_simd
"""The form `simd` with a stage behind the Gaussians."""
FILTERS = {"dilate": (0.3, False), "mip": (0.1, True)}
"""What keeps splats from falling between pixels -> what is added to their screen covariance, px^2,
and whether they become as much fainter: no in 3D Gaussian Splatting, which makes thin things
thicker the smaller they are seen; yes in Mip-Splatting (Yu et al. 2024, section 4.2)."""


class Renderer:
    """Draws Gaussians on one device and keeps its buffers from call to call.

    An instance must be used by one thread at a time.
    """

    def __init__(
        self, *, device: str | None = None, blend: str = "auto", filter: str = "dilate"
    ) -> None:
        """Compile or load the kernels for a device.

        Args:
            device: Warp's name of it; None: CUDA if there is one.
            blend: Form of the last stage, one of `BLENDS`, or auto.
            filter: What keeps splats from falling between pixels, one of `FILTERS`.

        Raises:
            InputError: If there is no such device, form of blending on it, or filter.
        """
        self.device = _device(device)
        if filter not in FILTERS:
            limit, names = "there is no such filter.", " or ".join(FILTERS)
            raise InputError("filter", filter, limit, f"Choose {names}.")
        self._filter = FILTERS[filter]
        if blend == "auto":
            blend = "pixel" if self.device.is_cuda else "simd"
        if blend not in BLENDS or (blend == "simd" and self.device.is_cuda):
            raise InputError(
                "blend",
                blend,
                f"this form of blending does not exist on {self.device}.",
                "Choose auto, plain or pixel, or on a CPU simd.",
            )
        self._blend = BLENDS[blend]
        # The GPU's way of binning goes with its way of blending, so a CPU can test both.
        self._per_pixel = blend == "pixel"
        binned = project.bin_parallel if self._per_pixel else project.bin_serial
        # A form of projection goes with it too: how many Gaussians a thread has, and the kernel.
        self._vectorised = simd = blend == "simd"
        self._projection = (16, project.project_simd) if simd else (1, project.project)
        compile_missing((self._projection[1], binned, self._blend), str(self.device))
        self._around = Surroundings(self.device, simd=simd)
        self._buffers: dict[str, wp.array] = {}
        self._constants: dict[str, tuple[Any, Array, wp.array]] = {}

    @one_at_a_time
    def __call__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: Colour = WHITE,
        *,
        alpha: bool = False,
        stage: StageFrame | None = None,
    ) -> Array:
        """Draw one image [H,W,3] float32 in 0..1.

        Colours are used as stored (sRGB) and blended as such. Gaussians that are not finite, closer
        than `NEAR` or fainter than 1/255 are not drawn.

        Args:
            gaussians: What to draw.
            camera: Where from, and in what size.
            background: Colour behind the Gaussians, 0..1.
            alpha: Whether to return [H,W,4], the last channel being the coverage.
            stage: What stands behind and around the Gaussians instead of the background.

        Raises:
            InputError: If the camera or the background cannot be used.
        """
        image, coverage = self._drawn(gaussians, camera, background, stage)
        # Copied: the buffers are written again by the next call.
        channels = [image] + [coverage[:, None]] * alpha
        drawn = np.concatenate(channels, axis=1, dtype=np.float32)
        return drawn.reshape(camera.height, camera.width, -1)

    @one_at_a_time
    def picture(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: Colour = WHITE,
        *,
        stage: StageFrame | None = None,
    ) -> NDArray[np.uint8]:
        """As a call without `alpha`, but as bytes [H,W,3], rounded to the nearest.

        Args:
            gaussians: What to draw.
            camera: Where from, and in what size.
            background: Colour behind the Gaussians, 0..1.
            stage: What stands behind and around the Gaussians instead of the background.

        Raises:
            InputError: If the camera or the background cannot be used.
        """
        image, _ = self._drawn(gaussians, camera, background, stage)
        # In place: new memory for each picture, which the system first has to clear, can take as
        # long as half of the drawing.
        image *= 255
        image += 0.5
        return image.astype(np.uint8).reshape(camera.height, camera.width, 3)

    def _drawn(
        self, gaussians: Gaussians, camera: Camera, background: Colour, stage: StageFrame | None
    ) -> tuple[Array, Array]:
        """Light [H*W,3] and coverage [H*W], which stand in buffers on a CPU."""
        pixels = camera.width * camera.height
        view, counts = self.prepared(gaussians, camera)
        colour = wp.vec3(*_checked_background(BLACK if stage else background))
        image = self._buffer("image", pixels, wp.vec3)
        coverage = self._buffer("coverage", pixels, wp.float32)
        around = self._look(stage, view, gaussians) if stage else None
        fused = around if around is not None and around.simd else None
        kernel, more = (BLEND_STAGED, fused.inputs()) if fused else (self._blend, [])
        for first, last in runs(counts, MAX_PAIRS):
            lists = self._bin(len(gaussians), view, counts, first, last)
            wp.launch(
                kernel,
                dim=(last - first) * (screen.TILE**2 if self._per_pixel else 1),
                inputs=[view, colour, first, *more, *lists, self._buffers["splats"]],
                outputs=[image, coverage],
                device=self.device,
            )
        if around is not None and not around.simd:
            around.draw(image, coverage)
        light, covered = (np.asarray(one.numpy(), np.float32) for one in (image, coverage))
        return light[:pixels], covered[:pixels]

    def prepared(self, gaussians: Gaussians, camera: Camera) -> tuple[Any, NDArray[np.int64]]:
        """The camera as a `screen.View`, and how many projected splats touch each tile [tiles]."""
        view = pinhole(camera)
        view.low_pass, view.keeps_light = self._filter
        view.low_area = float(np.float32(view.low_pass) ** 2)
        return view, self._project(gaussians, view)

    def _look(self, stage: StageFrame, view: Any, gaussians: Gaussians) -> Surroundings:
        """The stage on the device; what is seen through glass among the Gaussians is tinted."""
        around = self._around
        around.look(stage, view, gaussians.means)
        if around.among:
            around.tint(self._given(gaussians.means, wp.vec3), self._buffers["splats"])
        return around

    def _project(self, gaussians: Gaussians, view: Any) -> NDArray[np.int64]:
        """Fill `splats`, and `order` by depth; return how many splats touch each tile [tiles]."""
        n = len(gaussians)
        splats, tiles = self._buffer("splats", n, screen.Splat), self._buffer("tiles", n, wp.vec4i)
        # Sorting needs room for twice as many.
        depths = self._buffer("depths", 2 * n, wp.float32)
        order = self._buffer("order", 2 * n, wp.int32)
        shape = (view.rows + 1, view.columns + 1)
        corners: Any = self._buffer("corners", math.prod(shape), wp.int32)
        corners.zero_()
        corners = corners[: math.prod(shape)].reshape(shape)
        each, kernel = self._projection
        wp.launch(
            kernel,
            dim=math.ceil(n / each),
            inputs=[
                self._given(gaussians.means, wp.vec3),
                self._given(gaussians.quats, wp.vec4),
                self._given(gaussians.scales, wp.vec3),
                self._constant("opacities", gaussians.opacities, wp.float32),
                self._constant("sh", gaussians.sh, wp.vec3),
                gaussians.sh_degree,
                view,
            ],
            outputs=[splats, tiles, depths, order, corners],
            device=self.device,
        )
        wp.utils.radix_sort_pairs(depths, order, n)
        # Each splat marked the four corners of its rectangle of tiles; running sums along both
        # axes turn the marks into counts, however large the rectangles are.
        return corners.numpy().cumsum(0, np.int64).cumsum(1)[:-1, :-1].ravel()

    def _bin(
        self, n: int, view: Any, counts: NDArray[np.int64], first: int, last: int
    ) -> tuple[Any, Any, Any]:
        """List the splats of tiles `first` to `last`: starts and ends [tiles], and the lists."""
        bounds = np.zeros(len(counts) + 1, np.int32)
        bounds[first + 1 : last + 1] = counts[first:last].cumsum()
        total = int(bounds[last])
        starts, ends = (self._filled(name, bounds[:-1]) for name in ("starts", "ends"))
        order, tiles = self._buffers["order"], self._buffers["tiles"]
        if not self._per_pixel:
            lists = self._buffer("lists", total, wp.int32)
            inputs = [n, view.columns, first, last, order, tiles]
            wp.launch(
                project.bin_serial, 1, inputs=inputs, outputs=[ends, lists], device=self.device
            )
            return starts, ends, lists
        ranks = self._buffer("ranks", 2 * total, wp.int32)
        lists = self._buffer("lists", 2 * total, wp.int32)
        inputs = [view.columns, first, last, order, tiles]
        wp.launch(
            project.bin_parallel, n, inputs=inputs, outputs=[ends, ranks, lists], device=self.device
        )
        wp.utils.segmented_sort_pairs(ranks, lists, total, starts[first:last], ends[first:last])
        return starts, ends, lists

    def _buffer(self, name: str, size: int, dtype: Any) -> wp.array:
        """The named buffer with room for at least `size` items; its content may be lost."""
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            # A fifth more than asked: a scene in motion asks for a little more each frame.
            buffer = wp.empty(max(1, size + size // 5), dtype=dtype, device=self.device)
            self._buffers[name] = buffer
        return buffer

    def _filled(self, name: str, values: NDArray[np.int32]) -> Any:
        """The named buffer with these values, and nothing more."""
        buffer = self._buffer(name, len(values), wp.int32)[: len(values)]
        buffer.assign(values)
        return buffer

    def _given(self, array: NDArray, dtype: Any) -> wp.array:
        """A NumPy array as a Warp array: shared on a CPU, copied to a GPU."""
        return wp.array(array, dtype=dtype, device=self.device, copy=False)

    def _constant(self, name: str, array: Array, dtype: Any) -> wp.array:
        """As `_given`, but uploaded once for the same memory, which is constant in a clip."""
        where = (array.ctypes.data, array.shape)
        known = self._constants.get(name)
        if known is None or known[0] != where:
            # Keeping the array keeps its address from being used again.
            known = self._constants[name] = (where, array, self._given(array, dtype))
        return known[2]


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: Colour = WHITE,
    *,
    alpha: bool = False,
    device: str | None = None,
) -> Array:
    """Draw one image, as `Renderer` does; for many images keep a `Renderer` or use `render_frames`.

    Args:
        gaussians: What to draw.
        camera: Where from, and in what size.
        background: Colour behind the Gaussians, 0..1.
        alpha: Whether to return [H,W,4], the last channel being the coverage.
        device: Warp's name of the device; default: CUDA if there is one.

    Raises:
        InputError: If there is no such device, or the camera or the background cannot be used.
    """
    return Renderer(device=device)(gaussians, camera, background, alpha=alpha)


def to_bytes(image: Array) -> NDArray[np.uint8]:
    """An image in 0..1 as bytes, rounded to the nearest."""
    return (image * 255 + 0.5).astype(np.uint8)


def _device(name: str | None) -> Any:
    try:
        return wp.get_device(name)
    except (ValueError, RuntimeError) as error:
        names = ", ".join(str(d) for d in wp.get_devices())
        raise InputError(
            "device", name, f"this machine has no such device ({error}).", f"Choose from {names}."
        ) from error


def _checked_background(background: Colour) -> Colour:
    if len(background) != 3 or not all(0 <= c <= 1 for c in background):
        raise InputError(
            "background",
            background,
            "a colour is three numbers from 0 to 1.",
            "Write white as (1, 1, 1), black as (0, 0, 0).",
        )
    return background


def runs(counts: NDArray[np.int64], limit: int) -> Iterator[tuple[int, int]]:
    """Runs of tiles [first, last) with at most `limit` entries each, or of a single tile."""
    sums, first = np.cumsum(counts), 0
    while first < len(counts):
        before = sums[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(sums, before + limit, "right")))
        yield first, last
        first = last
