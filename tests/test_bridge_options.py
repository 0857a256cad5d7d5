"""Options: bounds, defaults, and messages that say what to do."""

import pytest
from pydantic import ValidationError

from bridge.options import LIVE_POINTS, Options


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"frame_id": "/map"}, "begin with a slash. Leave it out"),
        ({"frame_id": "map"}, "cannot hang on itself. Rename one"),
        ({"rotation": (0, 0, 0, 0)}, "Use 1 0 0 0 for none"),
        ({"rotation": (float("nan"), 0, 0, 0)}, "finite"),
        ({"max_points": 0}, "greater than or equal to 1"),
        ({"epoch": 2.0**31}, "less than"),
        ({"profile": "splat"}, "'viz', 'full' or 'ply'"),
        ({"qos": 1}, "Extra inputs"),
    ],
)
def test_refusals(wrong, sentence):
    with pytest.raises(ValidationError, match=sentence):
        Options(**wrong)


def test_rotation_becomes_a_unit_quaternion():
    assert Options(rotation=(0, 0, 0, 2)).rotation == (0, 0, 0, 1)


def test_live_limit_applies_only_where_none_was_chosen():
    assert Options().max_points is None
    assert Options().live().max_points == LIVE_POINTS == 32_768
    assert Options(max_points=65_536).live().max_points == 65_536
