"""Touching objects are parted by a neck and a change of colours together, by neither alone."""

import numpy as np
import pytest
from PIL import Image

from phy124.imaging.cutout import METHODS, Method, foreground
from phy124.imaging.touching import select_part, split_touching

Y, X = np.mgrid[:160, :300]
RED, BLUE = (200, 40, 30), (40, 60, 200)


def disc(x, radius=60, y=80):
    return np.hypot(X - x, Y - y) < radius


def painted(*parts, ground=(230, 230, 230)):
    """RGB [H,W,3] and alpha [H,W] of (mask, colour)."""
    rgb, alpha = np.full((*X.shape, 3), ground, np.uint8), np.zeros(X.shape, np.uint8)
    for mask, colour in parts:
        rgb[mask], alpha[mask] = colour, 255
    return rgb, alpha


def test_two_discs_of_two_colours_are_two():
    first, other = disc(90), disc(206)
    parts = split_touching(*painted((first, RED), (other, BLUE)))
    assert parts is not None
    for part, known in zip(sorted(parts, key=lambda p: X[p].mean()), (first, other), strict=True):
        assert (part & known).sum() > 0.97 * known.sum()


@pytest.mark.parametrize(
    "parts",
    [
        [(disc(90), RED), (disc(206), RED)],  # a dumbbell
        [(disc(90), RED), (disc(140), BLUE)],  # no neck
        [(disc(90), RED), (disc(160, 15), BLUE)],  # something held
        [(disc(90) & (Y < 80), RED), (disc(90) & (Y >= 80), BLUE)],  # shirt and trousers
        [(disc(90), RED)],
        [],
    ],
)
def test_single_sign_does_not_split_an_object(parts):
    assert split_touching(*painted(*parts)) is None


def test_click_selects_one_of_three_objects():
    rgb, alpha = painted((disc(50, 45), RED), (disc(136, 45), BLUE), (disc(222, 45), (30, 160, 60)))
    for x in (50, 136, 222):
        taken = select_part(rgb, alpha, (80, x)) > 0
        assert (taken & disc(x, 45)).sum() > 0.95 * taken.sum()


@pytest.mark.parametrize("x", [90, 206])
def test_click_beside_an_object_selects_that_object(x):
    rgb, alpha = painted((disc(90), RED), (disc(206), BLUE))
    taken = select_part(rgb, alpha, (16, x)) > 0
    assert (taken & disc(x)).sum() > 0.95 * taken.sum()


def test_touching_objects_are_noted_and_split_by_a_pick(monkeypatch):
    rgb, alpha = painted((disc(90), RED), (disc(206), BLUE))
    monkeypatch.setitem(METHODS, "u2netp", Method(lambda image: False, lambda *_: alpha))
    picture = Image.fromarray(rgb)
    whole = foreground(picture, "u2netp")
    assert "two objects that touch" in " ".join(whole.warnings)
    picked = foreground(picture, "u2netp", pick=(0.3, 0.5))
    assert picked.warnings == ()
    assert picked.coverage == pytest.approx(whole.coverage / 2, rel=0.05)
