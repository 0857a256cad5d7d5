"""The difference of two clips, against distances that are known beforehand."""

import numpy as np
import pytest

from phy124.accuracy import choose
from phy124.accuracy.difference import difference, pixel_distance
from phy124.accuracy.goal import Goal
from phy124.scene import Scene, View
from support.clips import flight, with_floor

VIEW = View(size=64, views=("front",))
STEP = 0.05


@pytest.fixture(scope="module")
def clips():
    """A ball of 1 m that stays, and one that moves to the right in its last frame."""
    return flight([(0, 0, 0)] * 3), flight([(0, 0, 0), (0, 0, 0), (0, STEP, 0)])


def test_a_clip_does_not_differ_from_itself(clips):
    result = difference(clips[0], clips[0], VIEW)
    assert result.metres == result.pixels == result.worst == 0
    assert result.psnr == float("inf") and result.ssim == pytest.approx(1)


def test_metres_fraction_and_worst_frame_are_those_of_the_step(clips):
    result = difference(clips[1], clips[0], VIEW)
    assert result.metres == pytest.approx(STEP / np.sqrt(3), rel=1e-5)
    size = np.ptp(clips[0].means[0], axis=0).max()
    assert result.relative == pytest.approx(result.metres / size, rel=1e-6)
    assert result.worst_frame == 2 and result.worst == pytest.approx(STEP / size, rel=1e-5)
    assert 20 < result.psnr < 60 and 0.5 < result.ssim < 1


def test_pixels_scale_with_the_picture(clips):
    small = pixel_distance(clips[1], clips[0], VIEW)
    large = pixel_distance(clips[1], clips[0], VIEW.model_copy(update={"size": (128, 128)}))
    assert large == pytest.approx(2 * small, rel=1e-4)
    level = VIEW.model_copy(update={"elevation": 0.0, "fit": False})
    depth = level.distance - clips[0].means[0][:, 0]
    scale = 64 / (2 * np.tan(np.radians(level.fov / 2))) * np.sqrt(np.mean(depth**-2.0))
    moved = pixel_distance(clips[1], clips[0], level)
    assert moved == pytest.approx(STEP / np.sqrt(3) * scale, rel=0.01)


def test_surroundings_do_not_count(clips):
    floored = [with_floor(clip) for clip in clips]
    for function in (
        lambda a, b: pixel_distance(b, a, VIEW),
        lambda a, b: difference(b, a, VIEW).metres,
        lambda a, b: choose._distance(Goal.error("1mm"), a, b, Scene()),
    ):
        assert function(*floored) == pytest.approx(function(*clips), rel=1e-6)


def test_clips_of_different_length_are_refused(clips):
    with pytest.raises(ValueError, match="do not match"):
        difference(flight([(0, 0, 0)]), clips[0], VIEW)
