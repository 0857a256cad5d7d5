"""relief from several pictures: as wide, as deep and coloured as they show; contradictions told."""

import numpy as np
import pytest
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import rotation_matrices
from phy124.generators.relief import VIEW_DISTANCE, relief

SIZE = 160
Y, X = np.mgrid[:SIZE, :SIZE] + 0.5
RED, GREEN, BLUE = (220, 0, 0), (0, 200, 0), (0, 0, 220)


def picture(mask, rgb=RED):
    colours = np.broadcast_to(np.asarray(rgb, np.uint8), (*mask.shape, 3))
    return Image.fromarray(np.dstack([colours, 255 * mask.astype(np.uint8)]))


def ellipse(half_width, half_height=60, x=80, y=80):
    return np.hypot((X - x) / half_width, (Y - y) / half_height) < 1


def trestle(width, leg=8):
    """A plate on two legs; so four legs if it is seen from two sides."""
    across = abs(X - 80) < width
    legs = across & (abs(X - 80) > width - leg) & (abs(Y - 90) < 50)
    return legs | (across & (abs(Y - 45) < 8))


def made(front, side, **options):
    return relief(front, side=side, count=3000, **options)


@pytest.mark.slow
def test_a_disc_from_both_sides_is_a_ball():
    means = made(picture(ellipse(60)), picture(ellipse(60))).means
    radius = VIEW_DISTANCE * np.sin(np.arctan(0.5 / VIEW_DISTANCE))
    np.testing.assert_allclose(np.linalg.norm(means, axis=1), radius, atol=0.03)


def test_the_side_says_how_deep_it_is():
    """A fish from its broad side, and from ahead; from any resolution."""
    for scale in (1, 2):
        side = picture(np.kron(ellipse(20, 30), np.ones((scale, scale))))
        size = np.ptp(made(picture(ellipse(60, 30)), side).means, axis=0)
        np.testing.assert_allclose(size[[0, 2]] / size[1], [1 / 3, 1 / 2], atol=0.04)


def test_two_pairs_of_legs_are_four():
    means = made(picture(trestle(50)), picture(trestle(35))).means
    feet = means[means[:, 2] < -0.2, :2]
    corners = np.sign(feet)
    for corner in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        assert (corners == corner).all(axis=1).sum() > 40
    assert (np.abs(feet) > [0.18, 0.28]).all()
    lowest = means[:, 2] < means[:, 2].min() + 0.01
    assert lowest.sum() > 20  # flat


def test_perspective_is_removed_from_near_parts():
    """A large ball, above it a small one nearer to the viewer of the front: pictured larger."""
    unit = 80  # pixels per m
    (x, z, small), large = (0.4, 0.38, 0.12), 0.3
    front_k, side_k = 1 / (1 - x / VIEW_DISTANCE), 1.0
    front = ellipse(large * unit, large * unit) | ellipse(
        small * unit * front_k, small * unit * front_k, 80, 80 - z * unit * front_k
    )
    side = ellipse(large * unit, large * unit) | ellipse(  # it looks to the left
        small * unit * side_k, small * unit * side_k, 80 - x * unit, 80 - z * unit
    )
    means = made(picture(front), picture(side)).means
    above = means[:, 2] > means[:, 2].max() - 0.1
    wide = np.ptp(means[above, 1]) / np.ptp(means[~above, 1])
    assert wide == pytest.approx(small / large, abs=0.045)


def test_each_picture_colours_what_it_shows():
    views = {"front": RED, "side": GREEN, "back": BLUE}
    pictures = {name: picture(ellipse(60), rgb) for name, rgb in views.items()}
    gaussians = made(pictures.pop("front"), **pictures)
    normals = rotation_matrices(gaussians.quats)[:, :, 2]
    for axis, channel in (((1, 0, 0), 0), ((0, 1, 0), 1), ((0, -1, 0), 1), ((-1, 0, 0), 2)):
        assert (gaussians.rgb[normals @ axis > 0.9].argmax(axis=1) == channel).all()


def test_a_back_alone_is_painted_on_the_inflated_front():
    gaussians = relief(picture(ellipse(60)), back=picture(ellipse(60), BLUE), count=3000)
    facing = rotation_matrices(gaussians.quats)[:, 0, 2]
    assert (gaussians.rgb[facing > 0.5].argmax(axis=1) == 0).all()
    assert (gaussians.rgb[facing < -0.5].argmax(axis=1) == 2).all()


@pytest.mark.parametrize(
    ("facing", "sign"), [("left", 1), pytest.param("right", -1, marks=pytest.mark.slow)]
)
def test_the_nose_is_where_the_side_faces(facing, sign):
    nose = ellipse(40) | ellipse(15, 10, 30, 60)
    means = made(picture(ellipse(40)), picture(nose), facing=facing).means
    middle = np.median(means[:, 0])
    assert sign * (means[:, 0].max() + means[:, 0].min() - 2 * middle) > 0.05


def test_a_face_is_not_painted_behind_the_tail():
    """Seen from its broad side the object is the same from the other, and not twice from ahead."""
    duck = ellipse(40, 30) | ellipse(16, 16, 115, 55)
    face = np.where(ellipse(14, 14)[..., None], BLUE, GREEN)
    gaussians = made(picture(duck, RED), picture(ellipse(30, 38), face))
    across = rotation_matrices(gaussians.quats)[:, 1, 2]
    main = gaussians.rgb.argmax(axis=1)
    assert (main[across > 0.9] == 2).any()
    assert not (main[across < -0.9] == 2).any()


def test_a_thickness_makes_it_flatter():
    """The object is as deep as requested, and as wide as before."""
    thick, thin = (relief(picture(ellipse(60)), count=2000, thickness=t) for t in (1.0, 0.5))
    ratio = np.ptp(thin.means, axis=0) / np.ptp(thick.means, axis=0)
    np.testing.assert_allclose(ratio, [0.5, 1.0, 1.0], atol=0.05)


def test_highlights_are_removed_and_white_paint_is_not():
    """White light adds as much of each colour; white paint what the ground lacks."""
    ball = ellipse(60)
    light = 150 * np.exp(-((X - 60) ** 2 + (Y - 55) ** 2) / 20)[..., None]
    glossy = picture(ball, np.clip(np.array([150, 40, 30]) + light, 0, 255))
    spotted = picture(ball, np.where(ellipse(6, 6, 60, 55)[..., None], 240, (150, 40, 30)))
    for shown, least in ((glossy, 0.0), (spotted, 0.5)):
        gaussians = relief(shown, count=3000, highlights="remove")
        assert (gaussians.rgb[:, 2].max() > 0.3) == (least > 0.0)
    assert relief(glossy, count=3000).rgb[:, 2].max() > 0.4


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (
            {"side": picture(ellipse(60) & (abs(Y - 80) > 20))},
            "side.*only one of the front and side.*upright",
        ),
        ({"side": picture(ellipse(70, 5))}, "side.*14 times as deep.*whole object"),
        ({"side": picture(ellipse(60)), "thickness": 0.5}, "thickness = 0.5.*from the side"),
        ({"side": picture(ellipse(60)), "depth": X}, "depth = map.*from the side"),
        ({"side": picture(ellipse(60) & False)}, "side.*opaque"),
        ({"back": picture(ellipse(20))}, "back.*overlaps.*straight behind"),
    ],
)
def test_pictures_that_contradict_each_other_are_refused(options, why):
    with pytest.raises(InputError, match=why):
        relief(picture(ellipse(60)), count=500, **options)


def test_a_side_is_refused_if_the_object_is_too_low():
    low = picture(abs(Y - 80.5) < 0.2)
    with pytest.raises(InputError, match=r"side.*too low.*Remove"):
        relief(low, side=low, count=500)


def test_a_back_that_was_mirrored_is_recognised():
    arm = ellipse(25) | ((abs(Y - 50) < 20) & (X > 80) & (X < 150))
    with pytest.raises(InputError, match="mirror it back"):
        relief(picture(arm), back=picture(arm), count=500)
    relief(picture(arm), back=picture(arm[:, ::-1]), count=500)
