"""Removes the perspective from the front and side images, as if the cameras were at infinity.

A row of the object appears larger if it is nearer to the camera. The other image shows how near the
row is.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Field = NDArray[np.float64]
ROUNDS = 8
"""Number of iterations that match the heights in both images."""
SMOOTHING = 0.04
"""Standard deviation of the filter that smooths the rows' depths, relative to the object's height.
"""
END = 0.05
"""Rows are near a flat end if they are closer to it than this, relative to the object's height."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A silhouette from one side, inflated to a solid."""

    w: Field
    """Squared half thickness [H,W], pixels^2; negative outside, and extended beyond flat ends."""
    middle: tuple[float, float]
    """Column and row of the object's centre."""
    half: float
    """Half the object's height without extensions [pixels]."""
    ends: tuple[bool, bool]
    """Whether the top is flat, and whether the bottom is flat."""

    def nearness(self, y: Field, distance: float) -> tuple[Field, Field]:
        """Return the positions of each row's thickest point and nearest edge, along the axis
        towards the other camera.

        `y` [N] are rows relative to the object's centre; the camera's `distance` is in pixels.
        """
        columns = np.arange(self.w.shape[1]) - self.middle[0]
        far = 1 - columns / distance
        # distances are measured along the view rays
        heights = (np.arange(len(self.w)) - self.middle[1])[:, None] * far
        place = np.broadcast_arrays(heights + self.middle[1], columns + self.middle[0])
        along = scipy.ndimage.map_coordinates(self.w, place, order=1)
        thick = np.sqrt(np.maximum(along, 0.0)) / far
        solid = self.w > 0
        known = solid.any(axis=1)
        contact = columns[thick.argmax(axis=1)]
        edge = columns[::-1][solid[:, ::-1].argmax(axis=1)]
        rows, width = np.arange(len(self.w)) - self.middle[1], SMOOTHING * 2 * self.half
        contact, edge = (
            np.interp(
                y, rows[known], scipy.ndimage.gaussian_filter1d(v[known], width, mode="nearest")
            )
            for v in (contact, edge)
        )
        return contact, edge


@dataclass(frozen=True)
class Rows:
    """Maps heights of the object to rows of an image."""

    k: Field
    """Number of image pixels per object pixel at each height [N]."""
    shift: float = 0.0
    """Row of the image at height 0, relative to the object's centre."""

    def rows(self, y: Field) -> Field:
        """Return the image rows of heights y [N], relative to the object's centre."""
        return y * self.k + self.shift


def match_heights(front: Profile, side: Profile, distance: float) -> tuple[Field, Rows, Rows]:
    """Return heights of the object [N], and the maps from heights to rows of both images.

    The side's columns increase towards the front camera; the cameras' `distance` is in pixels.
    """
    y = np.arange(-np.ceil(front.half) - 3, np.ceil(front.half) + 4)
    front_rows, side_rows, scale = Rows(np.ones_like(y)), Rows(np.ones_like(y)), 1.0
    for _ in range(ROUNDS):
        x, right = front.nearness(front_rows.rows(y), distance)
        z, near = side.nearness(side_rows.rows(y), distance)
        ends = _ends(front, side, y)
        k_front = 1 / (1 - np.where(ends, near, z) / side_rows.k / distance)
        k_side = 1 / (1 - np.where(ends, right, x) / front_rows.k / distance)
        top, bottom = (sign * front.half / k_front[at] for sign, at in ((-1, 3), (1, -4)))
        y = np.linspace(top, bottom, len(y) - 6)
        step = y[1] - y[0]
        y = np.concatenate([top + step * np.arange(-3, 0), y, bottom + step * np.arange(1, 4)])
        upper, lower = top * k_side[3], bottom * k_side[-4]
        scale = 2 * side.half / (lower - upper)
        front_rows = Rows(k_front)
        side_rows = Rows(scale * k_side, side.half - scale * lower)
    return y, front_rows, side_rows


def _ends(front: Profile, side: Profile, y: Field) -> NDArray[np.bool_]:
    """Return whether each height [N] is near a flat end."""
    reach = (y[-1] - y[0]) * END
    top, bottom = (any(flat) for flat in zip(front.ends, side.ends, strict=True))
    return (top & (y < y[0] + reach)) | (bottom & (y > y[-1] - reach))


def straighten(profile: Profile, y: Field, rows: Rows) -> Field:
    """Return squared half thicknesses [N,W] at heights y [N]. W is odd, and the object's centre is
    in the middle column.
    """
    column = np.flatnonzero((profile.w > 0).any(axis=0)) - profile.middle[0]
    reach = int(np.ceil(np.abs(column).max() / rows.k.min())) + 4
    columns = np.arange(-reach, reach + 1)
    place = np.stack(
        [
            np.broadcast_to((rows.rows(y) + profile.middle[1])[:, None], (len(y), len(columns))),
            columns * rows.k[:, None] + profile.middle[0],
        ]
    )
    w = scipy.ndimage.map_coordinates(profile.w, place, order=1, mode="nearest")
    return w / rows.k[:, None] ** 2
