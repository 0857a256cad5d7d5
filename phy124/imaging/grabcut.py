"""Segments the object of an image with GrabCut (Rother et al. 2004), without trained weights."""

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.image import is_blank, shrink
from phy124.imaging.lab import measure_change, to_lab

Field = NDArray[np.float32]
ROUNDS = 4
RING = 0.03
"""Width of the border that is assumed to be background, relative to the image's shorter side."""
COLOURS = 6
UNLIKE = 0.5
"""Smallest difference of a conspicuous region from the border; see `_unlikeness`."""
KEEP = 0.12
"""Smallest area of a piece that is kept, relative to the largest piece."""
PINHOLE = 0.004
"""Holes up to this area are closed, relative to the object's area. Larger holes, such as the gap in
a handle, stay open.
"""
SOFTNESS = 4
"""Radius of the guided filter that softens the object's edge [pixels]."""
HINT_REACH = 0.06
"""Distance at which a user's mark has an effect, relative to the image's longest side."""


def grabcut(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the alpha [H,W] of the object in an image [H,W,3]; the result is deterministic."""
    height, width = rgb.shape[:2]
    small = shrink(rgb)
    if is_blank(rgb):
        # OpenCV's graph cut does not terminate on some images of a single colour.
        return np.zeros((height, width), np.uint8)
    # Both k-means and GrabCut use the random number generator of OpenCV.
    cv2.setRNGSeed(0)
    smooth = cv2.bilateralFilter(small, 5, 30, 3)
    masks = [_clean_mask(_run_grabcut(smooth, labels)) for labels in _initial_labels(small)]
    mask = max(masks, key=lambda m: _plausibility(m, smooth))
    soft = _soften_edge(mask.astype(np.float32), small)
    full = cv2.resize(soft, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(np.rint(255 * full), 0, 255).astype(np.uint8)


def _run_grabcut(rgb: NDArray, labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    if not (labels & 1).any() or (labels & 1).all():
        return np.zeros_like(labels)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    # this argument is ignored if GrabCut starts from labels
    whole = (0, 0, rgb.shape[1], rgb.shape[0])
    labels, _, _ = cv2.grabCut(  # pyright: ignore[reportAssignmentType]
        rgb, labels, whole, models[0], models[1], ROUNDS, cv2.GC_INIT_WITH_MASK
    )
    return (labels & 1).astype(np.uint8)


def _initial_labels(rgb: NDArray) -> list[NDArray[np.uint8]]:
    border = _border_of(rgb)
    centre = _centrality(*rgb.shape[:2])
    unlike = _unlikeness(rgb, border)
    prior = cv2.GaussianBlur(unlike * centre, (0, 0), 0.015 * max(rgb.shape[:2]))
    level = np.clip(np.rint(255 * prior / max(float(prior.max()), 1e-6)), 0, 255).astype(np.uint8)
    threshold, _ = cv2.threshold(level[~border][None], 0, 255, cv2.THRESH_OTSU)
    contrast = level > threshold
    ellipse = centre > np.exp(-0.75)
    guesses = (contrast, ellipse, contrast | (ellipse & (unlike > 0.5)))
    return [_label(guess, border) for guess in guesses]


def _border_of(rgb: NDArray) -> NDArray[np.bool_]:
    ring = max(1, round(RING * min(rgb.shape[:2])))
    border = np.ones(rgb.shape[:2], bool)
    border[ring:-ring, ring:-ring] = False
    return border


def find_conspicuous(rgb: NDArray[np.uint8]) -> tuple[tuple[float, float], float] | None:
    """Find the largest region that differs from the border of an image [H,W,3].

    Returns:
        The region's innermost point, as fractions of the image's width and height, and the region's
        longest side, relative to the image's longest side; None if no region differs.
    """
    if is_blank(rgb):
        return None
    cv2.setRNGSeed(0)
    small = shrink(rgb)
    unlike = (_unlikeness(small, _border_of(small)) > UNLIKE).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(unlike, connectivity=8)
    if len(stats) < 2:
        return None
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    depth = cv2.distanceTransform((labels == largest).astype(np.uint8), cv2.DIST_L2, 5)
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    sides = stats[largest, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    point = (column + 0.5) / depth.shape[1], (row + 0.5) / depth.shape[0]
    return point, float(sides.max() / max(depth.shape))


def _label(guess: NDArray[np.bool_], border: NDArray[np.bool_]) -> NDArray[np.uint8]:
    labels = np.where(guess, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[border & ~guess] = cv2.GC_BGD
    return labels


def _plausibility(mask: NDArray[np.uint8], rgb: NDArray) -> float:
    fraction = float(mask.mean())
    if not 0.01 < fraction < 0.9:
        return 0.0
    outline = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    edge = float(np.minimum(measure_change(to_lab(rgb))[outline], 10).mean())
    points = cv2.findNonZero(mask)
    solidity = float(mask.sum()) / max(cv2.contourArea(cv2.convexHull(points)), 1.0)
    rim = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    return edge * solidity * (1 - float(rim.mean())) * fraction**0.25


def _unlikeness(rgb: NDArray, border: NDArray[np.bool_]) -> Field:
    """Return 1 - exp(-distance / 20) [H,W]; distances from the border's colours are in CIE Lab."""
    lab = to_lab(rgb)
    # Lightness has less weight, because shadows change the lightness of the background.
    lab[..., 0] *= 0.6
    samples = lab[border]
    count = min(COLOURS, len(samples))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    _, kinds, centres = cv2.kmeans(samples, count, None, criteria, 2, cv2.KMEANS_PP_CENTERS)  # pyright: ignore
    fraction = np.bincount(kinds.ravel(), minlength=count) / len(samples)
    centres = centres[fraction > 0.04]
    distance = np.linalg.norm(lab[..., None, :] - centres, axis=3).min(axis=2)
    return (1 - np.exp(-distance / 20)).astype(np.float32)


def _centrality(height: int, width: int) -> Field:
    y, x = np.mgrid[:height, :width].astype(np.float32)
    square = ((2 * x + 1) / width - 1) ** 2 + ((2 * y + 1) / height - 1) ** 2
    return np.exp(-square)


def _clean_mask(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    if not areas.any():
        return mask
    kept = (areas >= KEEP * areas.max())[labels].astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(1 - kept, connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] < PINHOLE * kept.sum()
    small[labels[kept > 0]] = False
    return np.where(small[labels], 1, kept).astype(np.uint8)


def _soften_edge(mask: Field, rgb: NDArray) -> Field:
    """Apply a guided filter (He et al. 2013)."""
    window = (2 * SOFTNESS + 1,) * 2
    guide = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255

    def mean(values: NDArray) -> Field:
        return cv2.blur(values, window)  # type: ignore[return-value]

    m, g = mean(mask), mean(guide)
    slope = (mean(mask * guide) - m * g) / (mean(guide * guide) - g * g + 1e-3)
    soft = mean(slope) * guide + mean(m - slope * g)
    # The mask is filtered only near the edge, because the filter leaves faint traces elsewhere.
    core = cv2.erode(mask, np.ones((5, 5), np.uint8))
    near = cv2.dilate(mask, np.ones((5, 5), np.uint8))
    sharp = np.clip((soft - 0.5) * 2 + 0.5, 0, 1)
    return np.where(core > 0, 1, np.where(near > 0, sharp, 0)).astype(np.float32)


def apply_marks(
    rgb: NDArray[np.uint8], alpha: NDArray[np.uint8], marks: NDArray
) -> NDArray[np.uint8]:
    """Correct an alpha [H,W] near marks [H,W], where 1 marks background and 2 marks the object."""
    height, width = rgb.shape[:2]
    small = shrink(rgb)
    if is_blank(rgb):
        return alpha
    size = small.shape[1::-1]
    before = (cv2.resize(alpha, size, interpolation=cv2.INTER_AREA) > 127).astype(np.uint8)
    hints = cv2.resize(marks.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    labels = np.where(before, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[hints == 1], labels[hints == 2] = cv2.GC_BGD, cv2.GC_FGD
    cv2.setRNGSeed(0)
    corrected = _run_grabcut(cv2.bilateralFilter(small, 5, 30, 3), labels)
    reach = 2 * round(HINT_REACH * max(size)) + 1
    near = cv2.dilate((hints > 0).astype(np.uint8), np.ones((reach, reach), np.uint8))
    changed = np.where((near > 0) & (corrected != before), 1.0, 0.0).astype(np.float32)
    soft = _soften_edge(np.where(near > 0, corrected, before).astype(np.float32), small)
    soft = cv2.resize(soft, (width, height), interpolation=cv2.INTER_CUBIC)
    use = cv2.resize(cv2.dilate(changed, np.ones((5, 5), np.uint8)), (width, height)) > 0
    return np.where(use, np.clip(np.rint(255 * soft), 0, 255), alpha).astype(np.uint8)
