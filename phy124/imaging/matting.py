"""Refines the edge of a cut-out, and removes the background's colours from the edge."""

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.imaging.image import reduce_size

Field = NDArray[np.float32]
SIDE = 640
REACH = 5
"""Radius of the filter's window [pixels of the reduced image]."""
SMOOTH = 1e-4
"""Edges are ignored if the variance of their colours (0..1) is below this value."""
DECIDED, SHARP = 2.0, 1.5
"""Factors by which the distance of alpha from 1/2 is multiplied: in the coarse mask, and in the
fitted alpha.
"""
OPAQUE = 243
"""Pixels with at least this alpha, 0..255, are assumed to contain no background colour."""
INSET = 1.0
"""Pixels at least this far inside the object have reliable colours [pixels of the reduced image].
"""


def fit_edge(rgb: NDArray[np.uint8], coarse: Field) -> NDArray[np.uint8]:
    """Fit a coarse mask [h,w] to the edges of an image [H,W,3]; return the alpha [H,W].

    This is a guided filter (He, Sun, Tang 2013) on the reduced image (He, Sun 2015).
    """
    height, width = rgb.shape[:2]
    size = reduce_size(rgb.shape, SIDE)
    small = np.asarray(
        cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32
    ) / np.float32(255)
    slope, offset = _fit_linear(small, _raise_contrast(resize(coarse, size), DECIDED))
    slope, offset = resize(slope, (width, height)), resize(offset, (width, height))
    fine = np.einsum("hwc,hwc->hw", slope, rgb, dtype=np.float32) / 255 + offset
    return np.rint(255 * _raise_contrast(fine, SHARP)).astype(np.uint8)


def resize(values: Field, size: tuple[int, int]) -> Field:
    """Interpolate values [h,w] or [h,w,C] linearly to a size (W, H)."""
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_LINEAR), np.float32)


def _fit_linear(guide: Field, mask: Field) -> tuple[Field, Field]:
    """Return slope [h,w,3] and offset [h,w] of the linear map from colours to the mask."""
    mean_guide, mean_mask = _mean(guide), _mean(mask)
    covariance = _mean(guide * mask[..., None]) - mean_guide * mean_mask[..., None]
    variance = _mean(_outer(guide).reshape(*mask.shape, 9)).reshape(*mask.shape, 3, 3)
    variance = variance - _outer(mean_guide) + SMOOTH * np.eye(3, dtype=np.float32)
    slope = np.linalg.solve(variance, covariance[..., None])[..., 0]
    offset = mean_mask - (slope * mean_guide).sum(axis=2)
    return _mean(slope), _mean(offset)


def _outer(v: Field) -> Field:
    return v[..., :, None] * v[..., None, :]


def _mean(values: Field) -> Field:
    return np.asarray(cv2.blur(values, (2 * REACH + 1,) * 2), np.float32)


def _raise_contrast(values: Field, factor: float) -> Field:
    return np.clip(factor * (values - 0.5) + 0.5, 0, 1)


def decontaminate(rgb: NDArray[np.uint8], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Remove the background's colours from a soft edge; return [H,W,3].

    Half-transparent pixels get the colour of the nearest opaque pixel slightly inside the object.
    """
    soft = (alpha > 0) & (alpha < OPAQUE)
    trusted = _find_trusted(alpha)
    if not soft.any() or not trusted.any():
        return rgb
    labels = cv2.distanceTransformWithLabels(
        _mask(~trusted), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )[1]
    nearest = np.asarray(labels, np.int32)
    colours = np.zeros((nearest.max() + 1, 3), np.uint8)
    colours[nearest[trusted]] = rgb[trusted]
    return np.where(soft[..., None], colours[nearest], rgb)


def _find_trusted(alpha: NDArray[np.uint8]) -> NDArray[np.bool_]:
    inset = max(INSET, INSET * max(alpha.shape) / SIDE)
    core = _depth(alpha >= OPAQUE) > inset
    depth = _depth(alpha > 127)
    ridge = (depth > 0) & (depth >= cv2.dilate(depth, np.ones((3, 3), np.uint8)))
    return core | (ridge & (_depth(~core) > 2 * inset + 2))


def _depth(inside: NDArray[np.bool_]) -> Field:
    return np.asarray(cv2.distanceTransform(_mask(inside), cv2.DIST_L2, 5), np.float32)


def _mask(chosen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return chosen.astype(np.uint8)
