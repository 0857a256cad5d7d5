"""phy124.imaging.lab: the colours of the standards, and those of OpenCV."""

import cv2
import numpy as np
import pytest

from phy124.imaging.lab import to_lab


def lab_of(*rgb):
    return to_lab(np.array([[rgb]], np.uint8))[0, 0]


# Lindbloom's calculator, sRGB and D65.
@pytest.mark.parametrize(
    "rgb, wanted",
    [
        ((0, 0, 0), (0, 0, 0)),
        ((255, 255, 255), (100, 0, 0)),
        ((255, 0, 0), (53.24, 80.09, 67.20)),
        ((0, 255, 0), (87.73, -86.18, 83.18)),
        ((0, 0, 255), (32.30, 79.19, -107.86)),
        ((128, 128, 128), (53.59, 0, 0)),
        ((5, 5, 5), (1.37, 0, 0)),  # below both bends
    ],
)
def test_known_colours(rgb, wanted):
    np.testing.assert_allclose(lab_of(*rgb), wanted, atol=0.05)


def test_lab_agrees_with_opencv_within_its_tables(rng):
    picture = rng.integers(0, 256, (40, 50, 3), np.uint8)
    theirs = cv2.cvtColor(picture.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)
    ours = to_lab(picture)
    assert ours.dtype == np.float32 and ours.flags.c_contiguous
    np.testing.assert_allclose(ours, theirs, atol=0.6)
