"""Render Gaussians from a camera, with kernels that run on CPU and CUDA alike.

EWA splatting (Zwicker et al. 2001) with the conventions of 3D Gaussian Splatting (Kerbl et al.
2023): screen covariance plus 0.3 px^2 (or the filter of Mip-Splatting), front-to-back blending in
the order of the centres' depths, alpha at most 0.99, contributions below 1/255 skipped.
Every splat extends to where its contribution falls to 1/255, so that no cut-off is visible.
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
from phy124.rendering.stage.draw import Surroundings
from phy124.rendering.stage.frame import StageFrame
from phy124.runtime.compiling import compile_missing
from phy124.runtime.device import one_at_a_time

Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
BLACK: Colour = (0.0, 0.0, 0.0)
MAX_PAIRS = 1 << 24
"""Largest number of tile entries at once; larger scenes are blended in several runs of tiles."""
BLENDS = {
    "simd": blend.blend_tiles_simd,
    "plain": blend.blend_tiles,
    "pixel": blend.blend_pixels,
}
"""Variants of the blending stage: a tile per thread in vectorised C++ (CPU only), the same in Warp,
and a pixel per thread (used on CUDA)."""
BLEND_STAGED = stage.blend_staged_simd
"""The variant `simd` with a stage behind the Gaussians."""
FILTERS = {"dilate": (0.3, False), "mip": (0.1, True)}
"""Anti-aliasing filter -> addition to the screen covariance [px^2], and whether opacity is reduced
to compensate. 3D Gaussian Splatting does not reduce it, which thickens thin objects seen from far
away; Mip-Splatting does (Yu et al. 2024, section 4.2)."""
NEAR = 0.01
"""Smallest distance from the camera at which a Gaussian's centre is drawn, m."""
FRUSTUM_MARGIN = 1.3
"""Largest offset from the image centre at which the projection is linearised, in half images

(Kerbl et al. 2023)."""
MAX_PIXELS = 1 << 26
"""Number of pixels of the largest image (8192 x 8192)."""


class Renderer:
    """Renders Gaussians on one device; buffers are reused from call to call.

    An instance must be used by one thread at a time.
    """

    def __init__(
        self, *, device: str | None = None, blend: str = "auto", filter: str = "dilate"
    ) -> None:
        """Compile or load the kernels for a device.

        Args:
            device: Warp's name of the device; None: CUDA if there is one.
            blend: Variant of the blending stage, one of `BLENDS`, or auto.
            filter: Anti-aliasing filter, one of `FILTERS`.
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
                f"this form of blending is not available on {self.device}.",
                "Choose auto, plain or pixel; on a CPU also simd.",
            )
        self._blend = BLENDS[blend]
        # Binning follows the blending variant, so a CPU can test the GPU's variant.
        self._per_pixel = blend == "pixel"
        binned = project.bin_parallel if self._per_pixel else project.bin_serial
        # Gaussians per thread, and the kernel of the projection.
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
        """Render one image [H,W,3] float32 in 0..1.

        Colours are blended as stored (sRGB). Gaussians that are not finite, closer than `NEAR` or
        fainter than 1/255 are not drawn.

        Args:
            gaussians: The Gaussians to draw.
            camera: The camera, which defines the image's size.
            background: Colour behind the Gaussians, 0..1.
            alpha: Whether to return [H,W,4], with the coverage as last channel.
            stage: Surroundings of the Gaussians, which replace the background.

        Raises:
            InputError: The camera or the background cannot be used.
        """
        image, coverage = self._draw(gaussians, camera, background, stage)
        # `concatenate` copies the image, because the next call overwrites the buffers.
        channels = [image] + [coverage[:, None]] * alpha
        joined = np.concatenate(channels, axis=1, dtype=np.float32)
        return joined.reshape(camera.height, camera.width, -1)

    @one_at_a_time
    def picture(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: Colour = WHITE,
        *,
        stage: StageFrame | None = None,
    ) -> NDArray[np.uint8]:
        """Render one image as bytes [H,W,3], rounded to the nearest integer.

        Args:
            gaussians: The Gaussians to draw.
            camera: The camera, which defines the image's size.
            background: Colour behind the Gaussians, 0..1.
            stage: Surroundings of the Gaussians, which replace the background.

        Raises:
            InputError: The camera or the background cannot be used.
        """
        image, _ = self._draw(gaussians, camera, background, stage)
        # In place: clearing new memory for each picture takes up to half as long as drawing it.
        image *= 255
        image += 0.5
        return image.astype(np.uint8).reshape(camera.height, camera.width, 3)

    def _draw(
        self, gaussians: Gaussians, camera: Camera, background: Colour, stage: StageFrame | None
    ) -> tuple[Array, Array]:
        """Render colours [H*W,3] and coverage [H*W]; on a CPU both alias the renderer's buffers."""
        pixels = camera.width * camera.height
        view, counts = self.prepare(gaussians, camera)
        colour = wp.vec3(*_checked_background(BLACK if stage else background))
        image = self._buffer("image", pixels, wp.vec3)
        coverage = self._buffer("coverage", pixels, wp.float32)
        around = None
        if stage is not None:
            around = self._around
            around.look(stage, view, gaussians.means)
            if around.among:
                around.tint(self._upload(gaussians.means, wp.vec3), self._buffers["splats"])
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
        light, covered = (np.asarray(array.numpy(), np.float32) for array in (image, coverage))
        return light[:pixels], covered[:pixels]

    def prepare(self, gaussians: Gaussians, camera: Camera) -> tuple[Any, NDArray[np.int64]]:
        """Project the Gaussians; return the camera as a `screen.View` and the splats per tile."""
        view = pinhole(camera)
        view.low_pass, view.keeps_light = self._filter
        view.low_area = float(np.float32(view.low_pass) ** 2)
        return view, self._project(gaussians, view)

    def _project(self, gaussians: Gaussians, view: Any) -> NDArray[np.int64]:
        """Compute `splats` and their `order` by depth; return the number per tile [tiles]."""
        n = len(gaussians)
        splats, tiles = self._buffer("splats", n, screen.Splat), self._buffer("tiles", n, wp.vec4i)
        # Sorting needs buffers of twice the size.
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
                self._upload(gaussians.means, wp.vec3),
                self._upload(gaussians.quats, wp.vec4),
                self._upload(gaussians.scales, wp.vec3),
                self._constant("opacities", gaussians.opacities, wp.float32),
                self._constant("sh", gaussians.sh, wp.vec3),
                gaussians.sh_degree,
                view,
            ],
            outputs=[splats, tiles, depths, order, corners],
            device=self.device,
        )
        wp.utils.radix_sort_pairs(depths, order, n)
        # The kernel marks the four corners of each splat's rectangle of tiles; cumulative sums
        # along both axes turn the marks into counts.
        return corners.numpy().cumsum(0, np.int64).cumsum(1)[:-1, :-1].ravel()

    def _bin(
        self, n: int, view: Any, counts: NDArray[np.int64], first: int, last: int
    ) -> tuple[Any, Any, Any]:
        """Return the splats of tiles `first` to `last`: starts and ends [tiles], and the lists."""
        bounds = np.zeros(len(counts) + 1, np.int32)
        bounds[first + 1 : last + 1] = counts[first:last].cumsum()
        total = int(bounds[last])
        starts, ends = (self._fill(name, bounds[:-1]) for name in ("starts", "ends"))
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
        """Return the named buffer with room for at least `size` items; its content may be lost."""
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            # A fifth more than requested: a moving scene needs slightly more space in later frames.
            buffer = wp.empty(max(1, size + size // 5), dtype=dtype, device=self.device)
            self._buffers[name] = buffer
        return buffer

    def _fill(self, name: str, values: NDArray[np.int32]) -> Any:
        """Copy values into the named buffer; return a view of the same length."""
        buffer = self._buffer(name, len(values), wp.int32)[: len(values)]
        buffer.assign(values)
        return buffer

    def _upload(self, array: NDArray, dtype: Any) -> wp.array:
        """Wrap a NumPy array as a Warp array: shared on a CPU, copied to a GPU."""
        return wp.array(array, dtype=dtype, device=self.device, copy=False)

    def _constant(self, name: str, array: Array, dtype: Any) -> wp.array:
        """Upload an array that is constant within a clip; later calls reuse the uploaded copy."""
        where = (array.ctypes.data, array.shape)
        known = self._constants.get(name)
        if known is None or known[0] != where:
            # A reference to the array keeps its memory address from being reused.
            known = self._constants[name] = (where, array, self._upload(array, dtype))
        return known[2]


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: Colour = WHITE,
    *,
    alpha: bool = False,
    device: str | None = None,
) -> Array:
    """Render one image, as `Renderer` does; for many images use a `Renderer` or `render_frames`.

    Args:
        gaussians: The Gaussians to draw.
        camera: The camera, which defines the image's size.
        background: Colour behind the Gaussians, 0..1.
        alpha: Whether to return [H,W,4], with the coverage as last channel.
        device: Warp's name of the device; default: CUDA if there is one.

    Raises:
        InputError: There is no such device, or the camera or the background cannot be used.
    """
    return Renderer(device=device)(gaussians, camera, background, alpha=alpha)


def to_bytes(image: Array) -> NDArray[np.uint8]:
    """Convert an image in 0..1 to bytes, rounded to the nearest integer."""
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
    """Split tiles into runs [first, last) of at most `limit` entries, or of one larger tile."""
    sums, first = np.cumsum(counts), 0
    while first < len(counts):
        before = sums[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(sums, before + limit, "right")))
        yield first, last
        first = last


def pinhole(camera: Camera) -> Any:
    """Convert the camera to a `screen.View`; the filter is not set.

    Raises:
        InputError: The camera or the size of its image cannot be used.
    """
    width, height = camera.width, camera.height
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InputError(
            "size",
            f"{width} x {height}",
            f"an image has 1 to {MAX_PIXELS:,} pixels.",
            "Choose a size such as 512 x 512.",
        )
    with np.errstate(all="ignore"):
        matrix = camera.view.astype(np.float32)
    if not (np.isfinite(matrix).all() and 0 < camera.fov_y < 180):
        raise InputError(
            "camera",
            camera,
            "the camera has no viewing direction or no field of view.",
            "Place eye and target apart, at finite positions, and take 0 < fov_y < 180 degrees.",
        )
    view = screen.View()
    view.rotation = wp.mat33(matrix[:3, :3].ravel())
    view.translation, view.eye = wp.vec3(*matrix[:3, 3]), wp.vec3(*camera.eye)
    view.focal, view.near = camera.focal, NEAR
    x, y = camera.centre
    view.centre = wp.vec2(x, y)
    farthest = wp.vec2(max(x, width - x), max(y, height - y))
    view.limit = FRUSTUM_MARGIN * farthest / camera.focal
    view.width, view.height = width, height
    view.columns, view.rows = (math.ceil(side / screen.TILE) for side in (width, height))
    return view
