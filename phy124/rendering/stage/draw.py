"""A stage as the kernels read it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.kernels.splat import glass, stage, stage_simd
from phy124.rendering.stage.frame import Backdrop, Solid, StageFrame

SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
"""The corners of a box of half size 1 [8,3]."""


class Surroundings:
    """A stage on a device, seen by one camera; for one picture."""

    def __init__(self, shown: StageFrame, camera: Camera, view: Any, device: Any) -> None:
        self.shown, self.view, self.device = shown, view, device
        self.setting, self.glazed = setting(shown), bool(shown.solids)
        if self.glazed:
            self._boxes = boxes(shown.solids, camera)
            self._solids = [
                self._given(rows(shown.solids), glass.Solid),
                self._given(self._boxes, wp.vec4i),
            ]

    def tint(self, means: wp.array, splats: wp.array) -> None:
        """Give splats that are seen through the glass its colour."""
        inputs = [self.view, *self._solids, means]
        wp.launch(
            stage.tint_splats, len(means), inputs=inputs, outputs=[splats], device=self.device
        )

    def draw(self, image: wp.array, coverage: wp.array, veil: wp.array, *, simd: bool) -> None:
        """Draw the stage behind the Gaussians.

        Args:
            image: Their light on black.
            coverage: How far they cover each pixel.
            veil: Room for the opacity of the glass at each pixel, if there is any.
            simd: Whether to draw in rows, for the vector units of a CPU.
        """
        floor, view = self.shown.floor, self.view
        shade = np.zeros((2, 2), np.float32) if floor is None else floor.shade
        behind = picture(self.shown.backdrop, view.width, view.height)
        inputs = [view, self.setting, self._given(shade, wp.float32)]
        inputs += [self._given(behind, wp.vec3), self._veiled(veil, coverage), coverage]
        kernel = stage_simd.draw_setting_simd if simd else stage.draw_setting
        threads = view.height if simd else view.width * view.height
        wp.launch(kernel, threads, inputs=inputs, outputs=[image], device=self.device)

    def _veiled(self, veil: wp.array, coverage: wp.array) -> wp.array:
        """The opacity of the glass at each pixel; empty without glass."""
        if not self.glazed:
            return self._given(np.zeros(0, np.float32), wp.float32)
        left, top = self._boxes[:, :2].min(axis=0).tolist()
        right, bottom = self._boxes[:, 2:].max(axis=0).tolist()
        veil.zero_()
        around = wp.vec4i(left, top, right, bottom)
        pixels = max(right - left, 0) * max(bottom - top, 0)
        inputs = [self.view, self.setting, *self._solids, around, coverage]
        wp.launch(stage.draw_glass, pixels, inputs=inputs, outputs=[veil], device=self.device)
        return veil

    def _given(self, array: NDArray | list[Any], dtype: Any) -> wp.array:
        return wp.array(array, dtype=dtype, device=self.device, copy=False)


def setting(shown: StageFrame) -> Any:
    """Backdrop and floor, a `stage.Setting`."""
    made, floor = stage.Setting(), shown.floor
    made.top, made.bottom = wp.vec3(*shown.backdrop.top), wp.vec3(*shown.backdrop.bottom)
    made.floor, made.reach, made.cells = int(floor is not None), 1.0, 0
    if floor is not None:
        made.height, made.reach, made.pool = floor.height, floor.reach, floor.pool
        made.middle, made.cells = wp.vec2(*floor.middle), len(floor.shade)
    return made


def rows(solids: tuple[Solid, ...]) -> list[Any]:
    """Solids as structs of the device.

    Not as a structured NumPy array: once among many pictures drawn by several threads, its type was
    found to differ from the struct's, though it did not.
    """
    made = []
    for solid in solids:
        row = glass.Solid()
        row.centre, row.half = wp.vec3(*solid.centre), wp.vec3(*solid.half)
        row.axes, row.radius = wp.mat33(*np.ravel(solid.axes)), float(solid.radius)
        made.append(row)
    return made


def boxes(solids: tuple[Solid, ...], camera: Camera) -> NDArray[np.int32]:
    """Boxes of pixels x0, y0, x1, y1, half open, in which each solid is seen [S,4]."""
    made = np.tile(np.array([0, 0, camera.width, camera.height], np.int32), (len(solids), 1))
    for row, solid in zip(made, solids, strict=True):
        corners = solid.centre + (SIGNS * (solid.half + solid.radius)) @ solid.axes
        pixels, depths = camera.project(corners)
        if depths.min() > 1e-3:
            row[:2] = np.clip(np.floor(pixels.min(axis=0)), 0, [camera.width, camera.height])
            row[2:] = np.clip(np.ceil(pixels.max(axis=0)), 0, [camera.width, camera.height])
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
