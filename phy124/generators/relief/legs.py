"""Finds the legs and wheels of objects seen from the side, and duplicates them on both sides.

The object is symmetric about the image plane, so legs and wheels are in pairs on both sides of the
plane. The arch is the largest gap between the parts on the ground. A wide arch separates the
forelegs from the hind legs. A pointed arch separates two single legs, such as a bird's legs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.ends import Continued
from phy124.generators.relief.parts import inflate_part, keep
from phy124.generators.relief.shell import DRAWN_IN, Shell, join
from phy124.generators.relief.surface import Surface, View
from phy124.generators.relief.thin import circles_on_ground

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
GROUND = 0.06
"""Largest height of a foot above the ground, relative to the object's height."""
LOWEST = 0.08
"""Smallest height of the arch, relative to the object's height."""
HIGHEST = 0.65
"""Largest height of the arch, relative to the object's height."""
ARCHED = 0.5
"""The top of a wide arch is the first row with at least this width, relative to the largest
width.
"""
UPPER, WIDE = 0.25, 0.5
"""The width of an arch is measured at the distance `UPPER` from its top, relative to its height. An
arch is wide if this width is at least `WIDE`, relative to the largest width.
"""
WHEEL = 0.5
"""Thickness of a wheel, relative to the diameter."""
LENGTH = 1.3
"""Smallest ratio of width to height of a symmetric object seen from the side."""
TALLEST = 1.2
"""Largest ratio of height to width of an object with four legs; persons have larger ratios."""
LARGEST = 0.37
"""Largest fraction of the silhouette that belongs to legs."""
SPAN = 0.37
"""Smallest distance between forelegs and hind legs, relative to the object's width."""
THICKEST = 0.35
"""Largest mean width of the legs on one side of the arch, relative to the object's width."""
SEPARATE = 0.4
"""Smallest height of a gap between two legs, relative to the arch's height."""
FLARED = 2.5
"""Largest width of a leg's upper half, relative to the median width of the lower half."""
LONG = 1.2
"""Smallest ratio of height to width of a leg; lower parts, such as wheels, are placed on both
sides.
"""
ROOT = 0.5
"""Height of the part of a leg that is inside the body, relative to the body's height."""
ROOTED = 0.6
"""Largest half width of a leg inside the body, relative to the leg's mean width."""
APART = 0.55
"""Distance of the legs from the middle plane, relative to the body's half thickness."""
FEWEST = 16
"""Smallest height and width of an object with legs [pixels], and smallest number of points of a
leg.
"""
SMALLEST = 64
"""Smallest area of a leg [pixels^2]."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A leg or a wheel in the image."""

    part: Mask
    """Mask of the leg, also inside the body [H,W]."""
    foot: float
    """Lowest row [pixels]."""
    sides: tuple[int, ...]
    """1 for the side towards the camera, -1 for the other side."""


@dataclass(frozen=True, eq=False)
class Legs:
    """The legs of an object, and the body."""

    rgba: Field
    """Image of the whole object [H,W,4]."""
    body: Mask
    """Mask of the object without legs [H,W]."""
    legs: tuple[Leg, ...]

    @property
    def object_mask(self) -> Mask:
        """Mask of the whole object [H,W]."""
        return self.rgba[..., 3] > 0.5

    @property
    def is_long(self) -> bool:
        """Whether the object is much wider than high, and has legs at both ends."""
        rows, columns = (np.flatnonzero(self.object_mask.any(axis=axis)) for axis in (1, 0))
        long = bool(np.ptp(columns) + 1 > LENGTH * (np.ptp(rows) + 1))
        return long and all(len(leg.sides) > 1 for leg in self.legs)

    @property
    def trunk(self) -> Continued:
        """The image of the body without the legs."""
        alpha = np.where(self.body, self.rgba[..., 3], 0.0)
        return Continued(np.dstack([self.rgba[..., :3], alpha]), alpha, ())

    @cached_property
    def wheeled(self) -> bool:
        """Whether all legs are wheels, with arcs of circles as lower outlines."""
        discs = circles_on_ground(self.object_mask, free=0.0)
        middles = [np.flatnonzero(leg.part.any(axis=0)).mean() for leg in self.legs]
        return all(
            len(leg.sides) > 1 and any(abs(disc.x - middle) < disc.radius / 2 for disc in discs)
            for leg, middle in zip(self.legs, middles, strict=True)
        )

    @property
    def share(self) -> float:
        """Fraction of the surface that belongs to legs."""
        legs = sum(np.count_nonzero(leg.part) * len(leg.sides) for leg in self.legs)
        return legs / (legs + np.count_nonzero(self.body))

    def join(
        self,
        body: Shell,
        surface: Surface,
        view: View,
        front: Field,
        rng: np.random.Generator,
    ) -> Shell:
        """Return the shell of body and legs; no point of a leg lies inside the body.

        Args:
            body: Shell of the body.
            surface: Surface of the body.
            view: The front camera.
            front: Colours of the image [H,W,3].
            rng: Random number generator.
        """
        ground = max(leg.foot for leg in self.legs) - view.middle[1]
        density = len(body.points) / np.count_nonzero(self.body)
        shells = [body]
        for leg in self.legs:
            part = np.where(leg.part, self.rgba[..., 3], 0.0)
            count = max(FEWEST, round(density * np.count_nonzero(leg.part)))
            shell, thick = inflate_part(part, front, view, count, rng)
            deep = float(np.sqrt(max(surface.w[leg.part].max(), 0.0)))
            thick *= WHEEL if self.wheeled else 1.0
            away = max(0.0, deep - thick if self.wheeled else min(APART * deep, deep - thick))
            flat = shell.scale_depth(WHEEL) if self.wheeled else shell
            near = 1 - away / view.distance
            # The near legs stand on the ground, and so does a leg that exists only on the far side.
            foot = max(leg.foot - view.middle[1], 1.0)
            far = float(np.clip(near * ground / foot, near, 2 - near))
            for side in leg.sides:
                moved = _move(flat, near if 1 in leg.sides else far, side, away)
                shells.append(_outside(moved, surface, view))
        return join(*shells)


def _move(shell: Shell, scale: float, side: int, away: float) -> Shell:
    """Scale a shell, and move it away from the middle plane; on the far side, the shell is
    mirrored.
    """
    turn = np.array([1.0, 1.0, side])
    points = (scale * shell.points + [0.0, 0.0, away]) * turn
    return replace(
        shell, points=points, normals=shell.normals * turn, spacing=scale * shell.spacing
    )


def _outside(shell: Shell, surface: Surface, view: View) -> Shell:
    z = shell.points[:, 2:]
    places = shell.points / np.concatenate([view.k(z), view.k(z), np.ones_like(z)], axis=1)
    value, gradient = surface.gradient(places + view.middle)
    return keep(shell, value < DRAWN_IN * np.linalg.norm(gradient, axis=1))


def find_legs(rgba: Field) -> Legs | None:
    """Return the legs of an object that an image [H,W,4] shows from the side, or None."""
    object_mask = rgba[..., 3] > 0.5
    rows, columns = (np.flatnonzero(object_mask.any(axis=axis)) for axis in (1, 0))
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    if min(height, width) < FEWEST:
        return None
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    solid = object_mask[box]
    low = height - max(1, round(GROUND * height))
    gaps = _gaps(solid[:low])
    if not gaps:
        return None
    arch = max(gaps, key=np.count_nonzero)
    widths = np.count_nonzero(arch, axis=1)
    top = int((widths > 0).argmax())
    tall, widest = low - top, int(widths.max())
    if not LOWEST * height <= tall <= HIGHEST * height:
        return None
    if widths[top + int(UPPER * tall)] < WIDE * widest:
        return _divide(rgba, box, gaps, arch, top, wide=False)
    top = int((widths >= ARCHED * widest).argmax())
    return _divide(rgba, box, gaps, arch, top, wide=True)


def _gaps(solid: Mask) -> list[Mask]:
    """Return masks [H,W] of the gaps: parts of the background that touch the last row, but no other
    side of the image.
    """
    parts, _ = scipy.ndimage.label(~solid)  # pyright: ignore
    outer = {*parts[0], *parts[:, 0], *parts[:, -1]}
    return [parts == number for number in set(parts[-1]) - outer - {0}]


def _divide(
    rgba: Field,
    box: tuple[slice, slice],
    gaps: list[Mask],
    arch: Mask,
    top: int,
    *,
    wide: bool,
) -> Legs | None:
    """Divide an image [H,W,4] below the top of an arch; return None if the parts are too wide."""
    object_mask = rgba[..., 3] > 0.5
    solid = object_mask[box]
    height, width = solid.shape
    low, tall = len(arch), len(arch) - top
    below, _ = scipy.ndimage.label(solid & (np.arange(height)[:, None] >= top))  # pyright: ignore
    middle = int(np.flatnonzero(arch.any(axis=0)).mean())
    body, groups, places = object_mask.copy(), [], []
    for half in (np.s_[:middle], np.s_[middle:]):
        feet = {*below[low - 1, half]} - {0}
        part = np.isin(below, list(feet))
        if not feet or np.count_nonzero(part) > THICKEST * width * tall:
            return None
        inner = [gap for gap in gaps if gap is not arch and gap[-1, half].any()]
        pieces = [_slender(piece) for piece in _separate(part, inner, tall)]
        if min(np.count_nonzero(piece) for piece in pieces) < SMALLEST:
            return None
        body[box] &= ~np.any(pieces, axis=0)
        groups.append(pieces)
        places.append(np.flatnonzero(part.any(axis=0)).mean())
    if np.count_nonzero(body) < (1 - LARGEST) * np.count_nonzero(object_mask):
        return None
    if not wide or height > TALLEST * width or places[1] - places[0] < SPAN * width:
        groups = [[*groups[0], *groups[1]]]
        if not _are_long(groups[0]):
            return None
    made = []
    for group in groups:
        feet = [int(np.flatnonzero(piece.any(axis=1))[-1]) for piece in group]
        sides = [(1, -1)] * len(group)
        if len(group) > 1 and _are_long(group):
            near = int(np.argmax(feet)) % 2
            sides = [(1,) if number % 2 == near else (-1,) for number in range(len(group))]
        for piece, foot, side in zip(group, feet, sides, strict=True):
            whole = np.zeros_like(object_mask)
            whole[box] = piece | _root(solid, piece)
            made.append(Leg(whole, box[0].start + foot + 0.5, side))
    return Legs(rgba, body, tuple(made))


def _separate(part: Mask, gaps: list[Mask], tall: int) -> list[Mask]:
    pieces, columns = [part], np.arange(part.shape[1])
    for gap in gaps:
        if np.count_nonzero(gap.any(axis=1)) < SEPARATE * tall:
            continue
        middle = np.flatnonzero(gap[gap.any(axis=1).argmax()]).mean()
        halves = columns < middle, columns >= middle
        divided = [piece & half for piece in pieces for half in halves]
        pieces = [piece for piece in divided if piece.any()]
    return pieces


def _slender(piece: Mask) -> Mask:
    widths = np.count_nonzero(piece, axis=1)
    first, last = np.flatnonzero(widths)[[0, -1]]
    middle = (first + last + 1) // 2
    wide = widths[first:middle] > FLARED * np.median(widths[middle : last + 1])
    start = first + (np.flatnonzero(wide)[-1] + 1 if wide.any() else 0)
    return piece & (np.arange(len(piece)) >= start)[:, None]


def _are_long(pieces: list[Mask]) -> bool:
    for piece in pieces:
        high = np.count_nonzero(piece.any(axis=1))
        if high**2 < LONG * np.count_nonzero(piece):
            return False
    return True


def _root(solid: Mask, piece: Mask) -> Mask:
    rows = np.flatnonzero(piece.any(axis=1))
    top, columns = rows[0], np.flatnonzero(piece[rows[0]])
    middle, mean = columns.mean(), np.count_nonzero(piece) / len(rows)
    start = int(max(columns[0], np.rint(middle - ROOTED * mean)))
    end = int(min(columns[-1], np.rint(middle + ROOTED * mean))) + 1
    above = solid[:top, (start + end) // 2][::-1]
    length = len(above) if above.all() else int((~above).argmax())
    root = np.zeros_like(solid)
    root[top - round(ROOT * length) : top, start:end] = True
    return root & solid
