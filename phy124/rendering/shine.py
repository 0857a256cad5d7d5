"""Add highlights and reflections to fluids and metal, from their surface normals.

Colours of Gaussians contain no gloss. For each frame and camera, the Gaussians of glossy laws
get new colours: with the highlight (Blinn 1977) of a lamp above, and reflections of a bright sky
and a dark floor. Water reflects little, but more at grazing angles (Schlick 1994); metal reflects
almost everything, tinted with its colour.
The normals of a fluid are the gradient of its density, smoothed over `BLUR` cells; its Gaussians
are drawn as discs along the surface. The normals of metal are the shortest axes of its Gaussians.
"""

from __future__ import annotations

import time
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
"""Memory for the normals that are reused in further views [bytes]."""
MOST = 4_000_000
"""Largest number of density cells; the cells of a more scattered fluid are larger."""
LAMP = np.array([0.434, -0.338, 0.835], np.float32)
"""Direction towards the lamp (unit vector)."""
OVERLAP, LARGER = 0.48, 2.5
"""Size of a fluid's splats relative to their spacing, and the largest enlargement to overlap."""
FLAT, WIDE = 0.4, 1.2
"""Axes of a fluid's discs, normal to and along the surface, relative to the radius as balls."""


class Gloss(NamedTuple):
    """Reflection properties of a material."""

    least: float
    """Fraction of light reflected at normal incidence."""
    most: float
    """Fraction of light reflected at grazing angles."""
    tint: float
    """Fraction of the reflected light that is tinted with the material's colour."""
    highlight: float
    """Strength of the lamp's highlight."""
    sharpness: float
    """Exponent of the highlight."""
    floor: float
    """Brightness of the reflected floor, relative to the sky."""


GLOSSES = {
    "fluid": Gloss(0.04, 0.4, 0.0, 0.9, 60.0, 0.85),
    "metal": Gloss(0.75, 0.85, 0.85, 0.7, 30.0, 0.12),
}
"""Law -> reflection properties, for the laws that are glossy."""


class Shine:
    """Gloss of a clip; the normals of fluids are stored and reused in further views."""

    def __init__(self, clip: Clip) -> None:
        """Read from the clip's report which Gaussians are glossy."""
        laws = clip.report.get("shine") or {}
        self._parts = {
            law: np.concatenate([np.arange(*run) for run in runs])
            for law, runs in laws.items()
            if law in GLOSSES and runs
        }
        self._cell = float(clip.report.get("grid", {}).get("dx", 0.0))
        self._surfaces: dict[tuple[int, str], tuple[NDArray, ...]] = {}
        self.seconds = 0.0
        """Time spent on gloss so far [s]."""

    @property
    def any(self) -> bool:
        """Whether any Gaussians are glossy."""
        return bool(self._parts) and self._cell > 0

    def illuminate(self, frame: Frame, camera: Camera) -> Frame:
        """Return the frame with the colours of glossy Gaussians as a camera sees them."""
        start = time.perf_counter()
        lit = self._illuminate(frame, camera)
        self.seconds += time.perf_counter() - start
        return lit

    def _illuminate(self, frame: Frame, camera: Camera) -> Frame:
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
            lit = reflect(rgb, normals[seen], towards[seen], GLOSSES[law])
            sh[at, 1:], sh[at, 0] = 0, (lit - 0.5) / SH_C0
        return replace(frame, gaussians=replace(gaussians, sh=sh, quats=quats, scales=scales))

    def pack(self, clip: Clip) -> tuple[Clip, dict[str, Any]]:
        """Return the clip with its fluids as discs, and its gloss as plain data, for the player."""
        quats, scales = np.array(clip.quats), np.array(clip.scales)
        for law, which in self._parts.items():
            for frame in clip.frames():
                _, *shapes = self._surface(law, frame, which)
                if shapes:
                    quats[frame.index, which], scales[frame.index, which] = shapes
        # The player interpolates quaternions between frames, so their signs must agree.
        for before, after in pairwise(quats):
            after[(before * after).sum(axis=1) < 0] *= -1
        laws = [
            {"gloss": list(GLOSSES[law]), "outwards": law != "metal", "runs": runs_of(which)}
            for law, which in self._parts.items()
        ]
        return replace(clip, quats=quats, scales=scales), {"lamp": LAMP.tolist(), "laws": laws}

    def _surface(self, law: str, frame: Frame, which: NDArray) -> tuple[NDArray, ...]:
        """Return normals [N,3] of a law's Gaussians; for fluids also quaternions and scales."""
        key = frame.index, law
        if key not in self._surfaces:
            part = frame.gaussians.select(which)
            if law == "metal":
                arrays: tuple[NDArray, ...] = (shortest_axes(part),)
            else:
                normals, spacing = surface(_finite(part.means), self._cell, BLUR)
                arrays = (normals, *discs(part, normals, spacing))
            arrays = tuple(array.astype(np.float32) for array in arrays)
            if (len(self._surfaces) + 1) * sum(array.nbytes for array in arrays) > KEPT:
                return arrays
            self._surfaces[key] = arrays
        return self._surfaces[key]


def make_shine(clip: Clip, view: View) -> Shine | None:
    """Return the gloss of a clip; None if nothing is glossy, or if the view turns gloss off."""
    shine = Shine(clip) if view.shine else None
    return shine if shine is not None and shine.any else None


def add_gloss(clip: Clip, view: View) -> tuple[Clip, dict[str, Any] | None]:
    """Return the clip and its gloss for the player; the unchanged clip if nothing is glossy."""
    shine = make_shine(clip, view)
    return (clip, None) if shine is None else shine.pack(clip)


def runs_of(which: NDArray) -> list[list[int]]:
    """Split ascending integers into runs [first, last + 1]."""
    runs = np.split(which, np.flatnonzero(np.diff(which) > 1) + 1)
    return [[int(run[0]), int(run[-1]) + 1] for run in runs]


class _Field:
    """A smoothed number density of points on a grid."""

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

    def sum_points(self) -> NDArray[np.float32]:
        """Return the smoothed number of points in each cell."""
        sums = np.bincount(self._flat, minlength=int(np.prod(self._size))).reshape(self._size)
        smooth: Any = scipy.ndimage.gaussian_filter(
            sums.astype(np.float32), self._blur, mode="constant", truncate=3
        )
        return smooth

    def sample(self, field: NDArray) -> NDArray[np.float32]:
        """Interpolate a field at the points."""
        values: Any = scipy.ndimage.map_coordinates(field, self._at, order=1, mode="nearest")
        return np.asarray(values, np.float32)


def surface(x: NDArray, cell: float, blur: float) -> tuple[NDArray, NDArray]:
    """Return normals [N,3] and spacing [N] m of points x [N,3] m that fill a material.

    Normals point outwards and have unit length near the surface; they are shorter inside.

    Args:
        x: The points, m.
        cell: Cell size of the density grid, m.
        blur: Standard deviation of the density's smoothing, in cells.
    """
    field = _Field(x, cell, blur)
    density: NDArray = field.sum_points()
    gradient = [field.sample(column) for column in list(np.gradient(density))]
    normals = -np.stack(gradient, axis=1)
    length = np.linalg.norm(normals, axis=1)
    # The gradient at a plane face is density / (sqrt(2 pi) blur).
    here = field.sample(density)
    face = float(np.median(here)) / (np.sqrt(2 * np.pi) * blur)
    certain = np.clip(2 * length / max(face, 1e-30), 0, 1)
    spacing = field.cell * np.maximum(here, 1e-6) ** (-1 / 3)
    return normals * (certain / np.maximum(length, 1e-30))[:, None], spacing


def discs(part: Gaussians, normals: NDArray, spacing: NDArray) -> tuple[NDArray, NDArray]:
    """Return quaternions [N,4] and scales [N,3] of a fluid: discs along its surface, balls inside.

    `normals` and `spacing` come from `surface`; the discs are large enough to overlap.
    """
    length = _length(normals)
    x, y, z = (normals / np.maximum(length, 1e-6)).T
    # The shortest rotation from the z axis to the normal; about x if they are opposite.
    rotated = np.stack([1 + z, np.where(z > -0.9999, -y, 1), x, 0 * z], axis=1)
    rotated /= _length(rotated)
    size = np.sort(part.scales, axis=1)[:, 1:].mean(axis=1, keepdims=True)
    size = np.clip(OVERLAP * spacing[:, None], size, LARGER * size)
    flat = np.where(length > 0.5, np.array([WIDE, WIDE, FLAT]), 1.0)
    return np.where(length > 0.5, rotated, part.quats), size * flat


def reflect(rgb: NDArray, normals: NDArray, towards: NDArray, gloss: Gloss) -> NDArray:
    """Compute the colours of a reflecting surface [N,3].

    Args:
        rgb: Colours without reflection [N,3].
        normals: Normals [N,3]; a normal shorter than 1 reflects less.
        towards: Directions towards the camera [N,3].
        gloss: Reflection properties of the material.
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
    """Return the shortest axis of each Gaussian [N,3]; its sign is arbitrary."""
    w, x, y, z = gaussians.quats.T
    axes = np.stack(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return axes[gaussians.scales.argmin(axis=1), :, np.arange(len(gaussians))]


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return np.einsum("ni,ni->n", a, b)[:, None]


def _length(a: NDArray) -> NDArray:
    return np.sqrt(_dot(a, a))


def _smoothstep(x: NDArray, low: float, high: float) -> NDArray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _finite(x: NDArray) -> NDArray[np.float64]:
    """Return the points; those that are not finite are replaced by the median of the others."""
    good = np.atleast_1d(np.isfinite(x).all(axis=1))
    middle = np.median(x[good], axis=0) if good.any() else np.zeros(3)
    return np.where(good[:, None], x, middle)
