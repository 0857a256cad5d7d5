"""Fewer Gaussians that cover what all of them covered."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.generators.ply_file import PlyFile
from phy124.generators.relief import relief
from phy124.generators.shapes import make_shape
from phy124.particles import compute_bounds, find_solid
from phy124.particles.thinning import check_count, note_few, note_volume, thin, with_count
from phy124.pipeline.gaussians import make_object
from phy124.rendering.render import Renderer
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from support.shapes import ball


@pytest.mark.parametrize(
    "count", [100, *(pytest.param(count, marks=pytest.mark.slow) for count in (700, None))]
)
def test_relief_makes_about_the_requested_number(count):
    duck = Path(__file__).parents[1] / "demo/examples/duck.png"
    made = make_object(duck, Scene(), RunContext(device="cpu"), method="grabcut", count=count)
    assert len(made.gaussians) == pytest.approx(count or 50_000, rel=0.05)
    assert not any("--gaussians" in note for note in made.about["notes"])


def test_far_fewer_gaussians_than_requested_are_noted():
    def make(picture, *, count: int = 9):
        return ball(count // 3)

    assert note_few(make, 40, 50) == note_few(make, 40, None) == note_few(len, 20, 50) == []
    assert note_few(make, 20, 50) == [
        "The generator made 20 Gaussians instead of 50: --gaussians is approximate."
    ]


def test_few_stay_as_they_are():
    g = ball(300)
    assert thin(g, None) is g
    assert thin(g, len(g)) is g


def test_so_many_are_left_and_the_same_each_time():
    g = ball(4000)
    some, again = thin(g, 1000), thin(g, 1000)
    assert 950 < len(some) <= 1000
    assert np.array_equal(some.means, again.means)
    others = [thin(g, 1000, seed=seed) for seed in range(1, 9)]
    assert any(not np.array_equal(some.means, other.means) for other in others)


def test_remaining_gaussians_cover_the_same_area():
    g = ball(8000)
    camera = Camera.orbit(0, 10, 1.9, 64, (0, 0, 0))
    draw = Renderer(device="cpu")
    white, black = ((c, c, c) for c in (1.0, 0.0))

    def alpha(gaussians):
        return 1 - (draw(gaussians, camera, white) - draw(gaussians, camera, black)).mean(axis=2)

    all_of_it, few = alpha(g), alpha(thin(g, 2000))
    assert few.sum() == pytest.approx(all_of_it.sum(), rel=0.1)
    bare = alpha(g.select(np.arange(0, len(g), len(g) // 2000)))
    assert abs(few - all_of_it).mean() < abs(bare - all_of_it).mean()


@pytest.mark.parametrize("count", [2000, 500])
def test_a_box_of_fewer_gaussians_keeps_size_and_volume(count):
    box = make_shape("box", (1.0, 1.0, 1.0), (1.0, 0.0, 0.0), count=20_000)
    few = thin(box, count)
    for end, before in zip(compute_bounds(few), compute_bounds(box), strict=True):
        np.testing.assert_allclose(end, before, atol=2e-3)
    assert find_solid(few, 0.05).volume == pytest.approx(1, rel=0.01)
    assert note_volume(box, few) == note_volume(box, box) == []


def test_a_change_of_volume_is_noted():
    notes = note_volume(ball(4000), ball(30))
    assert len(notes) == 1
    assert notes[0].startswith("With 30 of 4,000 Gaussians, the object's volume and mass are ")
    assert notes[0].endswith("% smaller. Give --gaussians a larger number.")


def test_generator_with_a_count_option_makes_the_count():
    assert with_count(relief, 700).keywords == {"count": 700}
    reader = PlyFile("object.ply")
    assert with_count(reader, 700) is reader
    assert with_count(relief, None) is relief


@pytest.mark.parametrize("count", [0, 99, -5, 10**9])
def test_unreasonable_numbers_are_refused(count):
    with pytest.raises(InputError, match=r"from 100 to 5,000,000\. Write, for example, 20000"):
        check_count(count)


@pytest.mark.parametrize("size", [1e3, 1e34])
def test_a_giant_leaves_no_hole_where_the_others_were(size):
    g = ball(4000)
    scales = g.scales.copy()
    scales[7] = size
    some, wanted = thin(replace(g, scales=scales), 1000), thin(g, 1000)
    assert len(some) > 900
    usual = some.scales.max(axis=1) < 1
    assert np.median(some.scales[usual]) == pytest.approx(np.median(wanted.scales), rel=0.1)
