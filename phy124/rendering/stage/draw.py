"""A stage as the kernels read it."""

from __future__ import annotations

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
"""What kernels read where there is no floor."""


class Uploaded:
    """What is around the Gaussians at an instant, wherever it is seen from, on a device."""

    def __init__(self, shown: StageFrame, device: Any) -> None:
        """Upload a stage."""
        levels = NO_SHADE if shown.floor is None else shown.floor.levels
        self.setting = setting(shown)
        self.shade = wp.array(levels, dtype=wp.uint16, device=device, copy=False)
        self._numbers: Any = wp.array(shown.table, dtype=float, device=device)
        kind: Any = glass.Solid
        # The same memory as solids, which do not keep it: `_numbers` does. Not from a structured
        # NumPy array: once among many pictures drawn by several threads, its type was found to
        # differ from the struct's, though it did not.
        self.solids = wp.array(
            ptr=self._numbers.ptr, shape=len(shown.solids), dtype=kind, device=device
        )


class Surroundings:
    """What is around the Gaussians, on a device; a renderer keeps it from picture to picture."""

    among: int
    """How many solids are among the Gaussians."""

    def __init__(self, device: Any, *, simd: bool) -> None:
        """With nothing there yet.

        Args:
            device: Warp device.
            simd: Whether to draw sixteen pixels at a time, for the vector units of a CPU.
        """
        self.device, self.simd = device, simd
        self._uploaded: WeakKeyDictionary[StageFrame, Uploaded] = WeakKeyDictionary()
        self._picture: tuple[Any, wp.array] | None = None
        self._rooms: dict[int, tuple[Any, Any]] = {}
        self._counts = wp.zeros(3, dtype=int, device=device)

    def look(self, shown: StageFrame, view: Any, means: Array) -> None:
        """Put a stage on the device.

        Args:
            shown: The stage.
            view: Where it is seen from, a `screen.View`.
            means: Where the Gaussians are [N,3], m.
        """
        count, given = len(shown.solids), self._uploaded.get(shown)
        if given is None:
            given = self._uploaded[shown] = Uploaded(shown, self.device)
        self._view, self._backdrop, self._given = view, shown.backdrop, given
        self._before, self.among, self._solids = 0, 0, self._room(count)
        if count:
            low, high = shown.box or bounds(means)
            inputs = [view, wp.vec3(*low), wp.vec3(*high), given.solids]
            outputs = [*self._solids, self._counts]
            wp.launch(arrange, count, inputs=inputs, outputs=outputs, device=self.device)
            self._before, self.among, _ = self._counts.numpy().tolist()

    def tint(self, means: wp.array, splats: wp.array) -> None:
        """Give splats that are seen through glass among them its colour."""
        kernel = stage.tint_splats_simd if self.simd else stage.tint_splats
        threads = math.ceil(len(means) / 16) if self.simd else len(means)
        inputs = [self._view, self._before, self._before + self.among, *self._solids, means]
        wp.launch(kernel, threads, inputs=inputs, outputs=[splats], device=self.device)

    def inputs(self) -> list[Any]:
        """What the kernels that draw it read, from `setting` to `outlines`."""
        behind = self._behind(self._backdrop, self._view.width, self._view.height)
        return [self._given.setting, self._given.shade, behind, self._before, *self._solids]

    def draw(self, image: wp.array, coverage: wp.array) -> None:
        """Draw the stage behind Gaussians that are drawn already, pixel by pixel.

        Args:
            image: Their light on black.
            coverage: How far they cover each pixel.
        """
        view, inputs = self._view, [self._view, *self.inputs(), coverage]
        threads = view.width * view.height
        wp.launch(stage.draw_setting, threads, inputs=inputs, outputs=[image], device=self.device)

    def _room(self, count: int) -> tuple[Any, Any]:
        """Arrays for so many solids in their order and for their outlines."""
        if count not in self._rooms:
            kinds: tuple[Any, Any] = glass.Solid, glass.Outline
            solids, outlines = (wp.empty(count, dtype=kind, device=self.device) for kind in kinds)
            self._rooms[count] = solids, outlines
        return self._rooms[count]

    def _behind(self, *wanted: Any) -> wp.array:
        """The backdrop's picture in a size, made anew only if another one was wanted last."""
        if self._picture is None or self._picture[0] != wanted:
            made = wp.array(picture(*wanted), dtype=wp.vec3, device=self.device, copy=False)
            self._picture = wanted, made
        return self._picture[1]


def setting(shown: StageFrame) -> Any:
    """Backdrop and floor, a `stage.Setting`."""
    made, floor = stage.Setting(), shown.floor
    made.top, made.bottom = wp.vec3(*shown.backdrop.top), wp.vec3(*shown.backdrop.bottom)
    made.floor, made.reach, made.cells = int(floor is not None), 1.0, 0
    if floor is not None:
        made.height, made.reach, made.pool = floor.height, floor.reach, floor.pool
        made.middle, made.cells = wp.vec2(*floor.middle), len(floor.shade)
        made.shaded = wp.vec4i(*floor.shaded)
    return made


def picture(backdrop: Backdrop, width: int, height: int) -> NDArray[np.float32]:
    """Pixels of the backdrop's picture [H*W,3], 0..1; none without one."""
    if backdrop.picture is None:
        return np.zeros((0, 3), np.float32)
    return filling(backdrop.picture, width, height).reshape(-1, 3)


def filling(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.float32]:
    """The middle of a picture, as large as the frame [H,W,3], 0..1."""
    import cv2

    lines, columns = image.shape[:2]
    scale = max(width / columns, height / lines)
    wide = max(1, min(columns, round(width / scale)))
    high = max(1, min(lines, round(height / scale)))
    left, top = (columns - wide) // 2, (lines - high) // 2
    cut = np.ascontiguousarray(image[top : top + high, left : left + wide])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    fitted = cv2.resize(cut, (width, height), interpolation=how)
    return np.asarray(fitted / np.float32(255), np.float32)
