"""Guesses the look of an object's unseen back from the image of the front.

A symmetric silhouette is assumed to be the front of an object. The back then has the colours near
the rim and fine texture, without the front's features. Other silhouettes are assumed to show the
object from a side. The back is then the mirrored front, because both sides of most objects look
alike.
"""

from typing import Literal

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.height import nearest_of

Field = NDArray[np.float64]
BackLook = Literal["auto", "mirror", "plain"]
SYMMETRIC = 0.86
"""Smallest overlap (IoU) of a front's silhouette with the mirror image."""
HANDLE, BODY = 0.4, 0.75
"""Largest thickness of handles, relative to the thickest part, and smallest area without handles,
relative to the silhouette.
"""
UPPER, OUTLINE, FACE = 0.4, 0.65, 0.75
"""Upper fraction of the height that may contain a face. The other values are the smallest overlap
(IoU) of a face with the mirror image, and the smallest correlation of the brightness.
"""
LARGE, FEWEST = 20.0, 50
"""Standard deviation of the filter that removes shading [pixels], and smallest number of compared
pixels.
"""
SHIFTS = 21
"""Number of candidate axes of symmetry."""
INSET = 0.03
"""Distance from the rim at which colours are read, relative to the image's size."""
SHORTER = 6.0
"""Exponent in the weights of a pixel's row and column; the shorter one has the larger weight."""
COARSE = 3.0
"""Standard deviation of the filter that separates colours from fine texture [pixels]."""
PATCH = 20
"""Side of a square patch of texture [pixels]."""
STEP = 10
"""Spacing of the patches on the back [pixels]."""
OFFSET = 3
"""Spacing of the patches on the front [pixels]."""
QUIET = 0.4
"""Fraction of the front's patches that may be copied: those with the least texture."""
STRONG = 0.07
"""Largest standard deviation of copied texture. Stronger texture is weakened, because it shows
edges of features.
"""
BINS = 10
"""Number of histogram bins per channel for a flat card's colours."""
ALIKE = 6
"""Number of similar front patches, of which one is chosen at random."""


def choose_look(rgba: Field) -> Literal["mirror", "plain"]:
    """Choose the look of the back: plain if the image [H,W,4] shows the front, otherwise mirrored.

    The image also shows the front if only the upper part is symmetric, such as a face above an
    outstretched arm.
    """
    solid = rgba[..., 3] > 0.5
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    rgba, solid = rgba[box], solid[box]
    if max(_fold(solid)[0], _fold(body_without_handles(solid))[0]) >= SYMMETRIC:
        return "plain"
    upper = solid[: max(1, round(UPPER * len(solid)))]
    columns = np.flatnonzero(upper.any(axis=0))
    box = np.s_[: len(upper), columns[0] : columns[-1] + 1]
    overlap, axis = _fold(upper[:, box[1]])
    alike = overlap >= OUTLINE and _alike(rgba[box], axis) >= FACE
    return "plain" if alike else "mirror"


def body_without_handles(solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a silhouette [H,W] without thin parts such as handles, and without empty columns at
    the sides.

    Thin parts are kept if they are large.
    """
    body = thick_parts(solid)
    columns = np.flatnonzero(body.any(axis=0))
    return solid if body is solid else body[:, columns[0] : columns[-1] + 1]


def thick_parts(solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a silhouette [H,W] without thin parts; thin parts are kept if they are large."""
    depth = nearest_of(~np.pad(solid, 1))[0][1:-1, 1:-1]
    radius = HANDLE * float(depth.max())
    body = nearest_of(depth >= radius)[0] <= radius
    return solid if np.count_nonzero(body) < BODY * np.count_nonzero(solid) else body


def _fold(solid: NDArray[np.bool_]) -> tuple[float, int]:
    """Return the largest overlap (IoU) of a silhouette with the mirror image, and twice the axis'
    distance from the middle of the image [pixels].
    """
    width, area = solid.shape[1], np.count_nonzero(solid)
    best, axis = 0.0, 0
    for shift in np.linspace(-width / 4, width / 4, SHIFTS).round().astype(int):
        there = _about(solid, shift)
        both = np.count_nonzero(there & there[:, ::-1])
        overlap = both / (2 * area - both)
        if overlap > best:
            best, axis = overlap, int(shift)
    return best, axis


def _about(values: NDArray, axis: int) -> NDArray:
    return np.pad(values, ((0, 0), (max(axis, 0), max(-axis, 0))))


def _alike(rgba: Field, axis: int) -> float:
    solid = _about(rgba[..., 3] > 0.5, axis).astype(np.float64)
    bright = _about(rgba[..., :3].mean(axis=2), axis) * solid
    weight = cv2.GaussianBlur(solid, (0, 0), LARGE)
    detail = cv2.GaussianBlur(bright, (0, 0), COARSE)
    detail = detail - cv2.GaussianBlur(bright, (0, 0), LARGE) / np.maximum(weight, 1e-3)
    both = cv2.erode(solid * solid[:, ::-1], np.ones((9, 9))) > 0
    here, there = detail[both], detail[:, ::-1][both]
    if len(here) < FEWEST or min(here.std(), there.std()) < 1e-6:
        return 0.0
    return float(np.corrcoef(here, there)[0, 1])


def plain_back(
    picture: Field,
    inside: NDArray[np.bool_],
    size: int,
    rng: np.random.Generator,
    turned: bool = False,
) -> Field:
    """Return colours [H,W,3] for the back without the front's features.

    Args:
        picture: Colours of the front [H,W,3], extrapolated beyond the silhouette.
        inside: Mask of the silhouette [H,W].
        size: Size of the object [pixels].
        rng: Random number generator.
        turned: Whether the object is a solid of revolution with a vertical axis.
    """
    smooth = smooth_back(picture, inside, size, turned)
    return np.clip(smooth + _texture(picture, smooth, inside, rng), 0, 1)


def _texture(
    picture: Field, smooth: Field, inside: NDArray[np.bool_], rng: np.random.Generator
) -> Field:
    """Copy fine texture [H,W,3] from patches of the front with similar colours.

    The weights of overlapping patches preserve the variance (Heitz, Neyret 2018).
    """
    coarse = cv2.GaussianBlur(picture, (0, 0), COARSE)
    fine = picture - coarse
    window = np.sin(np.pi * (np.arange(PATCH) + 0.5) / PATCH) ** 2
    window = np.outer(window, window)
    # Only patches that lie entirely inside the silhouette are used.
    whole = cv2.erode(np.pad(inside, 1).astype(np.uint8), np.ones((PATCH, PATCH), np.uint8))[
        1:-1, 1:-1
    ]
    places = np.argwhere(whole > 0) - PATCH // 2
    places = places[(places % OFFSET == 0).all(axis=1)]
    height, width = inside.shape
    within = (places >= 0).all(axis=1) & (places + PATCH <= (height, width)).all(axis=1)
    places = places[within]
    if len(places) < ALIKE:
        return np.zeros_like(picture)
    middles = tuple((places + PATCH // 2).T)
    strength = cv2.boxFilter((fine**2).sum(axis=2), -1, (PATCH, PATCH))[middles]
    quiet = strength <= np.quantile(strength, QUIET)
    places, colours = places[quiet], np.ascontiguousarray(coarse[middles][quiet].T)
    gains = np.minimum(1.0, STRONG / np.sqrt(strength[quiet] + 1e-9))
    total, weights = np.zeros_like(picture), np.full((height, width), 1e-6)
    for row in range(-STEP, height, STEP):
        for column in range(-STEP, width, STEP):
            top, left = max(row, 0), max(column, 0)
            bottom, right = min(row + PATCH, height), min(column + PATCH, width)
            if not inside[top:bottom, left:right].any():
                continue
            middle = min(max(row + STEP, 0), height - 1), min(max(column + STEP, 0), width - 1)
            far = ((colours - smooth[middle][:, None]) ** 2).sum(axis=0)
            alike = np.argpartition(far, min(ALIKE, len(far) - 1))[:ALIKE]
            chosen = rng.choice(alike)
            y, x = places[chosen]
            part = np.s_[top - row : bottom - row, left - column : right - column]
            patch = gains[chosen] * fine[y : y + PATCH, x : x + PATCH][part]
            total[top:bottom, left:right] += window[part][..., None] * patch
            weights[top:bottom, left:right] += window[part] ** 2
    return total / np.sqrt(weights)[..., None]


def card_back(picture: Field, inside: NDArray[np.bool_]) -> Field:
    """Return the front's most common colour everywhere [H,W,3]."""
    return np.broadcast_to(most_common(picture[inside]), picture.shape)


def most_common(colours: Field) -> Field:
    """Return the most common colour [3] of colours [N,3]."""
    count = np.histogramdd(colours, BINS, [(0.0, 1.0)] * 3)[0]
    count = scipy.ndimage.gaussian_filter(count, 0.7)
    most = (np.array(np.unravel_index(count.argmax(), count.shape)) + 0.5) / BINS
    far = np.abs(colours - most).max(axis=1)
    return np.median(colours[far <= max(1 / BINS, far.min())], axis=0)


def smooth_back(
    picture: Field, inside: NDArray[np.bool_], size: int, turned: bool = False
) -> Field:
    """Return the back [H,W,3]: colours near the rim, interpolated along rows and columns.

    Stripes therefore continue around the object, and features such as eyes do not appear.

    Args:
        picture: Colours of the front [H,W,3], extrapolated beyond the silhouette.
        inside: Mask of the silhouette [H,W].
        size: Size of the object [pixels].
        turned: Whether the object is a solid of revolution, so that colours are interpolated only
            along rows.
    """
    depth, _ = nearest_of(~inside)
    ridge = scipy.ndimage.maximum_filter(depth, size=2 * int(INSET * size) + 1)
    inner = depth >= np.minimum(INSET * size, 0.6 * ridge)
    _, nearest = nearest_of(inner & inside)
    rim = np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.5), np.float64)[nearest]
    thick = _thickness(depth)
    rows, wide = _between_ends(inside, rim, thick)
    mixed = rows
    if not turned:
        columns, high = _between_ends(inside.T, rim.swapaxes(0, 1), thick.T)
        across = 1 / (1 + (wide / np.maximum(high.T, 1.0)) ** SHORTER)[..., None]
        mixed = across * rows + (1 - across) * columns.swapaxes(0, 1)
    smooth = cv2.GaussianBlur(np.where(inside[..., None], mixed, rim), (0, 0), 6.0)
    return np.asarray(smooth, np.float64)


def _thickness(depth: Field) -> Field:
    """Return the local thickness [H,W]: the radius of the largest disc that covers the pixel, in 8
    levels.
    """
    thick = np.ones_like(depth)
    for radius in np.geomspace(1.5, max(2.0, float(depth.max())), 8)[:-1]:
        thick[nearest_of(depth >= radius)[0] <= radius] = radius
    return thick


def _between_ends(inside: NDArray[np.bool_], colours: Field, thick: Field) -> tuple[Field, Field]:
    """Interpolate colours [H,W,3] along each row's runs of object pixels; also return run lengths.

    The colours of thin features, such as a beak, have a smaller weight.
    """
    columns = np.arange(inside.shape[1])
    before = np.maximum.accumulate(np.where(inside, 0, columns), axis=1)
    after = np.minimum.accumulate(np.where(inside, len(columns) - 1, columns)[:, ::-1], axis=1)
    ends, total, weights = (before, after[:, ::-1]), np.zeros_like(colours), 0.0
    for end, step in zip(ends, (1, -1), strict=True):
        first = np.clip(end + step, 0, len(columns) - 1)
        far = np.maximum(np.abs(columns - end), 1) / np.take_along_axis(thick, first, axis=1)
        weight = (1 / far**2)[..., None]
        total += weight * np.take_along_axis(colours, first[..., None], axis=1)
        weights = weights + weight
    return total / weights, (ends[1] - before).astype(np.float64)
