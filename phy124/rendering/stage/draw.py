"""A stage as the kernels read it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Array
from phy124.kernels.splat import glass, stage, stage_simd
from phy124.rendering.stage.frame import Backdrop, Solid, StageFrame
from phy124.rendering.stage.order import bounds, ranks

NO_SHADE = np.zeros((2, 2), np.uint16)
"""What kernels read where there is no floor."""


class Surroundings:
    """What is around the Gaussians, on a device; a renderer keeps it from picture to picture."""

    among: int
    """How many solids are among the Gaussians."""

    def __init__(self, device: Any, *, simd: bool) -> None:
        """With room for nothing yet.

        Args:
            device: Warp device.
            simd: Whether to draw sixteen pixels at a time, for the vector units of a CPU.
        """
        self.device, self.simd = device, simd
        self._rooms: dict[int, tuple[Any, Any, Any]] = {}
        self._kept: dict[str, tuple[Any, wp.array]] = {}

    def look(self, shown: StageFrame, view: Any, means: Array) -> None:
        """Put a stage on the device.

        Args:
            shown: The stage.
            view: Where it is seen from, a `screen.View`.
            means: Where the Gaussians are [N,3], m.
        """
        self._shown, self._view, count = shown, view, len(shown.solids)
        floats, *self._solids = self._room(count)
        self._before = self.among = 0
        if not count:
            return
        order = ranks(shown.solids, np.array(view.eye), shown.box or bounds(means))
        self._before, self.among, _ = np.bincount(order, minlength=3).tolist()
        floats.assign(rows(shown.solids)[np.argsort(order, kind="stable")])
        solids, outlines = self._solids
        inputs = [view, solids]
        wp.launch(stage.outline, count, inputs=inputs, outputs=[outlines], device=self.device)

    def tint(self, means: wp.array, splats: wp.array) -> None:
        """Give splats that are seen through glass among them its colour."""
        those = slice(self._before, self._before + self.among)
        kernel = stage_simd.tint_splats_simd if self.simd else stage.tint_splats
        threads = math.ceil(len(means) / 16) if self.simd else len(means)
        inputs = [self._view, *(array[those] for array in self._solids), means]
        wp.launch(kernel, threads, inputs=inputs, outputs=[splats], device=self.device)

    def inputs(self) -> list[Any]:
        """What the kernels that draw it read: setting, shade, picture, solids, outlines."""
        floor, view, backdrop = self._shown.floor, self._view, self._shown.backdrop
        shade = NO_SHADE if floor is None else floor.levels
        size = view.width, view.height
        given = [setting(self._shown, self._before)]
        given += [self._given("shade", floor, lambda: shade, wp.uint16)]
        behind = (backdrop, *size)
        given += [self._given("picture", behind, lambda: picture(backdrop, *size), wp.vec3)]
        return [*given, *self._solids]

    def draw(self, image: wp.array, coverage: wp.array) -> None:
        """Draw the stage behind Gaussians that are drawn already, pixel by pixel.

        Args:
            image: Their light on black.
            coverage: How far they cover each pixel.
        """
        view, inputs = self._view, [self._view, *self.inputs(), coverage]
        threads = view.width * view.height
        wp.launch(stage.draw_setting, threads, inputs=inputs, outputs=[image], device=self.device)

    def _room(self, count: int) -> tuple[Any, Any, Any]:
        """Arrays for so many solids: their numbers, the same as solids, and their outlines."""
        if count not in self._rooms:
            floats: Any = wp.empty((count, 16), dtype=float, device=self.device)
            kind: Any = glass.Solid
            # Not from a structured NumPy array: once among many pictures drawn by several threads,
            # its type was found to differ from the struct's, though it did not.
            solids = wp.array(ptr=floats.ptr, shape=count, dtype=kind, device=self.device)
            kind = glass.Outline
            outlines = wp.empty(count, dtype=kind, device=self.device)
            self._rooms[count] = floats, solids, outlines
        return self._rooms[count]

    def _given(self, name: str, source: Any, made: Callable[[], NDArray], dtype: Any) -> wp.array:
        """An array on the device, made anew only if its source is another one."""
        known = self._kept.get(name)
        if known is None or known[0] != source:
            array = wp.array(made(), dtype=dtype, device=self.device, copy=False)
            known = self._kept[name] = (source, array)
        return known[1]


def setting(shown: StageFrame, before: int) -> Any:
    """Backdrop and floor, and how many solids are before all Gaussians, a `stage.Setting`."""
    made, floor = stage.Setting(), shown.floor
    made.top, made.bottom = wp.vec3(*shown.backdrop.top), wp.vec3(*shown.backdrop.bottom)
    made.floor, made.reach, made.cells = int(floor is not None), 1.0, 0
    made.before = before
    if floor is not None:
        made.height, made.reach, made.pool = floor.height, floor.reach, floor.pool
        made.middle, made.cells = wp.vec2(*floor.middle), len(floor.shade)
        made.shaded = wp.vec4i(*floor.shaded)
    return made


def rows(solids: Sequence[Solid]) -> NDArray[np.float32]:
    """Solids as the device's structs have their fields, sixteen numbers each [S,16]."""
    made = np.empty((len(solids), 16), np.float32)
    for row, solid in zip(made, solids, strict=True):
        row[:3], row[3:12] = solid.centre, np.ravel(solid.axes)
        row[12:15], row[15] = solid.half, solid.radius
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
