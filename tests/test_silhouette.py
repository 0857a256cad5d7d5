"""Measures of a mask's plausibility, for masks with known results."""

import numpy as np
import pytest
import scipy.ndimage as ndi

from phy124.imaging.silhouette import (
    count_pieces,
    find_touched_edges,
    measure_alike,
    measure_undecided,
    measure_unseen,
)

Y, X = np.mgrid[:120, :160]
DISK = np.hypot(X - 80, Y - 60) < 30


def test_pieces_are_counted_without_tiny_fragments():
    two = DISK | (np.hypot(X - 140, Y - 20) < 8)
    assert (count_pieces(DISK), count_pieces(two)) == (1, 2)
    assert count_pieces(DISK | (np.hypot(X - 140, Y - 20) < 2)) == 1


@pytest.mark.parametrize("edge", ["left", "top", "right", "bottom"])
def test_edges_that_are_reached_are_named(edge):
    beam = {
        "left": (Y == 60) & (X < 80),
        "right": (Y == 60) & (X > 80),
        "top": (X == 80) & (Y < 60),
        "bottom": (X == 80) & (Y > 60),
    }[edge]
    assert find_touched_edges(DISK) == ()
    assert find_touched_edges(DISK | np.isin(Y, Y[beam]) & np.isin(X, X[beam])) == ()
    thick = np.zeros_like(DISK)
    for shift in range(-4, 5):
        thick |= np.roll(beam, shift, axis=0 if edge in ("left", "right") else 1)
    assert find_touched_edges(DISK | thick) == (edge,)


def test_an_outline_is_seen_where_colours_change():
    grey = np.full((120, 160, 3), 120, np.uint8)
    clear = np.where(DISK[..., None], np.uint8([200, 30, 30]), grey)
    assert measure_unseen(grey, DISK) == 1.0
    assert measure_unseen(clear, DISK) < 0.02
    half = np.where(DISK[..., None] & (X[..., None] < 80), np.uint8([200, 30, 30]), grey)
    assert measure_unseen(half, DISK) == pytest.approx(0.5, abs=0.1)


def test_surroundings_of_the_objects_colours_are_alike(rng):
    red, blue = np.uint8([200, 30, 30]), np.uint8([30, 30, 200])
    assert measure_alike(np.where(DISK[..., None], red, blue), DISK) < 0.1
    # A larger red thing whose middle alone was taken for the object, the rest of it around.
    striped = np.where((DISK | (X > 80))[..., None], red, blue)
    assert 0.3 < measure_alike(striped, DISK) < 0.7
    assert measure_alike(np.full((120, 160, 3), 90, np.uint8), np.zeros_like(DISK)) == 0.0


def test_half_transparent_interior_is_undecided():
    """A soft edge is not, in a picture of any size."""
    for factor, blur in ((1, 1.0), (8, 2.0)):
        disk = np.kron(DISK, np.ones((factor, factor))) > 0
        alpha = (255 * ndi.gaussian_filter(disk.astype(float), blur)).astype(np.uint8)
        assert measure_undecided(alpha) < 0.005
        alpha[disk & (np.arange(disk.shape[1]) > disk.shape[1] // 2)] = 140
        assert measure_undecided(alpha) > 0.2
