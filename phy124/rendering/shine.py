"""Shine: highlights and reflections on what is fluid or metal, by the normals of its surface.

The colours of Gaussians say nothing about gloss. For each frame and camera those of shiny laws are
lit anew: a highlight (Blinn 1977) of one lamp above, and the bright sky above and dark floor below,
reflected. Water reflects little, more at grazing angles (Schlick 1994); metal reflects all, tinted.

A fluid's normals are the gradient of its density, smoothed over `BLUR` cells; it is drawn as discs
along its surface. Metal's are the shortest axes of its Gaussians.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import SH_C0, Frame, Gaussians
from phy124.io.clip import Clip
from phy124.scene import View

BLUR = 1.2
"""Standard deviation of the smoothing, in cells of the simulation's grid."""
KEPT = 256 * 2**20
"""Memory for what is kept from view to view, bytes."""
MOST = 4_000_000
"""Largest number of cells of density; what is scattered farther is smoothed more coarsely."""
LAMP = np.array([0.434, -0.338, 0.835], np.float32)
"""Direction of the lamp."""
OVERLAP, LARGER = 0.48, 2.5
"""Size of a fluid's splats in distances of their neighbours, and how much larger they may become to
overlap."""
FLAT, WIDE = 0.4, 1.2
"""Axes of a fluid's discs, across and along its surface, relative to their size as balls."""


class Gloss(NamedTuple):
    """How a material reflects."""

    least: float
    """Fraction reflected straight on."""
    most: float
    """Fraction reflected at grazing angles."""
    tint: float
    """How much of what it reflects has its own colour."""
    highlight: float
    """Strength of the lamp's highlight."""
    sharpness: float
    """Exponent of the highlight."""
    floor: float
    """Brightness of the floor that it reflects, where the sky is 1."""


GLOSSES = {
    "fluid": Gloss(0.04, 0.4, 0.0, 0.9, 60.0, 0.85),
    "metal": Gloss(0.75, 0.85, 0.85, 0.7, 30.0, 0.12),
}
"""The laws that shine."""


class Shine:
    """The shine of one clip; normals of fluids are kept from view to view."""

    def __init__(self, clip: Clip) -> None:
        """Find out what shines.

        Args:
            clip: Its report says which Gaussians are of which law.
        """
        runs = clip.report.get("shine") or {}
        self._parts = {
            law: np.concatenate([np.arange(*run) for run in some])
            for law, some in runs.items()
            if law in GLOSSES and some
        }
        self._cell = float(clip.report.get("grid", {}).get("dx", 0.0))
        self._surfaces: dict[tuple[int, str], tuple[NDArray, ...]] = {}
        self.seconds = 0.0
        """Time spent so far."""

    @property
    def any(self) -> bool:
        """Whether anything shines."""
        return bool(self._parts) and self._cell > 0

    def frames(self, frames: Iterable[Frame], cameras: Sequence[Camera]) -> Iterator[Frame]:
        """The frames as their cameras see them.

        Args:
            frames: Frames of the clip, in order.
            cameras: One for each.
        """
        for frame, camera in zip(frames, cameras, strict=False):
            start = time.perf_counter()
            shown = self.lit(frame, camera)
            self.seconds += time.perf_counter() - start
            yield shown

    def lit(self, frame: Frame, camera: Camera) -> Frame:
        """A frame whose shiny Gaussians have the colours that a camera sees."""
        gaussians = frame.gaussians
        sh, quats, scales = gaussians.sh.copy(), gaussians.quats, gaussians.scales
        for law, which in self._parts.items():
            normals, *shapes = self._surface(law, frame, which)
            if shapes:
                quats, scales = quats.copy(), scales.copy()
                quats[which], scales[which] = shapes
            towards = np.asarray(camera.eye, np.float32) - gaussians.means[which]
            towards /= np.maximum(_length(towards), 1e-12)
            if law == "metal":
                normals = normals * np.where(_dot(normals, towards) < 0, -1, 1).astype(np.float32)
            seen = np.flatnonzero((_dot(normals, towards) > 0)[:, 0])
            at = which[seen]
            rgb = np.clip(0.5 + SH_C0 * sh[at, 0], 0, 1)
            lit = reflected(rgb, normals[seen], towards[seen], GLOSSES[law])
            sh[at, 1:], sh[at, 0] = 0, (lit - 0.5) / SH_C0
        return replace(frame, gaussians=replace(gaussians, sh=sh, quats=quats, scales=scales))

    def packed(self, clip: Clip) -> tuple[Clip, dict[str, Any]]:
        """The clip as the player draws it, fluids as discs, and what shines in it as plain data.

        Args:
            clip: The same clip.
        """
        quats, scales = clip.quats.copy(), clip.scales.copy()
        for law, which in self._parts.items():
            for frame in clip.frames():
                _, *shapes = self._surface(law, frame, which)
                if shapes:
                    quats[frame.index, which], scales[frame.index, which] = shapes
        # The player blends quaternions of neighbouring frames: of each turn the nearer one.
        for before, after in pairwise(quats):
            after[(before * after).sum(axis=1) < 0] *= -1
        laws = [
            {"gloss": list(GLOSSES[law]), "outwards": law != "metal", "runs": runs_of(which)}
            for law, which in self._parts.items()
        ]
        return replace(clip, quats=quats, scales=scales), {"lamp": LAMP.tolist(), "laws": laws}

    def _surface(self, law: str, frame: Frame, which: NDArray) -> tuple[NDArray, ...]:
        """Normals [N,3] of Gaussians of a law, and of a fluid the shapes that it is drawn with."""
        key = frame.index, law
        if key not in self._surfaces:
            part = frame.gaussians.select(which)
            if law == "metal":
                found: tuple[NDArray, ...] = (shortest_axes(part),)
            else:
                normals, spacing = surface(_finite(part.means), self._cell, BLUR)
                found = (normals, *discs(part, normals, spacing))
            return self._kept(key, found)
        return self._surfaces[key]

    def _kept(self, key: tuple[int, str], found: tuple[NDArray, ...]) -> tuple[NDArray, ...]:
        """What was found, in single precision; kept for the next view if there is room."""
        small = tuple(array.astype(np.float32) for array in found)
        if (len(self._surfaces) + 1) * sum(array.nbytes for array in small) <= KEPT:
            self._surfaces[key] = small
        return small


def shine_of(clip: Clip, view: View) -> Shine | None:
    """The shine of a clip; None if nothing in it shines, or if it is not to.

    Args:
        clip: The clip.
        view: Says whether it is shown.
    """
    shine = Shine(clip) if view.shine else None
    return shine if shine is not None and shine.any else None


def glossed(clip: Clip, view: View) -> tuple[Clip, dict[str, Any] | None]:
    """The clip as the player draws it, and what shines in it; the clip itself if nothing does."""
    shine = shine_of(clip, view)
    return (clip, None) if shine is None else shine.packed(clip)


def runs_of(which: NDArray) -> list[list[int]]:
    """Rising numbers as runs of the first and one past the last."""
    return [[int(run[0]), int(run[-1]) + 1]
            for run in np.split(which, np.flatnonzero(np.diff(which) > 1) + 1)]  # fmt: skip


class _Field:
    """A smoothed density on a grid around points."""

    def __init__(self, x: NDArray, cell: float, blur: float) -> None:
        low, high = np.percentile(x, [0.1, 99.9], axis=0)
        spare = 4 * blur * cell
        extent = high - low + 2 * spare
        self.cell = cell = max(cell, float(np.prod(extent) / MOST) ** (1 / 3))
        self._blur = blur
        self._size = tuple(np.ceil(extent / cell).astype(int) + 1)
        self._at = ((x - low + spare) / cell).T
        nearest = np.rint(self._at).astype(int)
        inside = np.clip(nearest, 0, np.array(self._size)[:, None] - 1)
        self._flat = np.ravel_multi_index(tuple(inside), self._size)

    def summed(self) -> NDArray[np.float32]:
        """The smoothed number of points in each cell."""
        sums = np.bincount(self._flat, minlength=int(np.prod(self._size))).reshape(self._size)
        smooth: Any = scipy.ndimage.gaussian_filter(
            sums.astype(np.float32), self._blur, mode="constant", truncate=3
        )
        return smooth

    def sampled(self, field: NDArray) -> NDArray[np.float32]:
        """A field at the points."""
        found: Any = scipy.ndimage.map_coordinates(field, self._at, order=1, mode="nearest")
        return np.asarray(found, np.float32)


def surface(x: NDArray, cell: float, blur: float) -> tuple[NDArray, NDArray]:
    """Normals of the material that points [N,3] fill, and how far apart they are [N], m.

    Normals point outwards and are shorter than 1 away from the surface.

    Args:
        x: The points, m.
        cell: Spacing of the density, m.
        blur: Standard deviation of its smoothing, in such cells.
    """
    field = _Field(x, cell, blur)
    density: NDArray = field.summed()
    gradient = [field.sampled(column) for column in list(np.gradient(density))]
    normals = -np.stack(gradient, axis=1)
    length = np.linalg.norm(normals, axis=1)
    # That of a plane face is density / (sqrt(2 pi) blur).
    here = field.sampled(density)
    face = float(np.median(here)) / (np.sqrt(2 * np.pi) * blur)
    certain = np.clip(2 * length / max(face, 1e-30), 0, 1)
    spacing = field.cell * np.maximum(here, 1e-6) ** (-1 / 3)
    return normals * (certain / np.maximum(length, 1e-30))[:, None], spacing


def discs(part: Gaussians, normals: NDArray, spacing: NDArray) -> tuple[NDArray, NDArray]:
    """Quaternions [N,4] and scales [N,3]: discs along the surface where it is certain, else balls.

    Args:
        part: Gaussians of a fluid.
        normals: As `surface` has them.
        spacing: As `surface` has it; discs are large enough to overlap.
    """
    length = _length(normals)
    x, y, z = (normals / np.maximum(length, 1e-6)).T
    # The shortest turn from the z axis; about x if that is opposite.
    turned = np.stack([1 + z, np.where(z > -0.9999, -y, 1), x, 0 * z], axis=1)
    turned /= _length(turned)
    size = np.sort(part.scales, axis=1)[:, 1:].mean(axis=1, keepdims=True)
    size = np.clip(OVERLAP * spacing[:, None], size, LARGER * size)
    flat = np.where(length > 0.5, np.array([WIDE, WIDE, FLAT]), 1.0)
    return np.where(length > 0.5, turned, part.quats), size * flat


def reflected(rgb: NDArray, normals: NDArray, towards: NDArray, gloss: Gloss) -> NDArray:
    """Colours [N,3] of a surface that reflects.

    Args:
        rgb: Its own colours [N,3].
        normals: Its normals [N,3]; the shorter, the less it reflects.
        towards: Directions towards the camera [N,3].
        gloss: How it reflects.
    """
    length = _length(normals)
    n, certain = normals / np.maximum(length, 1e-6), np.minimum(length, 1)
    along = _dot(n, towards)
    up = 2 * along[:, 0] * n[:, 2] - towards[:, 2]
    amount = certain * (gloss.least + (gloss.most - gloss.least) * (1 - along.clip(0, 1)) ** 5)
    sky = gloss.floor + (1 - gloss.floor) * _smoothstep(up, -0.35, 0.75)[:, None]
    half = towards + LAMP
    lamp = (_dot(n, half) / np.maximum(_length(half), 1e-6)).clip(0, 1) ** gloss.sharpness
    seen = sky * (1.15 * gloss.tint * rgb + (1 - gloss.tint))
    return np.clip(rgb + amount * (seen - rgb) + gloss.highlight * certain * lamp, 0, 1)


def shortest_axes(gaussians: Gaussians) -> NDArray[np.float32]:
    """The shortest axis of each Gaussian, of either sign [N,3]."""
    w, x, y, z = gaussians.quats.T
    axes = np.stack([
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    return axes[gaussians.scales.argmin(axis=1), :, np.arange(len(gaussians))]


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return np.einsum("ni,ni->n", a, b)[:, None]


def _length(a: NDArray) -> NDArray:
    return np.sqrt(_dot(a, a))


def _smoothstep(x: NDArray, low: float, high: float) -> NDArray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _finite(x: NDArray) -> NDArray[np.float64]:
    """The points, with those at no finite place at the middle of the others."""
    good = np.atleast_1d(np.isfinite(x).all(axis=1))
    middle = np.median(x[good], axis=0) if good.any() else np.zeros(3)
    return np.where(good[:, None], x, middle)
