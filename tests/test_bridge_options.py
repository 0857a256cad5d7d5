"""Options: bounds, defaults, and messages that say what to do."""

import math

import pytest
from pydantic import ValidationError

from bridge.options import LIVE_POINTS, Options, angles, quaternion


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"frame_id": "/map"}, "begin with a slash. Omit the slash"),
        ({"frame_id": "map"}, "cannot be its own parent. Rename one"),
        ({"rotation": (0, 0, 0, 0)}, "Use 0 0 0 1 for no rotation"),
        ({"rotation": (0, 1)}, "x y z w, or roll pitch yaw"),
        ({"rotation": (1, 0, 0, 0)}, "3.14159 0 0 if it is x y z w, 0 0 0 if it is w x y z"),
        ({"rotation": (0.8, 0, 0, 0.6)}, "0 0 1.287 if it is w x y z"),
        ({"rotation": (float("nan"), 0, 0, 0)}, "finite"),
        ({"max_points": 0}, "greater than or equal to 1"),
        ({"epoch": 2.0**31}, "less than"),
        ({"profile": "splat"}, "'viz', 'full', 'small', 'ply' or 'splats'"),
        ({"images": ("depth",)}, "no camera is chosen. Set views or cameras"),
        ({"qos": 1}, "Extra inputs"),
    ],
)
def test_refusals(wrong, sentence):
    with pytest.raises(ValidationError, match=sentence):
        Options(**wrong)


def test_rotation_becomes_a_unit_quaternion_in_the_order_of_ros():
    assert Options().rotation == Options(rotation=(0, 0, 0, 2)).rotation == (0, 0, 0, 1)
    assert Options(rotation=(0, 0, 3, 4)).rotation == pytest.approx((0, 0, 0.6, 0.8))


def test_roll_pitch_yaw_turn_about_the_fixed_axes():
    # tf2: `setRPY(0, 0, pi / 2)` takes x to y.
    half = math.sqrt(0.5)
    assert Options(rotation=(0, 0, math.pi / 2)).rotation == pytest.approx((0, 0, half, half))
    assert Options(rotation=(math.pi, 0, 0)).rotation == pytest.approx((1, 0, 0, 0))
    inputs = (0.3, -0.7, 2.1)
    assert angles(*quaternion(*inputs)) == pytest.approx(inputs)


def test_live_limit_applies_only_where_none_was_chosen():
    assert Options().max_points is None
    assert Options().live().max_points == LIVE_POINTS == 32_768
    assert Options(max_points=65_536).live().max_points == 65_536
    assert (Options().live().profile, Options().for_recording().profile) == ("viz", "full")
    assert Options(profile="ply").live().profile == "ply"
