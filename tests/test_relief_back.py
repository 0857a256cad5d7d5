"""relief: the back is plain behind a front, and mirrored behind a profile."""

import numpy as np
import pytest

from phy124.camera import Camera
from phy124.gaussians import rotation_matrices
from phy124.generators.relief import VIEW_DISTANCE, relief
from phy124.rendering.render import Renderer
from support.drawings import SIZE, X, Y, face, mug, picture


def test_features_do_not_show_on_the_back():
    a_face = relief(face(), count=12_500)
    normals = rotation_matrices(a_face.quats)[:, :, 2]
    dark = a_face.rgb.mean(axis=1) < 0.3
    assert dark[normals[:, 0] > 0.5].sum() > 125
    assert not dark[normals[:, 0] < -0.4].any()


def test_back_of_a_card_is_plain():
    """No mirrored print, but the narrow sides have the colour of the frame."""
    frame = np.minimum(80 - abs(X - 96), 50 - abs(Y - 96)) < 8
    letters = (abs(Y - 90) < 15) & (abs(X - 80) < 50) & (X % 20 < 10)
    card = np.where(letters[..., None], (20, 20, 20), (240, 235, 220))
    card = np.where(frame[..., None], (180, 30, 30), card).astype(np.uint8)
    gaussians = relief(picture((abs(X - 96) < 80) & (abs(Y - 96) < 50), card), count=8000)
    facing = rotation_matrices(gaussians.quats)[:, 0, 2]
    inner = abs(gaussians.means[:, 1]) < 0.4
    back = gaussians.rgb[(facing < -0.99) & inner]
    np.testing.assert_allclose(back, np.full_like(back, 0) + [0.941, 0.922, 0.863], atol=0.02)
    side = gaussians.rgb[(abs(facing) < 0.1) & (abs(gaussians.means[:, 1]) > 0.4)]
    assert np.median(side[:, 1]) < 0.2


def duck():
    """A white body with a red head to the left, whose eye is black."""
    body = np.hypot((X - 110) / 60, (Y - 120) / 40) < 1
    head = np.hypot(X - 60, Y - 70) < 30
    eye = np.hypot(X - 55, Y - 65) < 7
    rgb = np.where(head[..., None], np.array([200, 40, 30]), 225)
    return picture(body | head, np.where(eye[..., None], 10, rgb).astype(np.uint8))


def eyes_behind(gaussians):
    """Number of dark Gaussians on the back."""
    behind = rotation_matrices(gaussians.quats)[:, 0, 2] < -0.4
    return (gaussians.rgb.mean(axis=1) < 0.2)[behind].sum()


def test_back_of_a_profile_is_the_mirrored_front():
    assert eyes_behind(relief(duck(), count=5000)) > 5
    assert eyes_behind(relief(duck(), count=5000, back_look="plain")) == 0
    assert eyes_behind(relief(face(), count=5000, back_look="mirror")) > 5


@pytest.mark.slow
def test_a_handle_does_not_make_a_profile():
    """The print of a mug does not show mirrored behind."""
    mask = np.asarray(mug())[..., 3] > 0
    printed = (abs(X - 75) < 20) & (abs(Y - 96) < 10) & (X % 10 < 5)
    rgb = np.where(printed[..., None], 10, np.array([60, 90, 200])).astype(np.uint8)
    assert eyes_behind(relief(picture(mask, rgb), count=5000)) == 0


def test_plain_back_has_the_fronts_texture():
    """A rough front has a back of the same roughness, not a blur."""
    rough = np.random.default_rng(0).normal(150, 25, (SIZE, SIZE, 1)).repeat(3, axis=2)
    mask = np.hypot(X - 96, Y - 96) < 80
    gaussians = relief(picture(mask, rough.clip(0, 255).astype(np.uint8)), count=12_500)
    facing = rotation_matrices(gaussians.quats)[:, 0, 2]
    front, back = (gaussians.rgb[side, 0].std() for side in (facing > 0.7, facing < -0.7))
    assert back > 0.3 * front


def test_back_is_shaded_by_the_fronts_light():
    """Light from the camera's left and front leaves the back darker, its left side most."""
    normal_x, normal_y = (X - 96) / 80, (Y - 96) / 80
    normal_z = np.sqrt(np.clip(1 - normal_x**2 - normal_y**2, 0, 1))
    grey = (150 * (1 - 0.25 * normal_x + 0.15 * normal_z))[..., None].repeat(3, axis=2)
    gaussians = relief(picture(normal_z > 0, grey.astype(np.uint8)), count=10_000)
    seen = Renderer(device="cpu")(gaussians, Camera.orbit(180, 0, VIEW_DISTANCE, 128))[64, :, 0]
    assert seen[64] < 150 / 255 - 0.03  # at the rim, the light is neither added nor missing
    assert seen[40] + 0.1 < seen[88]


def test_shape_without_shading_keeps_its_colour_behind():
    plain = relief(picture(np.hypot(X - 96, Y - 96) < 80), count=3000)
    np.testing.assert_allclose(
        plain.rgb, np.array([200, 120, 60]) / 255 * np.ones_like(plain.rgb), atol=0.01
    )


def test_colours_are_the_same_on_both_sides_of_the_rim():
    """No seam: a rim that is darker than the front is as wide behind as in front."""
    dark = np.clip((80 - np.hypot(X - 96, Y - 96)) / 30, 0, 1)
    grey = (60 + 120 * dark)[..., None].repeat(3, axis=2)
    gaussians = relief(picture(dark > 0, grey.astype(np.uint8)), count=10_000)
    facing = rotation_matrices(gaussians.quats)[:, 0, 2]
    before, behind = (
        gaussians.rgb[(low < facing) & (facing < high)].mean()
        for low, high in ((0.1, 0.3), (-0.3, -0.1))
    )
    assert behind == pytest.approx(before, abs=0.03)
