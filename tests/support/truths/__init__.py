"""Solids whose appearance from all sides is known, drawn by sphere tracing.

`truth(name)` scales a solid to the size that `relief` will make it, and returns the front picture,
pictures from `VIEWS`, the depth and the volume. The pictures are drawn once and stored in the
temporary folder.
"""

import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from support.truths.objects import FLAT, OBJECTS, Part

DISTANCE = 2.0
"""Distance of all cameras, relative to the longest side of the front silhouette."""
VIEWS = ((45, 0), (90, 0), (135, 20), (180, 0), (225, 0), (270, 20), (315, 0), (20, 60))
"""Azimuth and elevation of the views that are hidden from `relief` [degrees]."""
FRONT, SMALL = 160, 112
"""Side of the front picture and of the other pictures [pixels]."""
NARROW = 30
"""Field of view of the front picture, degrees."""
WIDE = 38
"""Field of view of the other pictures, in which a solid is visible from all directions."""
FINE = 2
"""Rays per pixel and axis in the front picture; other pictures have one ray per pixel."""
LIGHT = np.array([0.6, -0.45, 0.66])
AMBIENT, DIFFUSE = 0.45, 0.6


@dataclass(frozen=True)
class Truth:
    """A solid as seen from all sides; the longest side of its front silhouette is 1 m."""

    front: NDArray[np.uint8]
    """The input of `relief` [FRONT,FRONT,4]."""
    pictures: NDArray[np.float32]
    """Colour on white and alpha [V,SMALL,SMALL,4] from `VIEWS`."""
    depth: float
    """Extent towards the viewer, m."""
    volume: float
    """m^3."""
    distances: NDArray[np.float32]
    """Depth map of the front picture [FRONT,FRONT], m towards the viewer; NaN outside."""
    side: NDArray[np.uint8]
    """The picture from azimuth 90, in which the object looks to the left [FRONT,FRONT,4]."""
    back: NDArray[np.uint8]
    """The picture from behind [FRONT,FRONT,4]."""


class Placed:
    """Parts, scaled by 1 / `scale` about `middle`."""

    def __init__(self, parts: Sequence[Part], middle: NDArray, scale: float) -> None:
        self.parts, self.middle, self.scale = parts, middle, scale

    def all(self, p: NDArray) -> NDArray[np.float64]:
        """Return the distances [K,N] from every part."""
        local = p * self.scale + self.middle
        return np.stack([item.distance(local) for item in self.parts]) / self.scale

    def __call__(self, p: NDArray) -> NDArray[np.float64]:
        return self.all(p).min(axis=0)

    def colour(self, p: NDArray) -> NDArray[np.float64]:
        """Return the lit colours [N,3] at points of the surface."""
        local, which = p * self.scale + self.middle, self.all(p).argmin(axis=0)
        paint = np.zeros_like(p)
        for k, item in enumerate(self.parts):
            if (which == k).any():
                paint[which == k] = item.paint(local[which == k])
        step = 2e-3 * np.eye(3)
        normal = np.stack([self(p + e) - self(p - e) for e in step], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        lit = 0.5 + 0.5 * normal @ (LIGHT / np.linalg.norm(LIGHT))
        return np.clip(paint * (AMBIENT + DIFFUSE * lit[:, None]), 0, 1)


def truth(name: str) -> Truth:
    """Return one of `OBJECTS` or `FLAT`.

    It is drawn at the first call, and read from the temporary folder later.
    """
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    folder = (
        Path(tempfile.gettempdir()) / f"phy124-truths-{hashlib.sha256(sources).hexdigest()[:12]}"
    )
    file = folder / f"{name.replace(' ', '_')}.npz"
    if not file.exists():
        folder.mkdir(exist_ok=True)
        made = _drawn((OBJECTS | FLAT)[name])
        np.savez_compressed(file, **vars(made))
    with np.load(file) as kept:
        return Truth(
            kept["front"],
            kept["pictures"],
            float(kept["depth"]),
            float(kept["volume"]),
            kept["distances"],
            kept["side"],
            kept["back"],
        )


def _drawn(parts: Sequence[Part]) -> Truth:
    solid = _placed(parts)
    step = 1.2 / 80
    points = (np.mgrid[:80, :80, :80].reshape(3, -1).T + 0.5) * step - 0.6
    inside = points[solid(points) < 0]
    picture, along = _picture(solid, Camera.orbit(0, 0, DISTANCE, FRONT * FINE, fov_y=NARROW))
    others = [
        _picture(solid, Camera.orbit(v, 0, DISTANCE, FRONT * FINE, fov_y=WIDE))[0]
        for v in (90, 180)
    ]
    views = [_picture(solid, Camera.orbit(*v, DISTANCE, SMALL, fov_y=WIDE))[0] for v in VIEWS]
    return Truth(
        _rounded(picture),
        np.stack(views).astype(np.float32),
        float(np.ptp(inside[:, 0])) + step,
        len(inside) * step**3,
        along[::FINE, ::FINE].astype(np.float32),
        *map(_rounded, others),
    )


def _placed(parts: Sequence[Part]) -> Placed:
    """Scale a solid to a front silhouette of 1 m, and centre its silhouette and its depth."""
    solid = Placed(parts, np.array([0.0, 0.0, 0.5]), 1.5)
    for _ in range(3):
        camera = Camera.orbit(0, 0, DISTANCE, 128, fov_y=60)
        hit = np.isfinite(_traced(solid, camera)[:, 0]).reshape(128, 128)
        edges = [np.flatnonzero(hit.any(axis=k))[[0, -1]] + [0, 1] for k in (0, 1)]
        low, high = (np.array(edges).T - 64) / camera.focal * DISTANCE
        points = (np.mgrid[:48, :48, :48].reshape(3, -1).T + 0.5) / 24 - 1
        deep = points[solid(points) < 0, 0]
        middle = np.array([deep.min() + deep.max(), low[0] + high[0], -low[1] - high[1]]) / 2
        scale = solid.scale * float((high - low).max())
        solid = Placed(parts, solid.middle + middle * solid.scale, scale)
    return solid


def _traced(solid: Placed, camera: Camera) -> NDArray[np.float64]:
    """Return the point that the ray of each pixel hits [N,3]; NaN if it hits nothing."""
    at = np.arange(camera.width) + 0.5 - camera.width / 2
    x, y = np.meshgrid(at, at)
    rays = np.stack([x, y, np.full_like(x, camera.focal)], axis=2).reshape(-1, 3)
    rays = rays @ camera.view[:3, :3]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = np.asarray(camera.eye) + (DISTANCE - 1.0) * rays
    going, hit = np.arange(len(rays)), np.zeros(len(rays), bool)
    for _ in range(120):
        near = solid(points[going])
        points[going] += 0.9 * near[:, None] * rays[going]
        hit[going[near < 1e-3]] = True
        far = ((points[going] - camera.eye) * rays[going]).sum(axis=1) > DISTANCE + 1.0
        going = going[(near >= 1e-3) & ~far]
        if not len(going):
            break
    return np.where(hit[:, None], points, np.nan)


def _picture(solid: Placed, camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return colour on white and hits [H,W,4], and x of the hit points [H,W], NaN elsewhere."""
    points = _traced(solid, camera)
    hit = np.isfinite(points[:, 0])
    picture = np.ones((len(points), 4))
    picture[hit, :3], picture[:, 3] = solid.colour(points[hit]), hit
    return picture.reshape(camera.height, -1, 4), points[:, 0].reshape(camera.height, -1)


def _rounded(fine: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.round(255 * _mean(fine)).astype(np.uint8)


def _mean(fine: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return straight colours and alpha, averaged over FINE x FINE rays per pixel."""
    size = len(fine) // FINE
    mean = fine.reshape(size, FINE, size, FINE, 4).mean(axis=(1, 3))
    alpha = mean[..., 3:]
    rgb = (mean[..., :3] - 1 + alpha) / np.maximum(alpha, 1e-9)
    return np.concatenate([np.clip(rgb, 0, 1), alpha], axis=2)
