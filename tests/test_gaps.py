"""Gaps that a network fills are opened on plain backgrounds, and white objects stay whole."""

import cv2
import numpy as np

from phy124.imaging.gaps import open_gaps

Y, X = np.mgrid[:240, :240]
AWAY = np.hypot(X - 120, Y - 120)
DISC = (AWAY < 70).astype(np.float32)
GROUND = np.dstack([150 + Y / 20, 170 + Y / 24, 200 - Y / 30])


def painted(colours, where, colour):
    """Return colours [H,W,3] with noise, and another colour in a mask [H,W]."""
    noise = np.random.default_rng(0).normal(0, 2, colours.shape)
    shown = np.where(where[..., None], colour, colours) + noise
    return np.clip(shown, 0, 255).astype(np.uint8)


def test_the_background_inside_a_wheel_becomes_transparent():
    tyre = (AWAY < 70) & (AWAY > 60)
    mask = open_gaps(painted(GROUND, tyre, [25, 25, 30]), DISC)
    np.testing.assert_array_equal((mask > 0.5)[AWAY < 57], False)
    assert (mask > 0.5)[tyre & (AWAY > 63)].all()


def test_mask_keeps_its_size_if_it_is_larger_than_the_reduced_image():
    tyre = (AWAY < 70) & (AWAY > 60)
    rgb = painted(GROUND, tyre, [25, 25, 30])
    for side, kept in ((80, 240), (960, 960)):
        shown = cv2.resize(rgb, (max(side, 240),) * 2, interpolation=cv2.INTER_CUBIC)
        mask = open_gaps(shown, cv2.resize(DISC, (side, side)))
        assert mask.shape == (kept, kept)
        scale = kept / 240
        assert mask[round(120 * scale), round(120 * scale)] == 0
        assert mask[round(120 * scale), round((120 + 65) * scale)] > 0.5


def test_highlights_and_other_colours_stay_opaque():
    wheel = (AWAY < 70) & (AWAY > 60)
    lid = painted(np.where((AWAY <= 60)[..., None], GROUND - [0, 20, 0], GROUND), wheel, 25)
    glint = painted(GROUND, (AWAY < 70) & (AWAY > 8), [25, 25, 30])
    for rgb in (lid, glint):
        assert open_gaps(rgb, DISC) is DISC


def test_white_objects_on_white_or_pale_grounds_stay_whole():
    """A shaded plate is as bright as the table in its middle; a print encloses white paper."""
    shade = np.clip(1.2 - (AWAY / 70) ** 4, 0.6, 1)[..., None]
    plate = np.where((AWAY < 70)[..., None], 225 * shade, np.full((240, 240, 3), 225.0))
    ring = (AWAY < 70) & (AWAY > 60)
    paper = painted(np.full((240, 240, 3), 255.0), ring, [25, 25, 30])
    for rgb in (painted(plate, AWAY < 0, 0), paper):
        assert open_gaps(rgb, DISC) is DISC
