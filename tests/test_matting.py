"""The edge of a cut-out: fitted to the picture, and free of the background's colours."""

import numpy as np
import pytest
from PIL import Image

from phy124.imaging.cutout import clean_edge, foreground
from phy124.imaging.matting import decontaminate, fit_edge

RED, GREEN = np.array([200.0, 40, 30]), np.array([30.0, 190, 60])


def disc(side=400, softness=2.0):
    """A red disc on green with a soft edge: its picture [S,S,3], and its alpha [S,S] in 0..1."""
    y, x = np.mgrid[:side, :side] + 0.5
    alpha = np.clip((0.3 * side - np.hypot(x - 0.55 * side, y - 0.5 * side)) / softness + 0.5, 0, 1)
    rgb = alpha[..., None] * RED + (1 - alpha[..., None]) * GREEN
    return np.rint(rgb).astype(np.uint8), alpha


@pytest.mark.parametrize("side", [400, 1000])
def test_a_coarse_mask_is_fitted_to_the_edge_of_the_picture(side):
    rgb, alpha = disc(side)
    coarse = Image.fromarray((255 * alpha).astype(np.uint8)).resize((40, 40))
    coarse = np.asarray(coarse, np.float32) / 255
    blurred = np.asarray(Image.fromarray(coarse).resize((side, side)))
    fine = fit_edge(rgb, coarse) / 255
    before, after = (np.abs(mask - alpha).sum() / alpha.sum() for mask in (blurred, fine))
    assert after < 0.02 and after < before / 2.5
    assert fine[0, 0] == 0 and fine[side // 2, side // 2] == 1


def share_of_green(rgb, where):
    """Return the fraction of the background's colour in pixels."""
    return ((rgb[where] - RED) @ (GREEN - RED)).mean() / ((GREEN - RED) ** 2).sum()


def test_soft_pixels_show_nothing_of_the_background():
    rgb, alpha = disc(softness=6.0)
    alpha = np.rint(255 * alpha).astype(np.uint8)
    soft = (alpha > 0) & (alpha < 250)
    assert share_of_green(rgb, soft) > 0.3
    clean = decontaminate(rgb, alpha)
    assert abs(share_of_green(clean, soft)) < 0.01
    untouched = (alpha == 0) | (alpha == 255)
    np.testing.assert_array_equal(clean[untouched], rgb[untouched])


def test_parts_too_thin_to_be_opaque_keep_their_colours():
    """A blue thread hangs from a red disc."""
    rgb, alpha = disc(softness=1.0)
    alpha = np.rint(255 * alpha).astype(np.uint8)
    rgb[300:380, 219:222], alpha[300:380, 219:222] = (40, 60, 220), (140, 230, 140)
    clean = decontaminate(rgb, alpha)
    np.testing.assert_allclose(clean[345:375, 219:222], [[[40, 60, 220]] * 3] * 30)


@pytest.mark.parametrize("alpha", [0, 128, 255])
def test_an_alpha_without_an_inside_leaves_colours_alone(alpha):
    rgb, _ = disc(40)
    flat = np.full((40, 40), alpha, np.uint8)
    clean = decontaminate(rgb, flat)
    assert clean.shape == rgb.shape
    if alpha != 128:
        np.testing.assert_array_equal(clean, rgb)


def test_matting_cleans_masks_but_not_real_alpha():
    rgb, alpha = disc(softness=6.0)
    mask = Image.fromarray(np.rint(255 * alpha).astype(np.uint8))
    soft = (np.asarray(mask) > 127) & (np.asarray(mask) < 250)
    cutout = foreground(Image.fromarray(rgb), mask=mask)
    assert abs(share_of_green(np.asarray(cutout.picture)[..., :3], soft)) < 0.01
    picture = Image.fromarray(rgb)
    picture.putalpha(mask)
    assert foreground(picture).method == "alpha"
    np.testing.assert_array_equal(np.asarray(foreground(picture).picture), np.asarray(picture))
    assert clean_edge(picture, np.asarray(mask)).mode == "RGBA"
