"""Several objects in a picture: the largest is taken, a place picks another."""

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.cutout import METHODS, Method, cut_out, foreground
from phy124.imaging.objects import Objects, keep_largest, search_around, select_object

LARGE, SMALL, CRUMB = (slice(20, 100), slice(20, 90)), (slice(60, 100), slice(120, 170)), (5, 195)


@pytest.fixture
def alpha():
    """Two objects 30 pixels apart, and a crumb."""
    alpha = np.zeros((120, 200), np.uint8)
    alpha[LARGE] = alpha[SMALL] = alpha[CRUMB] = 255
    return alpha


def only(alpha, where):
    alone = np.zeros_like(alpha)
    alone[where] = alpha[where]
    return alone


def found_as(alpha):
    return Method(lambda _: True, lambda *_: alpha)


def test_the_largest_is_taken_and_all_are_counted(alpha):
    result, count = keep_largest(alpha)
    np.testing.assert_array_equal(result, only(alpha, LARGE))
    assert count == 2
    assert keep_largest(np.zeros_like(alpha))[1] == 0


def test_parts_that_nearly_touch_are_one_object(alpha):
    alpha[62:66, 92:119] = 255
    assert Objects.of(alpha).number == 1
    assert keep_largest(alpha)[0][80, 150] == 255


def test_a_soft_edge_stays_with_its_object(alpha):
    alpha[20:100, 90:100], alpha[60:100, 112:120] = 60, 70
    np.testing.assert_array_equal(keep_largest(alpha)[0][50, 80:100], [255] * 10 + [60] * 10)
    assert keep_largest(alpha)[0][80, 112:].max() == 0
    assert select_object(alpha, (0.7, 0.7))[80, 112:120].min() == 70


@pytest.mark.parametrize("pick", [(0.7, 0.7), (0.605, 0.6)])
def test_a_place_on_an_object_or_just_beside_it_picks_it(alpha, pick):
    np.testing.assert_array_equal(select_object(alpha, pick), only(alpha, SMALL))
    assert select_object(alpha, (0.55, 0.1)) is None
    assert select_object(np.zeros_like(alpha), pick) is None


def test_faint_object_is_sought_around_the_click():
    """What stands out in a part of this picture is the brightest object in it."""
    grey = np.zeros((200, 300), np.uint8)
    grey[40:160, 20:110], grey[120:150, 220:260] = 255, 100

    def find(part):
        values = np.asarray(part.convert("L"))
        return np.where((values == values.max()) & (values > 0), 255, 0).astype(np.uint8)

    image = Image.fromarray(grey)
    assert select_object(find(image), (0.8, 0.67)) is None
    result = search_around(image, (0.8, 0.67), find)
    np.testing.assert_array_equal(result, np.where(grey == 100, 255, 0))
    assert search_around(image, (0.5, 0.05), find) is None


def test_search_keeps_a_single_object_and_notes_others(alpha, monkeypatch):
    monkeypatch.setitem(METHODS, "u2netp", found_as(alpha))
    picture = Image.fromarray(np.dstack([alpha] * 3) // 2 + 60)
    cutout = foreground(picture)
    assert (cutout.objects, cutout.pieces) == (2, 1)
    assert cutout.warnings[0] == "The picture has 2 separate objects; the largest is taken."
    np.testing.assert_array_equal(np.asarray(cutout.picture)[..., 3], only(alpha, LARGE))
    picked = foreground(picture, pick=(0.7, 0.7))
    assert picked.objects == 1 and picked.warnings == ()
    np.testing.assert_array_equal(np.asarray(picked.picture)[..., 3], only(alpha, SMALL))


def test_manual_cutout_is_kept_whole_without_a_click(alpha):
    picture = Image.new("RGB", alpha.shape[::-1], "red")
    picture.putalpha(Image.fromarray(alpha))
    for options in ({}, {"mask": Image.fromarray(alpha)}):
        whole, picked = (
            foreground(picture, **options),
            foreground(picture, pick=(0.7, 0.7), **options),
        )
        np.testing.assert_array_equal(np.asarray(whole.picture)[..., 3], alpha)
        np.testing.assert_array_equal(np.asarray(picked.picture)[..., 3], only(alpha, SMALL))


@pytest.mark.parametrize(
    ("pick", "message"),
    [
        ((0.55, 0.1), r"pick = 0.55,0.1: No object was found at this point.* or mark the object"),
        ((1.2, 0.5), r"pick = 1.2,0.5: It is not a point in the picture\. Give two fractions"),
        ((float("nan"), 0.5), r"pick = nan,0.5: It is not a point"),
        ((0.5,), r"pick = 0.5: It is not a point"),
    ],
)
def test_places_without_an_object_are_refused(alpha, tmp_path, pick, message):
    Image.fromarray(np.dstack([alpha] * 4)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match=message):
        cut_out(tmp_path / "a.png", pick=pick)
