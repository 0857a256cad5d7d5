"""relief: which round solid a silhouette becomes, and its flat ends."""

import numpy as np
import pytest

from phy124.gaussians import rotation_matrices
from phy124.generators.relief import relief
from phy124.rendering.render import Renderer
from support.drawings import X, Y, extents, mug, outlines, picture, shaded


@pytest.fixture(scope="module")
def renderer():
    return Renderer(device="cpu")


def test_flat_bottoms_stand_and_handles_stay_open():
    a_mug = relief(mug(), count=10_000)
    low = a_mug.means[:, 2].min()
    on_ground = a_mug.means[a_mug.means[:, 2] < low + 0.01]
    # The foot is as deep as the mug, not an edge.
    assert np.ptp(on_ground[:, 0]) > 0.6 * np.ptp(a_mug.means[:, 0])
    hole = np.hypot(a_mug.means[:, 1] - 0.26, a_mug.means[:, 2]) < 0.1
    assert not (hole & (a_mug.means[:, 1] > 0.25)).any()


def test_thin_parts_stay_thin():
    """A stalk under a ball is as deep as it is wide."""
    mask = (np.hypot(X - 96, Y - 60) < 50) | ((abs(X - 96) < 5) & (Y > 60) & (Y < 180))
    means = relief(picture(mask), count=20_000).means
    stalk = means[(means[:, 2] < -0.25) & (means[:, 2] > -0.4)]
    ball = means[means[:, 2] > 0]
    assert np.ptp(stalk[:, 0]) == pytest.approx(np.ptp(stalk[:, 1]), rel=0.25)
    assert np.ptp(ball[:, 0]) > 5 * np.ptp(stalk[:, 0])


def test_a_limb_is_a_cylinder_with_flat_ends():
    """From a drawing whose lower edge is the arc that a camera sees."""
    arc = 170 + 8 * np.sqrt(np.clip(1 - ((X - 96) / 30) ** 2, 0, 1))
    column = (abs(X - 96) < 30) & (Y > 20) & (arc > Y)
    gaussians = relief(shaded(column, (X - 96) / 30), count=10_000)
    for low, high in ((-0.44, -0.35), (-0.05, 0.05), (0.35, 0.44)):
        depth, width = extents(gaussians, low, high)
        assert depth == pytest.approx(width, rel=0.1)
    lowest = gaussians.means[:, 2] < gaussians.means[:, 2].min() + 0.01
    assert np.ptp(gaussians.means[lowest, 0]) > 0.3


@pytest.mark.parametrize("gap", [2, 40])
def test_only_deep_gaps_divide_an_end(gap):
    """A jar whose cut-out is ragged by two pixels is as deep at its top as below; ears are not."""
    bumps = (abs(X - 75) < 8) | (abs(X - 117) < 8)
    jar = (abs(X - 96) < 40) & (Y < 170) & (np.where(bumps, 28, 28 + gap) < Y)
    gaussians = relief(shaded(jar, (X - 96) / 40), count=10_000)
    (top, _), (depth, _) = extents(gaussians, 0.43, 0.48), extents(gaussians, -0.05, 0.05)
    assert top > 0.9 * depth if gap < 40 else top < 0.5 * depth


def test_seated_figure_has_a_flat_base_and_both_feet(renderer):
    """A bear: no foot of the picture is cut off, nothing is between them, and it does not tip."""
    body = (np.hypot((X - 96) / 46, (Y - 110) / 60) < 1) | (abs(X - 96) < 34) & (abs(Y - 140) < 34)
    feet = np.minimum(np.hypot(X - 62, Y - 160), np.hypot(X - 130, Y - 160)) < 24
    arms = np.hypot((X - 96) / 76, (Y - 110) / 15) < 1
    inputs = picture(body | feet | arms | (np.hypot(X - 96, Y - 40) < 34))
    gaussians = relief(inputs, count=20_000)
    wanted, seen = outlines(renderer, gaussians, inputs)
    assert (wanted & seen).sum() > 0.97 * (wanted | seen).sum()
    lowest = gaussians.means[:, 2] < gaussians.means[:, 2].min() + 0.03
    assert np.ptp(gaussians.means[lowest, 0]) > 0.5 * np.ptp(gaussians.means[:, 0])


def test_lying_object_is_as_deep_as_high():
    log = (abs(X - 96) < 80) & (abs(Y - 96) < 20)
    means = relief(shaded(log, (Y - 96) / 20), count=5000).means
    assert np.ptp(means[:, 0]) == pytest.approx(np.ptp(means[:, 2]), rel=0.15)


def test_solid_of_revolution_is_round_in_each_row():
    """A mushroom's cap is as deep as wide, and so is its stalk; a bear's arms are not."""
    cap = (np.hypot(X - 96, 1.5 * (Y - 96)) < 80) & (Y < 96)
    stalk = (abs(X - 96) < 15) & (Y >= 96) & (Y < 160)
    mushroom = relief(picture(cap | stalk), count=10_000)
    for low, high, most in ((0.05, 0.3, 0.08), (-0.25, -0.1, 0.15)):
        depth, width = extents(mushroom, low, high)
        assert depth == pytest.approx(width, rel=most)
    arms = (np.hypot(X - 96, Y - 96) < 40) | ((abs(Y - 90) < 10) & (abs(X - 96) < 85))
    legs = (abs(abs(X - 96) - 20) < 8) & (abs(Y - 140) < 40)
    depth, width = extents(relief(picture(arms | legs), count=5000), -0.5, 0.5)
    assert depth < 0.6 * width


@pytest.mark.slow
def test_compact_round_shapes_are_turned():
    """An apple is as deep as wide at each height, also near its flat top."""
    apple = abs((X - 96) / 80) ** 3 + abs((Y - 96) / 76) ** 3 < 1
    gaussians = relief(shaded(apple, (X - 96) / 80), count=40_000)
    for low, high in ((-0.44, -0.4), (-0.05, 0.05), (0.4, 0.44)):
        depth, width = extents(gaussians, low, high)
        assert depth == pytest.approx(width, rel=0.1)


def lit_can(turned):
    """A can with a flat top, lit from the left; turned: sine of the normal's angle [H,W]."""
    arc = 10 * np.sqrt(np.clip(1 - turned**2, 0, 1))
    light = 0.45 + 0.45 * np.clip(np.sqrt(np.clip(1 - turned**2, 0, 1)) - 0.6 * turned, 0, 1)
    grey = (200 * light)[..., None].repeat(3, axis=2).astype(np.uint8)
    return picture((abs(turned) < 1) & (26 - arc < Y) & (166 + arc > Y), grey)


def test_flat_top_has_one_shade():
    """The near half of the top does not have the front's colours, nor the far half the back's."""
    gaussians = relief(lit_can((X - 96) / 50), count=10_000)
    top = gaussians.select(rotation_matrices(gaussians.quats)[:, 2, 2] > 0.95)
    middle = abs(top.means[:, 1]) < 0.1
    near, far = (
        top.rgb[middle & half].mean() for half in (top.means[:, 0] > 0.05, top.means[:, 0] < -0.05)
    )
    assert near == pytest.approx(far, abs=0.02)


@pytest.mark.parametrize("upright", [True, False])
def test_arcs_tell_a_drum_from_a_log(upright):
    """A drum has arcs above and below, and stripes that go round; a log has arcs at its sides."""
    x, y = (X - 96) / 80, Y - 96
    if not upright:
        x, y = y / 40, (X - 96) / 2
    arc = (20 if upright else 8) * np.sqrt(np.clip(1 - x**2, 0, 1))
    mask = (abs(x) < 1) & (abs(y) < 35 + arc)
    light = (0.4 + 0.5 * np.sqrt(np.clip(1 - x**2, 0, 1)))[..., None]
    band = np.where(((Y < 96) if upright else (X < 96))[..., None], [240, 60, 60], [60, 60, 240])
    gaussians = relief(picture(mask, (light * band).astype(np.uint8)), count=8000)
    depth, width, height = np.ptp(gaussians.means, axis=0)
    assert depth == pytest.approx(width if upright else height, rel=0.15)
    if upright:
        behind = gaussians.select(rotation_matrices(gaussians.quats)[:, 0, 2] < -0.7)
        upper, lower = behind.means[:, 2] > 0.1, behind.means[:, 2] < -0.1
        assert (behind.rgb[upper, 0] > 2 * behind.rgb[upper, 2]).mean() > 0.9
        assert (behind.rgb[lower, 2] > 2 * behind.rgb[lower, 0]).mean() > 0.9


@pytest.mark.slow
def test_front_of_a_rounded_block_is_its_picture(renderer):
    """Flat ends neither rise above the picture, nor is there a groove below them."""
    x, y = (X - 96) / 70, (Y - 96) / 70
    light = (0.5 + 0.4 * np.clip((1 - x**2) * (1 - y**2), 0, 1))[..., None] * [220, 200, 170]
    inputs = picture(x**6 + y**6 < 1, light.astype(np.uint8))
    wanted, seen = outlines(renderer, relief(inputs, count=20_000), inputs)
    assert (wanted & seen).sum() > 0.97 * (wanted | seen).sum()
