"""Measures images and videos without trained weights."""

import math

import numpy as np
from numpy.typing import NDArray

Video = NDArray
"""Frames of a video [T,H,W,3], uint8 or float in 0..1."""
SIGMA = 1.5
"""Standard deviation of the Gaussian window that SSIM uses [pixels]."""
REACH = 5
"""Half width of the window that SSIM uses [pixels]; the window has 11 x 11 pixels."""
K1, K2 = 0.01, 0.03


def to_unit(images: NDArray) -> NDArray[np.float64]:
    """Convert uint8 or float images to float64 colours in 0..1."""
    images = np.asarray(images)
    return images / 255.0 if images.dtype == np.uint8 else images.astype(np.float64)


def psnr(a: NDArray, b: NDArray) -> float:
    """Return the peak signal-to-noise ratio of two images [dB]; infinite if they are equal."""
    error = float(np.mean((to_unit(a) - to_unit(b)) ** 2))
    return math.inf if error == 0 else -10 * math.log10(error)


def ssim(a: NDArray, b: NDArray) -> float:
    """Return the structural similarity of two images [H,W,C], -1 to 1.

    The index is defined by Wang et al. 2004, "Image Quality Assessment", with a Gaussian window of
    11 x 11 pixels. The result is the mean over the channels, and over all windows that lie inside
    the image.
    """
    import cv2

    x, y = to_unit(a), to_unit(b)

    def mean(values: NDArray) -> NDArray:
        return cv2.GaussianBlur(values, (2 * REACH + 1, 2 * REACH + 1), SIGMA)

    mx, my = mean(x), mean(y)
    vx, vy, vxy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    c1, c2 = K1**2, K2**2
    ratio = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    inside = ratio[REACH:-REACH, REACH:-REACH]
    return float(inside.mean()) if inside.size else float(ratio.mean())


def motion(video: Video) -> float:
    """Return the mean change of a colour value between consecutive frames, in % of its range.

    A frozen video has a perfect CLIP-T but no motion, so CLIP-T is meaningless without this value.
    """
    video = to_unit(video)
    return 100 * float(np.abs(np.diff(video, axis=0)).mean()) if len(video) > 1 else 0.0


def flicker(video: Video) -> float:
    """Return the oscillation of the frames' mean colour, in per cent of the colour range.

    Flicker is half the mean absolute second difference in time of each channel's mean. Flicker is 0
    if the mean changes at a constant rate, and 100 if the frames alternate between black and white.
    A moving object hardly changes the mean, so flicker does not measure motion.
    """
    colours = to_unit(video).mean(axis=(1, 2))
    return 50 * float(np.abs(np.diff(colours, n=2, axis=0)).mean()) if len(colours) > 2 else 0.0
