"""relief: cards and photographic prints are thin, also if they lie obliquely."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.cards import is_card
from support.drawings import X, Y, picture

SHOWN = np.clip(
    np.exp(-((X - 96) ** 2 + (Y - 96) ** 2) / 3000) + 0.6 * np.sin(X / 9) * np.sin(Y / 7), 0, 1
)


def box(turn, half=(50, 70), taper=0.0):
    """Return position across and along an outline with four corners, and its mask [H,W]."""
    angle = np.radians(turn)
    across = (X - 96) * np.cos(angle) + (Y - 96) * np.sin(angle)
    along = ((Y - 96) * np.cos(angle) - (X - 96) * np.sin(angle)) / half[1]
    across = across / (half[0] * (1 + taper * along))
    return across, along, (abs(across) < 1) & (abs(along) < 1)


def image(mask, light):
    return picture(mask, (light[..., None] * [230, 210, 180]).astype(np.uint8))


def seen(mask, light):
    return np.asarray(image(mask, light)) / 255


@pytest.mark.parametrize(
    ("turn", "taper"),
    [
        (25, 0.2),
        (0, 0),
        pytest.param(20, 0, marks=pytest.mark.slow),
        pytest.param(0, 0.2, marks=pytest.mark.slow),
    ],
)
def test_a_print_is_thin(turn, taper):
    """It shows a bright middle, as a round object does."""
    mask = box(turn, taper=taper)[2]
    made = relief(image(mask, 0.3 + 0.6 * SHOWN), count=3000).means
    assert np.ptp(made[:, 0]) < 0.12


@pytest.mark.parametrize("turn", [0, 20])
def test_a_cylinder_is_no_card(turn):
    across, _, mask = box(turn)
    assert not is_card(seen(mask, 0.4 + 0.5 * np.sqrt(np.clip(1 - across**2, 0, 1))), plain=False)


@pytest.mark.parametrize(
    "mask",
    [
        box(0, taper=-0.2)[2],  # a glass
        box(0, taper=0.6)[2],  # a cone
        box(30, half=(12, 80))[2],  # a stick
        np.hypot(X - 96, Y - 96) < 80,
    ],
)
def test_other_outlines_are_no_cards(mask):
    assert not is_card(seen(mask, 0.3 + 0.6 * SHOWN), plain=False)


def test_a_plain_upright_rectangle_may_be_a_box():
    plain = np.full(X.shape, 0.8)
    assert is_card(seen(box(20)[2], plain), plain=True)
    assert not is_card(seen(box(0)[2], plain), plain=True)
