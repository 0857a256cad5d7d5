"""The surroundings of an object in a file are reported, with the box that excludes them."""

import re

import numpy as np
import pytest

from phy124.gaussians import Gaussians, join
from phy124.generators.ply_file import PlyFile, Reading
from phy124.generators.surroundings import surroundings
from phy124.io.ply import write_ply
from support.shapes import ball


def dots(places, size: float) -> Gaussians:
    count = len(places)
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    scales = np.full((count, 3), size)
    return Gaussians.from_rgb(places, quats, scales, np.full(count, 0.9), np.ones((count, 3)))


def sky(rng, *, count=4000, radius=20.0, size=0.5) -> Gaussians:
    ways = rng.normal(size=(count, 3))
    ways *= (
        radius * (1 + 0.03 * rng.normal(size=(count, 1))) / np.linalg.norm(ways, axis=1)[:, None]
    )
    return dots(ways, size)


def wide_sky(rng) -> Gaussians:
    """A sky that covers all directions."""
    return sky(rng, radius=30.0, size=1.0)


def haze(rng, *, count=3000) -> Gaussians:
    """Small Gaussians all over a place of 8 m, which hang together."""
    return dots(rng.uniform(-4, 4, (count, 3)), 0.004)


@pytest.mark.parametrize("stretched", [[1, 1, 1], [1, 0.1, 0.05], [0.3, 0.3, 1]])
def test_object_without_surroundings_has_no_note(stretched, rng):
    alone = ball(8000)
    shape = dots(alone.means * stretched, 0.004)
    assert surroundings(shape) == []


@pytest.mark.parametrize(
    ("around", "words"),
    [
        (sky, "surround all others like a sky"),
        (wide_sky, "surround all others like a sky"),
        (haze, "of the visible area, but all Gaussians"),
    ],
)
def test_surroundings_are_noted_with_a_crop(around, words, rng, tmp_path):
    place = join([ball(12_000), around(rng)])
    write_ply(tmp_path / "place.ply", place)
    said = PlyFile(str(tmp_path / "place.ply")).open().notes[-1]
    assert words in said
    crop = re.search(r"--crop=(\S+)", said)[1]
    opened = PlyFile(str(tmp_path / "place.ply"), Reading(crop=crop)).open()
    assert 11_500 < len(opened.gaussians) < 12_500
    assert not any(words in note for note in opened.notes)


def test_the_recommended_crop_can_be_used_far_from_the_origin(rng, tmp_path):
    place = join([ball(12_000), haze(rng)]).transform(0.4, np.array([3900, 2211, 30]))
    write_ply(tmp_path / "place.ply", place)
    crop = re.search(r"--crop=(\S+)", PlyFile(str(tmp_path / "place.ply")).open().notes[-1])[1]
    opened = PlyFile(str(tmp_path / "place.ply"), Reading(crop=crop)).open()
    assert 11_500 < len(opened.gaussians) < 12_500


def test_the_crop_is_in_the_axes_of_a_file_far_from_its_origin(rng):
    (said,) = surroundings(join([ball(12_000), sky(rng)]), (500_000.0, 0.0, 4.6e6))
    corners = np.array(re.search(r"--crop=(\S+)", said)[1].split(","), float).reshape(2, 3)
    assert np.allclose(corners.mean(axis=0), (500_000, 0, 4.6e6), atol=0.1)
    assert np.allclose(np.ptp(corners, axis=0), 1.25, atol=0.1)
