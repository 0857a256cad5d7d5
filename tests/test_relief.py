"""relief: closed, bounded, deterministic, true to the picture in front."""

import threading

import numpy as np
import pytest
import scipy.ndimage as ndi

from phy124.camera import Camera
from phy124.errors import Cancelled, InputError
from phy124.gaussians import rotation_matrices
from phy124.generators.relief import VIEW_DISTANCE, relief
from phy124.generators.relief.height import Factors, Silhouette
from phy124.generators.relief.surface import Surface, spread
from phy124.particles.seeding import fill
from phy124.rendering.render import Renderer
from support.drawings import SIZE, X, Y, face, mug, picture

EVERYWHERE = [(0, 0), (60, 0), (90, 0), (180, 0), (270, 30), (30, -60), (0, 85)]


@pytest.fixture(scope="module")
def renderer():
    return Renderer(device="cpu")


@pytest.fixture(scope="module")
def a_face():
    return relief(face())


@pytest.fixture(scope="module")
def a_mug():
    return relief(mug(), count=30_000)


def test_a_disc_becomes_a_ball(a_face):
    """The object is as deep as wide, and as large as a ball whose image in the front camera is the
    disc."""
    low, high = a_face.means.min(axis=0), a_face.means.max(axis=0)
    radius = VIEW_DISTANCE * np.sin(np.arctan(0.5 / VIEW_DISTANCE))
    assert 45_000 < len(a_face) < 55_000
    np.testing.assert_allclose(high, radius, atol=0.02)
    np.testing.assert_allclose(low, -radius, atol=0.02)
    # No ridge along the rim: all centres are equally far below the ball's surface.
    assert np.ptp(np.linalg.norm(a_face.means, axis=1)) < 0.01
    normals = rotation_matrices(a_face.quats)[:, :, 2]
    # Outwards everywhere, thin across, round along the surface.
    assert ((normals * a_face.means).sum(axis=1) > 0).all()
    np.testing.assert_array_equal(a_face.scales[:, 0], a_face.scales[:, 1])
    assert (a_face.scales[:, 2] < 0.25 * a_face.scales[:, 0]).all()


def test_same_seed_same_gaussians():
    """Whether the picture comes as such or as an array."""
    first, again = relief(face(), count=4000), relief(np.asarray(face()), count=4000)
    other = relief(face(), seed=1, count=4000)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    assert (first.means[:9] != other.means[:9]).any()


@pytest.mark.parametrize("view", EVERYWHERE)
@pytest.mark.parametrize("name", ["a_face", "a_mug"])
def test_shell_has_no_holes(renderer, request, name, view):
    """The side towards the camera alone hides what is behind it, except close to its outline."""
    gaussians = request.getfixturevalue(name)
    camera = Camera.orbit(*view, VIEW_DISTANCE, 384)
    towards = np.asarray(camera.eye) - gaussians.means
    normals = rotation_matrices(gaussians.quats)[:, :, 2]
    near = gaussians.select((normals * towards).sum(axis=1) > 0)
    inside = ndi.binary_erosion(renderer(gaussians, camera, alpha=True)[..., 3] > 0.9, iterations=4)
    cover = renderer(near, camera, alpha=True)[..., 3]
    assert inside.sum() > 3000
    assert cover[inside].min() > 0.6
    assert np.mean(cover[inside] < 0.9) < 0.002


def psnr_of_front(renderer, gaussians, rgba, size):
    """Front view against the picture on white, drawn where the camera sees the plane x = 0."""
    camera = Camera.orbit(0, 0, VIEW_DISTANCE, size)
    rows, columns = np.nonzero(rgba[..., 3] > 127)
    reach = max(np.ptp(rows), np.ptp(columns)) + 1
    step = VIEW_DISTANCE / camera.focal * reach
    fine = (np.arange(4 * size) + 0.5) / 4 - size / 2
    y = (rows.min() + rows.max()) / 2 + fine * step
    x = (columns.min() + columns.max()) / 2 + fine * step
    white = rgba / 255.0
    white = white[..., :3] * white[..., 3:] + 1 - white[..., 3:]
    where = np.meshgrid(y, x, indexing="ij")
    channels = [ndi.map_coordinates(white[..., c], where, order=1, cval=1.0) for c in range(3)]
    wanted = np.stack(channels, axis=2).reshape(size, 4, size, 4, 3).mean(axis=(1, 3))
    return -10 * np.log10(np.mean((renderer(gaussians, camera) - wanted) ** 2))


@pytest.mark.parametrize("size", [256, 512])
def test_front_shows_the_picture(renderer, a_face, size):
    assert psnr_of_front(renderer, a_face, np.asarray(face()), size) > 28


def test_front_is_not_mirrored_or_upside_down(renderer):
    """Red to the left, a blue top: so in the picture, so from the front."""
    rgb = np.where((X < 96)[..., None], [220, 0, 0], [0, 200, 0])
    rgb = np.where((Y < 70)[..., None], [0, 0, 220], rgb).astype(np.uint8)
    gaussians = relief(picture(np.hypot(X - 96, Y - 96) < 80, rgb), count=10_000)
    seen = renderer(gaussians, Camera.orbit(0, 0, VIEW_DISTANCE, 128))
    for (row, column), colour in (((75, 50), 0), ((75, 78), 1), ((40, 64), 2)):
        assert seen[row, column].argmax() == colour


def test_flat_bottoms_stand_and_handles_stay_open(a_mug):
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


WEIRD = {
    "one pixel": picture((X == 8.5) & (Y == 8.5)),
    "tiny": picture(np.ones((16, 16))),
    "line": picture((Y == 96.5) & (abs(X - 96) < 80)),
    "flat": picture(np.ones((3, 1500))),
    "tall": picture(np.ones((1500, 3))),
    "pieces": picture((np.hypot(X - 40, Y - 40) < 25) | (np.hypot(X - 140, Y - 150) < 30)),
    "noise": picture(np.random.default_rng(0).random((64, 64)) > 0.5),
}


@pytest.mark.parametrize("name", WEIRD)
def test_weird_pictures_give_sound_gaussians(name):
    gaussians = relief(WEIRD[name], count=3000)
    assert len(gaussians) > 1000
    for field in ("means", "quats", "scales", "opacities", "sh"):
        assert np.isfinite(getattr(gaussians, field)).all()
    size = np.ptp(gaussians.means, axis=0)
    assert 0.78 < size.max() < 1.05  # a cube's front is nearer than its centre
    assert gaussians.scales.max() < 0.1
    np.testing.assert_allclose(
        gaussians.rgb, np.tile([200, 120, 60], (len(gaussians), 1)) / 255, atol=0.02
    )


def test_empty_pictures_are_refused():
    with pytest.raises(InputError, match="No part of the picture is opaque"):
        relief(picture(np.zeros((20, 20))))


def test_progress_can_cancel():
    def stop(stage, done, total):
        assert (stage, total) == ("relief", 4)
        if done == 1:
            raise Cancelled

    with pytest.raises(Cancelled):
        relief(face(), progress=stop)


def test_a_disc_inflates_like_a_ball():
    """Poisson's equation on a disc gives h^2 = r^2 - d^2; the rim lies where alpha says."""
    radius = np.hypot(X - 96.2, Y - 95.7)
    silhouette = Silhouette.of(np.clip(60.3 - radius + 0.5, 0, 1))
    u = silhouette.poisson(4.0)
    inside = silhouette.inside
    np.testing.assert_allclose(u[inside], (60.3**2 - radius**2)[inside], atol=0.02 * 60**2)


def test_points_are_spread_evenly():
    """On a shell, also where the surface is steep, spacing hardly varies on the front."""
    silhouette = Silhouette.of(np.clip(80.5 - np.hypot(X - 96, Y - 96), 0, 1))
    surface = Surface.of(silhouette.extend(silhouette.poisson(4.0)))
    points, normals, spacing, pitch = spread(surface, (), 20_000, np.random.default_rng(0))
    front = normals[:, 2] > 0
    assert np.std(spacing[front]) < 0.1 * np.mean(spacing[front])
    assert np.mean(spacing[front]) == pytest.approx(pitch, rel=0.15)
    value, gradient = surface.gradient(points)
    assert np.abs(value / np.linalg.norm(gradient, axis=1)).max() < 0.05


def test_the_ball_has_a_balls_volume(a_face):
    spacing = 0.03
    volume = len(fill(a_face, spacing)) * spacing**3
    radius = np.ptp(a_face.means[:, 1]) / 2
    assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.1)


def extents(gaussians, low, high):
    """Depth and width of what lies between two heights."""
    part = gaussians.means[(gaussians.means[:, 2] > low) & (gaussians.means[:, 2] < high)]
    return np.ptp(part[:, 0]), np.ptp(part[:, 1])


def shaded(mask, normal_x):
    """Lit from the front: darker where the surface turns away."""
    light = np.sqrt(np.clip(1 - normal_x**2, 0, 1))[..., None] * [200, 120, 60]
    return picture(mask, (60 + 0.7 * light).astype(np.uint8))


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


def outlines(renderer, gaussians, inputs):
    """Return the object's mask in a picture [H,W], and in the front camera's rendering of the same
    size."""
    wanted = np.asarray(inputs)[..., 3] > 127
    rows, columns = np.nonzero(wanted)
    longest = max(np.ptp(rows), np.ptp(columns)) + 1
    fov = np.degrees(2 * np.arctan(SIZE / 2 / (longest * VIEW_DISTANCE)))
    shift = tuple((middle.min() + middle.max() + 1 - SIZE) / 2 for middle in (columns, rows))
    camera = Camera((VIEW_DISTANCE, 0, 0), (0, 0, 0), SIZE, SIZE, float(fov), shift)
    return wanted, renderer(gaussians, camera, (0, 0, 0), alpha=True)[..., 3] > 0.5


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


def test_compact_round_shapes_are_turned():
    """An apple is as deep as wide at each height, also near its flat top."""
    apple = abs((X - 96) / 80) ** 3 + abs((Y - 96) / 76) ** 3 < 1
    gaussians = relief(shaded(apple, (X - 96) / 80), count=10_000)
    for low, high in ((-0.44, -0.4), (-0.05, 0.05), (0.4, 0.44)):
        depth, width = extents(gaussians, low, high)
        assert depth == pytest.approx(width, rel=0.1)


def test_steep_sides_have_no_streaks():
    """The noise of the picture is blurred where the picture is stretched along the surface."""
    mask = np.hypot(X - 96, Y - 96) < 80
    noise = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3), dtype=np.uint8)
    gaussians = relief(picture(mask, noise), count=10_000)
    normals = rotation_matrices(gaussians.quats)[:, :, 2]
    contrast = [
        gaussians.rgb[chosen].std(axis=0).mean()
        for chosen in (normals[:, 0] > 0.8, abs(normals[:, 0]) < 0.2)
    ]
    assert contrast[1] < 0.4 * contrast[0]


def test_straight_edges_without_shading_make_a_slab():
    """A square is a cube, a page is thin; with shading the page is a column."""
    square = (abs(X - 96) < 60) & (abs(Y - 96) < 60)
    page = (abs(X - 96) < 40) & (abs(Y - 96) < 80)
    depth, width = extents(relief(picture(square), count=5000), -0.2, 0.2)
    assert depth == pytest.approx(width, rel=0.1)
    thin, width = extents(relief(picture(page), count=5000), -0.2, 0.2)
    round_, _ = extents(relief(shaded(page, (X - 96) / 40), count=5000), -0.2, 0.2)
    assert thin < 0.4 * width < 0.9 * width < round_


def test_print_is_not_taken_for_shading():
    """A sign with a frame, letters and rounded corners is flat; a can with a label is round."""
    inside = 20 - np.hypot(np.maximum(abs(X - 96) - 60, 0), np.maximum(abs(Y - 96) - 20, 0))
    letters = (abs(Y - 96) < 15) & (abs(X - 96) < 60) & (X % 20 < 10)
    sign = np.where((letters | (inside < 5))[..., None], (160, 30, 30), (245, 240, 225))
    means = relief(picture(inside > 0, sign.astype(np.uint8)), count=5000).means
    assert np.ptp(means[:, 0]) < 0.2 * np.ptp(means[:, 1])
    label = np.where((abs(Y - 96) < 40)[..., None], (240, 235, 220), (200, 60, 40))
    turned = np.clip((X - 96) / 45, -1, 1)
    light = 0.75 + 0.25 * (0.85 * np.sqrt(1 - turned**2) - 0.45 * turned)
    can = (light[..., None] * label).astype(np.uint8)
    means = relief(picture((abs(X - 96) < 45) & (abs(Y - 96) < 80), can), count=5000).means
    assert np.ptp(means[:, 0]) == pytest.approx(np.ptp(means[:, 1]), rel=0.1)


def test_framed_gradient_is_not_taken_for_shading(renderer):
    """A phone is flat, and its rounded corners stay."""
    inside = 18 - np.hypot(np.maximum(abs(X - 96) - 27, 0), np.maximum(abs(Y - 96) - 62, 0))
    screen = np.stack([40 + 0.3 * Y, 50 + 0.8 * X, 180 - 0.3 * Y], axis=2)
    inputs = picture(inside > 0, np.where((inside < 5)[..., None], 15, screen).astype(np.uint8))
    phone = relief(inputs, count=20_000)
    assert np.ptp(phone.means[:, 0]) < 0.3 * np.ptp(phone.means[:, 1])
    wanted, seen = outlines(renderer, phone, inputs)
    assert (wanted & seen).sum() > 0.98 * (wanted | seen).sum()


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


def test_front_of_a_rounded_block_is_its_picture(renderer):
    """Flat ends neither rise above the picture, nor is there a groove below them."""
    x, y = (X - 96) / 70, (Y - 96) / 70
    light = (0.5 + 0.4 * np.clip((1 - x**2) * (1 - y**2), 0, 1))[..., None] * [220, 200, 170]
    inputs = picture(x**6 + y**6 < 1, light.astype(np.uint8))
    wanted, seen = outlines(renderer, relief(inputs, count=20_000), inputs)
    assert (wanted & seen).sum() > 0.97 * (wanted | seen).sum()


def test_stripes_go_round(renderer):
    """And at the same heights: red above, green below, seen from behind."""
    rgb = np.where((Y < 96)[..., None], [220, 0, 0], [0, 200, 0]).astype(np.uint8)
    gaussians = relief(picture(np.hypot(X - 96, Y - 96) < 80, rgb), count=10_000)
    seen = renderer(gaussians, Camera.orbit(180, 0, VIEW_DISTANCE, 128))
    for row, channel in ((45, 0), (83, 1)):
        assert seen[row, 64, channel] > 0.6 > 0.2 > seen[row, 64, 1 - channel]


def ramp():
    """A depth map of a disc whose left side is nearer than its right one, on a far background."""
    return np.where(np.hypot(X - 96, Y - 96) < 84, 300.0 - X, 0.0)


def test_a_depth_map_gives_the_front_its_shape(a_face):
    gaussians = relief(face(), count=5000, depth=ramp())
    front = gaussians.select(rotation_matrices(gaussians.quats)[:, 0, 2] > 0.3)
    left, right = (abs(front.means[:, 1] - side) < 0.05 for side in (-0.3, 0.3))
    assert front.means[left, 0].mean() > front.means[right, 0].mean() + 0.15
    # Its unit does not matter, nor does its resolution.
    doubled = relief(face(), count=5000, depth=np.kron(1000 + 3 * ramp(), np.ones((2, 2))))
    np.testing.assert_allclose(np.ptp(doubled.means, axis=0), np.ptp(gaussians.means, axis=0), 0.02)


def test_a_plane_depth_map_gives_a_plane_front():
    """Noise of rounding is not taken for shape."""
    noise = np.random.default_rng(0).integers(0, 2, (192, 192))
    gaussians = relief(face(), count=5000, depth=np.where(ramp() > 0, 200 + noise, 0))
    middle = np.hypot(gaussians.means[:, 1], gaussians.means[:, 2]) < 0.35
    front = gaussians.means[middle & (gaussians.means[:, 0] > 0), 0]
    assert np.ptp(front) < 0.05


@pytest.mark.parametrize(
    ("depth", "why"),
    [
        (-ramp(), "farther away than its surroundings.*--near black"),
        (ramp()[:, :100], "has 100 x 192 pixels, but the picture has 192 x 192"),
        (np.ones((192, 192)), "are equal"),
    ],
)
def test_depth_maps_that_cannot_be_meant_are_refused(depth, why):
    with pytest.raises(InputError, match=why):
        relief(face(), count=1000, depth=depth)


def test_factors_are_freed_by_the_thread_that_made_them(monkeypatch):
    threads = []

    class Made:
        def __init__(self, *_, **__):
            threads.append(threading.get_ident())

        def solve(self, values):
            return values

        def __del__(self):
            threads.append(threading.get_ident())

    monkeypatch.setattr("scipy.sparse.linalg.splu", Made)
    factors = Factors(None)
    assert factors.solve(3) == 3
    pool = factors._pool
    del factors
    pool.shutdown()
    assert threads[0] == threads[1] != threading.get_ident()
