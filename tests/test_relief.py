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
    small = face().resize((96, 96))
    first, again = relief(small, count=4000), relief(np.asarray(small), count=4000)
    other = relief(small, seed=1, count=4000)
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


@pytest.mark.parametrize("size", [256, pytest.param(512, marks=pytest.mark.slow)])
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


WEIRD = {
    "one pixel": picture((X == 8.5) & (Y == 8.5)),
    "tiny": picture(np.ones((16, 16))),
    "line": picture((Y == 96.5) & (abs(X - 96) < 80)),
    "flat": picture(np.ones((3, 1500))),
    "tall": picture(np.ones((1500, 3))),
    "pieces": picture((np.hypot(X - 40, Y - 40) < 25) | (np.hypot(X - 140, Y - 150) < 30)),
    "noise": picture(np.random.default_rng(0).random((64, 64)) > 0.5),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] * (n in ("tiny", "one pixel"))) for n in WEIRD],
)
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


def test_stripes_go_round(renderer):
    """And at the same heights: red above, green below, seen from behind."""
    rgb = np.where((Y < 96)[..., None], [220, 0, 0], [0, 200, 0]).astype(np.uint8)
    gaussians = relief(picture(np.hypot(X - 96, Y - 96) < 80, rgb), count=10_000)
    seen = renderer(gaussians, Camera.orbit(180, 0, VIEW_DISTANCE, 128))
    for row, channel in ((45, 0), (83, 1)):
        assert seen[row, 64, channel] > 0.6 > 0.2 > seen[row, 64, 1 - channel]


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
