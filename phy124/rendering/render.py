"""Renders Gaussians from a camera, with kernels that run on CPU and CUDA alike.

The method is EWA splatting (Zwicker et al. 2001) with the conventions of 3D Gaussian Splatting
(Kerbl et al. 2023). The screen covariance is enlarged by 0.3 px^2 (or by the filter of
Mip-Splatting). Splats are blended from front to back in the order of the centres' depths. Alpha is
at most 0.99, and contributions below 1/255 are skipped. Every splat extends to the distance where
its contribution is 1/255, so that no cut-off is visible.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Array, Gaussians
from phy124.kernels.splat import blend, project, screen, stage
from phy124.rendering.copies import HostCopies
from phy124.rendering.projection import FILTERS, make_view
from phy124.rendering.stage.draw import Surroundings
from phy124.rendering.stage.frame import StageFrame
from phy124.runtime.compiling import compile_missing
from phy124.runtime.device import lock_gpu

Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
BLACK: Colour = (0.0, 0.0, 0.0)
MAX_PAIRS = 1 << 24
"""Largest total length of the tiles' lists; if the total is larger, groups of tiles are blended in
turn.
"""
TILES_PER_SPLAT = 4
"""Expected number of tiles per splat, for which memory is allocated before the first picture."""
BLENDS = {"simd": blend.blend_tiles_simd, "plain": blend.blend_tiles, "pixel": blend.blend_pixels}
"""Blending kernels. A thread draws one tile in vectorised C++ (`simd`, CPU only), one tile in Warp
(`plain`), or one pixel (`pixel`, used on CUDA).
"""
BLEND_STAGED = stage.blend_staged_simd


class Renderer:
    """Renders Gaussians on one device; later calls reuse the buffers of earlier calls.

    Only one thread at a time may use an instance.
    """

    def __init__(
        self, *, device: str | None = None, blend: str = "auto", filter: str = "dilate"
    ) -> None:
        """Compile or load the kernels for a device.

        Args:
            device: Warp's name of the device. If None, CUDA if there is a CUDA device.
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
        # The binning method depends on the blending variant, so that the GPU's variant can be
        # tested on a CPU.
        self._per_pixel = blend == "pixel"
        binned = project.bin_parallel if self._per_pixel else project.bin_serial
        # Number of Gaussians per thread, and the kernel that projects them.
        self._vectorised = simd = blend == "simd"
        self._projection = (16, project.project_simd) if simd else (1, project.project)
        compile_missing((self._projection[1], binned, self._blend), str(self.device))
        self._around = Surroundings(self.device, simd=simd)
        self._room = 0
        """Number of entries of the tiles' lists for which memory is allocated, on a GPU."""
        self._free: list[HostCopies] = []
        """Buffers in host memory for which no caller waits."""
        self._seen: tuple[Camera, Any] | None = None
        self._buffers: dict[str, wp.array] = {}
        self._constants: dict[str, tuple[Any, Array, wp.array]] = {}

    @lock_gpu
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

        Colours are blended as they are stored (sRGB). Gaussians that are not finite, closer than
        `NEAR` or fainter than 1/255 are not drawn.

        Args:
            gaussians: The Gaussians to draw.
            camera: The camera, which defines the image's size.
            background: Colour behind the Gaussians, 0..1.
            alpha: Whether to return [H,W,4], with the coverage as the last channel.
            stage: Surroundings of the Gaussians, which replace the background.

        Raises:
            InputError: The camera or the background cannot be used.
        """
        arrays = ("image", "coverage") if alpha else ("image",)
        drawn = self._start(gaussians, camera, background, stage, arrays)()
        # `concatenate` copies the image, because the next call overwrites the buffers.
        channels = [drawn["image"], *([drawn["coverage"][:, None]] if alpha else [])]
        joined = np.concatenate(channels, axis=1, dtype=np.float32)
        return joined.reshape(camera.height, camera.width, -1)

    @lock_gpu
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
        return self.start_picture(gaussians, camera, background, stage=stage)()

    @lock_gpu
    def start_picture(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: Colour = WHITE,
        *,
        stage: StageFrame | None = None,
    ) -> Callable[[], NDArray[np.uint8]]:
        """Start to render one image as bytes; return a function that waits for the image.

        The image equals the result of `picture`. A GPU draws while the caller prepares the next
        picture. The returned function must be called exactly once.

        Args:
            gaussians: The Gaussians to draw.
            camera: The camera, which defines the image's size.
            background: Colour behind the Gaussians, 0..1.
            stage: Surroundings of the Gaussians, which replace the background.

        Raises:
            InputError: The camera or the background cannot be used.
        """
        shape = (camera.height, camera.width, 3)
        if self._per_pixel:
            finish = self._start(gaussians, camera, background, stage, ("bytes",))
            return lambda: finish()["bytes"].reshape(shape)
        image = self._start(gaussians, camera, background, stage, ("image",))()["image"]
        # The image is changed in place, because allocating memory for each picture takes up to half
        # as long as drawing.
        image *= 255
        image += 0.5
        picture = image.astype(np.uint8).reshape(shape)
        return lambda: picture

    def _start(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: Colour,
        stage: StageFrame | None,
        names: tuple[str, ...],
    ) -> Callable[[], dict[str, NDArray[Any]]]:
        """Start to render an image; return a function that waits for the named arrays.

        The arrays are the colours `image` [H*W,3], the `coverage` [H*W] and, in the variant
        `pixel`, the `bytes` [H*W*3]. If a CPU draws tiles, the arrays alias the renderer's buffers.
        """
        view, pixels = self._look(camera), camera.width * camera.height
        colour = wp.vec3(*_checked_background(BLACK if stage else background))
        if not self._per_pixel:
            self._draw(gaussians, view, colour, stage)
            aliases = {name: np.asarray(self._buffers[name].numpy()) for name in names}
            return lambda: {name: array[:pixels] for name, array in aliases.items()}
        copies = self._free.pop() if self._free else HostCopies(self.device)

        def draw() -> int:
            self._draw(gaussians, view, colour, stage)
            if "bytes" in names:
                output: Any = self._buffer("bytes", 3 * pixels, wp.uint8)[: 3 * pixels]
                outputs = [output.reshape((pixels, 3))]
                image = self._buffers["image"]
                wp.launch(blend.quantise, pixels, [image], outputs, device=self.device)
            sizes = {"image": pixels, "coverage": pixels, "bytes": 3 * pixels}
            arrays: dict[str, Any] = {name: self._buffers[name][: sizes[name]] for name in names}
            total: Any = self._buffers["before"]
            last = view.rows * view.columns
            copies.start(total=total[last : last + 1], **arrays)
            return self._room

        room = draw()

        def finish() -> dict[str, NDArray[Any]]:
            drawn = {name: a.copy() for name, a in self._finish(copies, draw, room).items()}
            # From now on, another thread may start a picture that overwrites the host's buffers.
            self._free.append(copies)
            return drawn

        return finish

    @lock_gpu
    def _finish(
        self, copies: HostCopies, draw: Callable[[], int], room: int
    ) -> dict[str, NDArray[Any]]:
        """Wait for a picture; draw it again if all tiles together had more than `room` splats."""
        drawn = copies.wait()
        while (total := int(drawn["total"][0])) > room:
            enough = total if total > MAX_PAIRS else min(total + total // 5, MAX_PAIRS)
            self._room = max(self._room, enough)
            room = draw()
            drawn = copies.wait()
        return drawn

    def _draw(self, gaussians: Gaussians, view: Any, colour: Any, stage: StageFrame | None) -> None:
        """Draw colours and coverage into the buffers `image` [H*W,3] and `coverage` [H*W].

        In the variant `pixel`, nothing is drawn if the lists of the tiles exceed `_room`.
        """
        pixels = view.width * view.height
        self._project(gaussians, view)
        image = self._buffer("image", pixels, wp.vec3)
        coverage = self._buffer("coverage", pixels, wp.float32)
        around = None
        if stage is not None:
            around = self._around
            around.look(stage, view, gaussians.means)
            if around.among:
                around.tint(self._means, self._buffers["splats"])
        fused = around if around is not None and around.simd else None
        kernel, more = (BLEND_STAGED, fused.inputs()) if fused else (self._blend, [])
        for first, last, lists in self._lists(len(gaussians), view):
            wp.launch(
                kernel,
                dim=(last - first) * (screen.TILE**2 if self._per_pixel else 1),
                inputs=[view, colour, first, *more, *lists, self._buffers["splats"]],
                outputs=[image, coverage],
                device=self.device,
            )
        if around is not None and not around.simd:
            around.draw(image, coverage)

    def _lists(self, n: int, view: Any) -> Iterator[tuple[int, int, tuple[Any, Any, Any]]]:
        if self._per_pixel:
            self._room = self._room or min(TILES_PER_SPLAT * n, MAX_PAIRS)
            if self._room <= MAX_PAIRS:
                yield 0, view.rows * view.columns, self._bin_on_device(n, view)
                return
        counts = self._counts(view)
        for first, last in runs(counts, MAX_PAIRS):
            yield first, last, self._bin(n, view, counts, first, last)

    def prepare(self, gaussians: Gaussians, camera: Camera) -> tuple[Any, NDArray[np.int64]]:
        """Project the Gaussians; return the camera as a `screen.View` and the splats per tile."""
        view = self._look(camera)
        self._project(gaussians, view)
        return view, self._counts(view)

    def _look(self, camera: Camera) -> Any:
        if self._seen is None or self._seen[0] is not camera:
            self._seen = camera, make_view(camera, self._filter)
        return self._seen[1]

    def _project(self, gaussians: Gaussians, view: Any) -> None:
        """Compute the buffers `splats` and `order`, and the marks that `_counts` sums."""
        n = len(gaussians)
        splats, tiles = self._buffer("splats", n, screen.Splat), self._buffer("tiles", n, wp.vec4i)
        # Sorting needs buffers of twice the size of the arrays.
        depths = self._buffer("depths", 2 * n, wp.float32)
        order = self._buffer("order", 2 * n, wp.int32)
        shape = (view.rows + 1, view.columns + 1)
        corners: Any = self._buffer("corners", math.prod(shape), wp.int32)[: math.prod(shape)]
        corners.zero_()
        self._means = self._upload(gaussians.means, wp.vec3, "means")
        each, kernel = self._projection
        wp.launch(
            kernel,
            dim=math.ceil(n / each),
            inputs=[
                self._means,
                self._upload(gaussians.quats, wp.vec4, "quats"),
                self._upload(gaussians.scales, wp.vec3, "scales"),
                self._constant("opacities", gaussians.opacities, wp.float32),
                self._constant("sh", gaussians.sh, wp.vec3),
                gaussians.sh_degree,
                view,
            ],
            outputs=[splats, tiles, depths, order, corners.reshape(shape)],
            device=self.device,
        )
        wp.utils.radix_sort_pairs(depths, order, n)
        if self._per_pixel:
            self._count_on_device(corners.reshape(shape), view)

    def _count_on_device(self, corners: wp.array, view: Any) -> None:
        """Count the splats per tile by cumulative sums along both axes, from the marks at the four
        corners of each splat's rectangle of tiles.
        """
        tiles = view.rows * view.columns
        counts: Any = self._buffer("counts", tiles + 1, wp.int32)[: tiles + 1]
        before: Any = self._buffer("before", tiles + 1, wp.int32)[: tiles + 1]
        launch: Any = functools.partial(wp.launch, device=self.device)
        launch(project.sum_columns, view.columns, outputs=[corners])
        launch(project.count_splats, view.rows, inputs=[view.columns, corners], outputs=[counts])
        wp.utils.array_scan(counts, before, inclusive=False)

    def _counts(self, view: Any) -> NDArray[np.int64]:
        """Return the number of splats in each tile [tiles]; `_project` must have been called."""
        tiles = view.rows * view.columns
        if self._per_pixel:
            before: Any = self._buffers["before"][: tiles + 1]
            return np.diff(before.numpy().astype(np.int64))
        shape = (view.rows + 1, view.columns + 1)
        corners = self._buffers["corners"].numpy()[: math.prod(shape)].reshape(shape)
        return corners.cumsum(0, np.int64).cumsum(1)[:-1, :-1].ravel()

    def _bin_on_device(self, n: int, view: Any) -> tuple[Any, Any, Any]:
        """List the splats of each tile, without copying their number to the host. If the lists need
        more than `_room` entries, the lists stay empty.
        """
        tiles, room = view.rows * view.columns, self._room
        before: Any = self._buffers["before"]
        starts, ends = (self._buffer(name, tiles, wp.int32)[:tiles] for name in ("starts", "ends"))
        inputs = [room, before]
        wp.launch(
            project.start_lists, tiles, inputs=inputs, outputs=[starts, ends], device=self.device
        )
        total = before[tiles : tiles + 1]
        return starts, ends, self._sort_lists(n, view, (0, tiles), room, total, starts, ends)

    def _bin(
        self, n: int, view: Any, counts: NDArray[np.int64], first: int, last: int
    ) -> tuple[Any, Any, Any]:
        bounds = np.zeros(len(counts) + 1, np.int32)
        bounds[first + 1 : last + 1] = counts[first:last].cumsum()
        total = int(bounds[last])
        starts, ends = (self._fill(name, bounds[:-1]) for name in ("starts", "ends"))
        if self._per_pixel:
            entries = self._fill("entries", bounds[last : last + 1])
            lists = self._sort_lists(n, view, (first, last), total, entries, starts, ends)
            return starts, ends, lists
        lists = self._buffer("lists", total, wp.int32)
        order, tiles = self._buffers["order"], self._buffers["tiles"]
        inputs = [n, view.columns, first, last, order, tiles]
        wp.launch(project.bin_serial, 1, inputs=inputs, outputs=[ends, lists], device=self.device)
        return starts, ends, lists

    def _sort_lists(
        self, n: int, view: Any, run: tuple[int, int], room: int, total: Any, starts: Any, ends: Any
    ) -> wp.array:
        first, last = run
        ranks = self._buffer("ranks", 2 * room, wp.int32)
        lists = self._buffer("lists", 2 * room, wp.int32)
        order, tiles = self._buffers["order"], self._buffers["tiles"]
        inputs = [view.columns, first, last, room, total, order, tiles]
        wp.launch(
            project.bin_parallel, n, inputs=inputs, outputs=[ends, ranks, lists], device=self.device
        )
        wp.utils.segmented_sort_pairs(ranks, lists, room, starts[first:last], ends[first:last])
        return lists

    def _buffer(self, name: str, size: int, dtype: Any) -> wp.array:
        """Return a named buffer, enlarged to at least `size` items; its content may be lost."""
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            # The buffer is a fifth larger than requested, because later frames may need slightly
            # more space.
            buffer = wp.empty(max(1, size + size // 5), dtype=dtype, device=self.device)
            self._buffers[name] = buffer
        return buffer

    def _fill(self, name: str, values: NDArray[np.int32]) -> Any:
        buffer = self._buffer(name, len(values), wp.int32)[: len(values)]
        buffer.assign(values)
        return buffer

    def _upload(self, array: NDArray, dtype: Any, name: str | None = None) -> wp.array:
        """Share an array on a CPU; copy it to a GPU, into the named buffer or new memory."""
        if name is None or not self.device.is_cuda:
            return wp.array(array, dtype=dtype, device=self.device, copy=False)
        buffer: Any = self._buffer(name, len(array), dtype)[: len(array)]
        wp.copy(buffer, wp.array(array, dtype=dtype, device="cpu", copy=False))
        return buffer

    def _constant(self, name: str, array: Array, dtype: Any) -> wp.array:
        """Upload an array that is constant within a clip; later calls reuse the copy."""
        where = (array.ctypes.data, array.shape)
        known = self._constants.get(name)
        if known is None or known[0] != where:
            # The reference to the array prevents another array from getting the same address.
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
        alpha: Whether to return [H,W,4], with the coverage as the last channel.
        device: Warp's name of the device. The default is CUDA if there is a CUDA device.

    Raises:
        InputError: There is no such device, or the camera or the background cannot be used.
    """
    return Renderer(device=device)(gaussians, camera, background, alpha=alpha)


def to_bytes(image: Array) -> NDArray[np.uint8]:
    """Convert an image with values in 0..1 to bytes, and round to the nearest integer."""
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
    """Group adjacent tiles into ranges [first, last) with at most `limit` splats in total.

    A tile with more splats forms its own range.
    """
    sums, first = np.cumsum(counts), 0
    while first < len(counts):
        before = sums[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(sums, before + limit, "right")))
        yield first, last
        first = last
