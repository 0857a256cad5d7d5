"""Recognises tables, stools and chairs by fitting them to a silhouette.

The fits start from coarse drawings of tables with many proportions and directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.tables import (
    CHAIR,
    ROUND_TABLES,
    SQUARE_TABLE,
    Kind,
    Sizes,
    Table,
    shrink,
)

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
OVERLAP = 0.85
"""Smallest overlap (IoU) of the silhouette with the table's image."""
CLEAR = 0.9
"""Smallest overlap for a silhouette that may instead show an animal or a vehicle. Silhouettes of
tables have an overlap of 0.97, and that of a bison 0.87.
"""
FIRST, MORE = 0.55, 0.05
"""A fit starts only from a coarse drawing with at least the overlap `FIRST`. The last fit is
assumed to increase the overlap by at most `MORE`. Silhouettes of tables have an overlap of at least
0.65 with a drawing, and that of a dog 0.5.
"""
SIMPLER = 0.01
"""Smallest increase of the overlap for which a more complex table is chosen."""
COARSE = 4
"""Reduction of images for the first fit."""
FINE = 2
"""Reduction of images for the last fit."""
BLUR = 1.5
"""Blur of the images, as a standard deviation [pixels]."""
TRIED = 4
"""Number of coarse drawings from which fits start, for each item of `SEEN`."""
ROUNDS, ATTEMPTS, DONE = 12, 4, 1e-3
"""Largest number of rounds, and largest number of attempts in a round; each further attempt takes a
shorter step.

A fit ends if the error decreases by less than the fraction `DONE`.
"""
GAP, LEGS = 0.12, 0.5
"""Limits for rows of a silhouette that show legs: the smallest number of such rows, relative to the
object's height, and the largest width of all legs together, relative to the object's width.
"""
ELEVATIONS = np.radians([3.0, 14.0, 25.0, 40.0])
QUARTER, FRONT = np.radians(np.arange(0, 90, 15)), np.radians(np.arange(-72, 90, 24))
SEEN = (
    (SQUARE_TABLE, QUARTER),
    *((kind, QUARTER) for kind in ROUND_TABLES),
    (CHAIR, FRONT),
    (CHAIR, FRONT + np.pi),
)
"""Kinds of tables, and the directions from which they may be seen [radians]."""
USUAL = Sizes(0, 0, 0, 0, 1, 1, 0.12, 0.08, 1, 1, 1, 1, 0.9, 0.95)
"""Usual proportions; lengths are relative to half the width of the top."""
CERTAIN = Sizes(4, 0, 0, 0, 0, 1.5, 2, 3, 0, 0, 3, 3, 5, 5)
"""Weights of the usual proportions."""
SQUARE_SEAT = 9.0
"""Weight of the usual depth for chairs, and for tops that are not rectangular. Seats are about
square.
"""
STEPS = Sizes(0.02, 0.02, 1, 1, 1, 1, 1, 0.5, 1, 1, 1, 0.02, 0.02, 0.02)
"""Changes of the sizes that move edges in the image by about a pixel."""
LEAST = Sizes(0, -np.inf, -np.inf, -np.inf, 8, 8, 2, 1.5, 8, 4, 4, 0.6, 0.4, 0.4)
MOST = Sizes(*[np.inf] * 14)._replace(elevation=0.7, rear=1.2, tops=1.0, feet=1.6)
"""Limits of the values."""
HIGHEST = 0.69
"""Largest elevation that can be estimated from a silhouette [radians]."""
THIN = 0.5
"""Largest thickness of a top, relative to the legs' length; the body of a car is thicker."""
SLENDER = 0.2
"""Largest half thickness of a leg, relative to half the top's side."""
LOW = 0.3
"""Smallest height of the legs, relative to half the top's side."""
INWARD = 0.9
"""Smallest distance of the feet from the centre, relative to the distance of the legs' upper ends.
"""


def find_table(
    object_mask: Mask,
    middle: Field,
    distance: float,
    elevation: float | None,
    least: float = OVERLAP,
) -> Table | None:
    """Return the table, stool or chair that a raised camera sees, or None.

    Args:
        object_mask: The silhouette [H,W].
        middle: Column and row at the centre of the image [2].
        distance: Distance of the camera [pixels].
        elevation: Elevation of the camera [radians]; None: estimated from the silhouette.
        least: Smallest overlap (IoU) of the silhouette with the table's image.
    """
    if not has_legs(object_mask):
        return None
    goal, fits, fixed = Goal.of(object_mask, middle), [], elevation is not None
    drawn = [_tables(kind, yaws, goal, distance, elevation) for kind, yaws in SEEN]
    for tables in drawn:
        tables.sort(key=goal.overlap, reverse=True)
    if max(goal.overlap(tables[0]) for tables in drawn) < FIRST:
        return None
    for tables in drawn:
        coarse = [goal.fit(table, COARSE, fixed) for table in tables[:TRIED]]
        fits.append(max(coarse, key=goal.overlap))
    if max(map(goal.overlap, fits)) < least - MORE:
        return None
    fits = [goal.fit(_without_lip(table), FINE, fixed) for table in fits]
    overlaps = [goal.overlap(table, 1) for table in fits]
    simple = [SIMPLER * _complexity(table) for table in fits]
    best = np.argmax(np.subtract(overlaps, simple))
    sizes = fits[best].sizes
    if not fixed and sizes.elevation > HIGHEST:
        return None  # the silhouette does not determine such an elevation
    return fits[best] if overlaps[best] >= least and _is_usual(sizes) else None


def has_legs(object_mask: Mask) -> bool:
    """Whether many lower rows of a silhouette [H,W] show several thin parts."""
    rows, wide = np.flatnonzero(object_mask.any(axis=1)), object_mask.any(axis=0).sum()
    low = object_mask[(rows[0] + rows[-1]) // 2 : rows[-1]]
    parts = np.count_nonzero(np.diff(low.astype(int), axis=1) > 0, axis=1)
    legs = (parts > 1) & (np.count_nonzero(low, axis=1) < LEGS * wide)
    return bool(np.count_nonzero(legs) >= GAP * len(rows))


@dataclass(frozen=True, eq=False)
class Goal:
    """The silhouette to which a table is fitted."""

    solid: Field
    """Silhouette [H,W] in 0..1; the sides are multiples of `COARSE`."""
    known: Field
    """0 in holes of the silhouette, such as those in a backrest, otherwise 1 [H,W]."""
    middle: Field
    """Column and row of the image's centre [2]."""

    @classmethod
    def of(cls, object_mask: Mask, middle: Field) -> Goal:
        """Return the target of the fit for a silhouette [H,W]."""
        more = [(0, -side % COARSE) for side in object_mask.shape]
        solid = np.pad(object_mask, more)
        holes = scipy.ndimage.binary_fill_holes(solid) & ~solid
        return cls(solid.astype(np.float64), 1.0 - holes, middle)

    @cached_property
    def extent(self) -> tuple[Field, Field]:
        """Centre and size of the bounding box, relative to the image's centre."""
        rows, columns = (np.flatnonzero(self.solid.any(axis=axis)) for axis in (1, 0))
        low, high = np.array([columns[0], rows[0]]), np.array([columns[-1], rows[-1]])
        return (low + high) / 2 - self.middle, high - low + 1.0

    def overlap(self, table: Table, scale: int = COARSE) -> float:
        """Return the overlap (IoU) of a table's image with the silhouette, without the pixels of
        its holes.
        """
        drawn = table.draw(self.solid.shape, self.middle, scale) > 0.5
        solid, known = (shrink(mask, scale) > 0.5 for mask in (self.solid, self.known))
        either = np.count_nonzero((drawn | solid) & known)
        return np.count_nonzero(drawn & solid) / max(1, either)

    def fit(self, table: Table, scale: int, fixed: bool) -> Table:
        """Return a table whose image differs less from the silhouette.

        The fit is damped (Levenberg 1944, Marquardt 1963). `fixed` keeps the elevation of the
        camera.
        """
        weight = shrink(self.known, scale)
        target = cv2.GaussianBlur(shrink(self.solid, scale), (0, 0), BLUR)
        changed = [not fixed, *[True] * 8, *[table.kind.backed] * 2, len(table.kind.top) == 4]
        steps = np.diag(STEPS)[[*changed, True, True]] * (2 if scale == COARSE else 1)

        def make(values: Field) -> Table:
            return replace(table, sizes=Sizes(*values.tolist()))

        def errors(values: Field) -> Field:
            drawn = make(values).draw(self.solid.shape, self.middle, scale)
            apart = weight * (cv2.GaussianBlur(drawn, (0, 0), BLUR) - target)
            return np.concatenate([apart.ravel(), 3 / scale * _unusual(make(values))])

        most = MOST._replace(elevation=np.inf) if fixed else MOST
        values, damping = np.array(table.sizes), 1e-2
        error = errors(values)
        for _ in range(ROUNDS):
            slopes = np.stack([errors(values + step) - error for step in steps])
            matrix, slope, before = slopes @ slopes.T, slopes @ error, error @ error
            for _ in range(ATTEMPTS):
                damped = matrix + damping * np.diag(np.diag(matrix) + 1e-6)
                moved = np.clip(values - np.linalg.solve(damped, slope) @ steps, LEAST, most)
                after = errors(moved)
                if after @ after < before:
                    values, error, damping = moved, after, damping / 4
                    break
                damping *= 8
            if before - error @ error <= DONE * before:
                break
        return make(values)


def _without_lip(table: Table) -> Table:
    lip = table.kind.backed and table.sizes.back <= LEAST.back
    return replace(table, kind=SQUARE_TABLE) if lip else table


def _complexity(table: Table) -> int:
    """Return 0 for a round top, 1 for a top with corners, 2 for a chair, 3 for a chair seen from
    behind.
    """
    away = table.kind.backed and np.cos(table.sizes.yaw) < 0
    return (len(table.kind.top) == len(SQUARE_TABLE.top)) + table.kind.backed + int(away)


def _is_usual(s: Sizes) -> bool:
    short, long = sorted([s.half, s.deep])
    return (
        s.thick < THIN * s.high
        and s.leg < SLENDER * short
        and s.high > LOW * long
        and s.feet > INWARD * s.tops
    )


def _unusual(table: Table) -> Field:
    s = table.sizes
    lengths = np.log([s.deep, s.thick, s.leg, s.wide / s.rear]) - np.log(s.half)
    numbers = [Sizes._fields.index(name) for name in ("deep", "thick", "leg", "wide")]
    others = [Sizes._fields.index(name) for name in ("elevation", "rear", "tops", "feet")]
    certain, usual = np.array(CERTAIN), np.array(USUAL)
    if table.kind.backed or table.kind.top is not SQUARE_TABLE.top:
        certain[numbers[0]] = SQUARE_SEAT
    apart = np.concatenate([lengths - np.log(usual[numbers]), np.array(s)[others] - usual[others]])
    return certain[[*numbers, *others]] * apart


def _tables(
    kind: Kind, yaws: Field, goal: Goal, distance: float, elevation: float | None
) -> list[Table]:
    depths = (0.6, 1.0, 1.6) if kind is SQUARE_TABLE else (1.0,)
    backs = (0.6, 1.1) if kind.backed else (0.0,)
    raised = ELEVATIONS.tolist() if elevation is None else [elevation]
    return [
        _match_extent(Table(kind, Sizes(up, yaw, *USUAL[2:]), distance), goal, deep, back)
        for up, yaw, deep, back in product(raised, yaws, depths, backs)
    ]


def _match_extent(table: Table, goal: Goal, deep: float, back: float) -> Table:
    """Scale and move a table to the width and height of the silhouette.

    Args:
        table: The table.
        goal: The silhouette.
        deep: Depth of the top, relative to the width.
        back: Height of the backrest, relative to the legs.
    """
    centre, (width, height) = goal.extent
    half, high, up = width / 2.5, height / 2, table.sizes.elevation
    for _ in range(4):
        lengths = {name: half * getattr(USUAL, name) for name in ("half", "thick", "leg", "wide")}
        table = table.resize(**lengths, deep=deep * half, high=high, back=back * high + 4.0)
        size = np.ptp(table.places, axis=0)
        half *= width / size[0]
        missing = height - size[1] * width / size[0]
        high = max(0.3 * half, high + missing / np.cos(up) / (1 + back))
    places = table.places
    right, down = centre - (places.min(axis=0) + places.max(axis=0)) / 2
    return table.resize(right=right, down=down / np.cos(up))
