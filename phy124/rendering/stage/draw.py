"""Uploads a lighting stage (floor, boundaries and backdrop) to a device, and renders it."""

import math
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Array
from phy124.kernels.splat import glass, stage
from phy124.kernels.splat.arrange import arrange
from phy124.rendering.stage.frame import Backdrop, StageFrame, bounds

NO_SHADE = np.zeros((2, 2), np.uint16)


class Uploaded:
    """The lighting stage of a frame in a device's memory; it does not depend on the camera."""

    def __init__(self, shown: StageFrame, device: Any) -> None:
        levels = NO_SHADE if shown.floor is None else shown.floor.levels
        self.setting = setting(shown)
        self.shade = wp.array(levels, dtype=wp.uint16, device=device, copy=False)
        # The solids are sorted on the CPU, so that the renderer does not have to wait for their
        # number.
        self._numbers: Any = wp.array(shown.table, dtype=float, device="cpu")
        kind: Any = glass.Solid
        # An alias of `_numbers`, which owns the memory. A structured NumPy array would be simpler,
        # but if there are several threads, Warp sometimes rejects its type.
        self.solids = wp.array(
            ptr=self._numbers.ptr, shape=len(shown.solids), dtype=kind, device="cpu"
        )


class Surroundings:
    """The lighting stage around the object, as a renderer draws it in all its pictures."""

    among: int
    """Number of the stage's solids that are drawn between Gaussians."""

    def __init__(self, device: Any, *, simd: bool) -> None:
        """Create an empty stage on a Warp device; with `simd`, a CPU draws 16 pixels at a time."""
        self.device, self.simd = device, simd
        self._uploaded: WeakKeyDictionary[StageFrame, Uploaded] = WeakKeyDictionary()
        self._picture: tuple[Any, wp.array] | None = None
        self._arrays: dict[tuple[int, str], tuple[Any, Any]] = {}
        self._counts = wp.zeros(3, dtype=int, device="cpu")

    def look(self, shown: StageFrame, view: Any, means: Array) -> None:
        """Upload a stage; sort its solids into those before, among and behind all Gaussians.

        The Gaussians are at `means` [N,3] m; the camera is a `screen.View`.
        """
        count, uploaded = len(shown.solids), self._uploaded.get(shown)
        if uploaded is None:
            uploaded = self._uploaded[shown] = Uploaded(shown, self.device)
        self._view, self._backdrop, self._current = view, shown.backdrop, uploaded
        self._before, self.among, self._solids = 0, 0, self._allocate(count, self.device)
        if count:
            low, high = shown.box or bounds(means)
            inputs = [view, wp.vec3(*low), wp.vec3(*high), uploaded.solids]
            arranged = self._allocate(count, wp.get_device("cpu"))
            wp.launch(
                arrange, count, inputs=inputs, outputs=[*arranged, self._counts], device="cpu"
            )
            self._before, self.among, _ = self._counts.numpy().tolist()
            if self.device.is_cuda:
                for array, source in zip(self._solids, arranged, strict=True):
                    wp.copy(array, source)

    def tint(self, means: wp.array, splats: wp.array) -> None:
        """Tint the splats that are seen through a glass solid."""
        kernel = stage.tint_splats_simd if self.simd else stage.tint_splats
        threads = math.ceil(len(means) / 16) if self.simd else len(means)
        inputs = [self._view, self._before, self._before + self.among, *self._solids, means]
        wp.launch(kernel, threads, inputs=inputs, outputs=[splats], device=self.device)

    def inputs(self) -> list[Any]:
        """Return the arguments `setting` to `outlines` of the kernels that draw the stage."""
        key = self._backdrop, self._view.width, self._view.height
        if self._picture is None or self._picture[0] != key:
            pixels = wp.array(picture(*key), dtype=wp.vec3, device=self.device, copy=False)
            self._picture = key, pixels
        shown = self._current
        return [shown.setting, shown.shade, self._picture[1], self._before, *self._solids]

    def draw(self, image: wp.array, coverage: wp.array) -> None:
        """Draw the lighting stage behind Gaussians that were rendered over black."""
        view, inputs = self._view, [self._view, *self.inputs(), coverage]
        threads = view.width * view.height
        wp.launch(stage.draw_setting, threads, inputs=inputs, outputs=[image], device=self.device)

    def _allocate(self, count: int, device: Any) -> tuple[Any, Any]:
        key = count, str(device)
        if key not in self._arrays:
            kinds: tuple[Any, Any] = glass.Solid, glass.Outline
            solids, outlines = (wp.empty(count, dtype=kind, device=device) for kind in kinds)
            self._arrays[key] = solids, outlines
        return self._arrays[key]


def setting(shown: StageFrame) -> Any:
    """Return the backdrop and the floor as a `stage.Setting`."""
    packed, floor = stage.Setting(), shown.floor
    packed.top, packed.bottom = wp.vec3(*shown.backdrop.top), wp.vec3(*shown.backdrop.bottom)
    packed.floor, packed.reach, packed.cells = int(floor is not None), 1.0, 0
    if floor is not None:
        packed.height, packed.reach, packed.pool = floor.height, floor.reach, floor.pool
        packed.middle, packed.cells = wp.vec2(*floor.middle), len(floor.shade)
        packed.shaded = wp.vec4i(*floor.shaded)
    return packed


def picture(backdrop: Backdrop, width: int, height: int) -> NDArray[np.float32]:
    """Return the backdrop's picture [H*W,3], 0..1, scaled to fill the frame; maybe empty."""
    import cv2

    image = backdrop.picture
    if image is None:
        return np.zeros((0, 3), np.float32)
    lines, columns = image.shape[:2]
    scale = max(width / columns, height / lines)
    wide = max(1, min(columns, round(width / scale)))
    high = max(1, min(lines, round(height / scale)))
    left, top = (columns - wide) // 2, (lines - high) // 2
    cut = np.ascontiguousarray(image[top : top + high, left : left + wide])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    scaled = cv2.resize(cut, (width, height), interpolation=how)
    return np.asarray(scaled / np.float32(255), np.float32).reshape(-1, 3)
