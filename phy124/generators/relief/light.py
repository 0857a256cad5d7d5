"""Estimates the light from the shading in an image; the unseen back is shaded with this light.

The brightness of a pixel is modelled as albedo * exp(s . n). Here n is the unit normal of the
guessed solid, and s is a constant vector. The model is a first-order approximation of a Lambertian
surface under distant lights (Ramamoorthi, Hanrahan 2001). Pixels of similar hue are assumed to have
the same albedo. The fit favours small s, because n and the albedo may be correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.surface import Surface

Field = NDArray[np.float64]
HUES = 7
"""Number of groups of pixels by hue."""
GREY = 0.06
"""Saturation below which a pixel is grey."""
EVERY = 3
"""Spacing of the fitted pixels [pixels]."""
EDGE = 4
"""Width of the silhouette's edge that is not fitted [pixels]."""
DARKEST = 0.03
"""Constant that is added to the brightness before the logarithm."""
PRIOR = 0.3
"""Expected length of the light vector s."""
SAMPLES = 60.0
"""Number of independent samples in an image."""
LIMIT = 0.3
"""Largest absolute value of the two components of s that are perpendicular to the view."""
FRONTAL = 0.2
"""Largest component of s towards the camera. The smallest component is 0, because light is rarely
from behind.
"""
CERTAIN = (0.08, 0.16)
"""If the length of s is below the first value, s is ignored; above the second value, s is used
fully. A short s may be caused by colours.
"""
THICK = (8.0, 18.0)
"""If the largest half thickness [pixels] is below the first value, s is ignored; above the second
value, s is used fully. The normals of thin objects are uncertain.
"""
ROUNDS = 4


def fit_light(rgb: Field, surface: Surface, object_mask: NDArray[np.bool_]) -> Field:
    """Return the light vector s [3] of an image [H,W,3] of a surface's front."""
    shading = Shading.of(rgb, surface, object_mask)
    light = np.clip(shading.light, [-LIMIT, -LIMIT, 0.0], [LIMIT, LIMIT, FRONTAL])
    certain = np.interp(np.linalg.norm(light), CERTAIN, [0.0, 1.0])
    return light * certain * np.interp(np.sqrt(max(surface.w.max(), 0.0)), THICK, [0.0, 1.0])


@dataclass(frozen=True)
class Shading:
    """The light that best explains an image's brightness, and the quality of the fit."""

    light: Field
    """The light vector s [3]."""
    contrast: float
    """Standard deviation of s . n, the part of the logarithm of the brightness that the light
    explains.
    """
    total: float
    """Standard deviation of the logarithm of the brightness within groups of equal hue."""

    @classmethod
    def of(cls, rgb: Field, surface: Surface, object_mask: NDArray[np.bool_]) -> Shading:
        """Fit the light to an image [H,W,3] of a surface's front; all results are 0 for too few
        pixels.
        """
        seen = cv2.erode(object_mask.astype(np.uint8), np.ones((2 * EDGE + 1,) * 2)) > 0
        place = np.argwhere(seen)
        place = place[(place % EVERY == 0).all(axis=1)]
        if len(place) < HUES * HUES:
            return cls(np.zeros(3), 0.0, 0.0)
        normals = front_normals(surface)[tuple(place.T)]
        colours = rgb[tuple(place.T)]
        bright = np.log(colours.mean(axis=1) + DARKEST)
        group = _groups(colours)
        weights = np.ones(len(place))
        light, level, flat = np.zeros(3), bright, normals
        for _ in range(ROUNDS):
            share = np.maximum(np.bincount(group, weights, HUES), 1e-9)
            means = [np.bincount(group, weights * v, HUES) / share for v in (bright, *normals.T)]
            level, flat = bright - means[0][group], normals - np.stack(means[1:], axis=1)[group]
            noise = float(np.average((level - flat @ light) ** 2, weights=weights))
            damping = weights.sum() / SAMPLES * noise / PRIOR**2
            matrix = (flat * weights[:, None]).T @ flat + (damping + 1e-9) * np.eye(3)
            light = np.linalg.solve(matrix, flat.T @ (weights * level))
            residual = level - flat @ light
            width = 2 * np.median(np.abs(residual)) + 1e-3
            weights = 1 / (1 + (residual / width) ** 2)
        contrast, total = (
            float(np.sqrt(np.average(values**2, weights=weights)))
            for values in (flat @ light, level)
        )
        return cls(light, contrast, total)


def unlight(rgb: Field, surface: Surface, light: Field) -> Field:
    """Return the colours [H,W,3] of a surface's front without light."""
    return rgb * np.exp(-front_normals(surface) @ light)[..., None]


def front_normals(surface: Surface) -> Field:
    """Return unit normals [H,W,3] of the front; pixels outside get the rim's normals."""
    half = np.sqrt(np.maximum(surface.w, 0.25))
    across = [slope / (2 * half) + tilt for slope, tilt in zip(*surface.slopes, strict=True)]
    normals = np.stack([-across[0], -across[1], np.ones_like(half)], axis=2)
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def _groups(colours: Field) -> NDArray[np.int_]:
    """Return the group of each pixel [N]: 0 for grey, the other groups by hue."""
    red, green, blue = (colours / (colours.sum(axis=1, keepdims=True) + DARKEST)).T
    across, along = red - green, (red + green) / 2 - blue
    turn = np.arctan2(along, across) / (2 * np.pi) % 1.0
    return np.where(np.hypot(across, along) < GREY, 0, 1 + (turn * (HUES - 1)).astype(int))
