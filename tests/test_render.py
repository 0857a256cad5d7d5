"""The renderer against an independent compositor: float64, whole image, no tiles, no boxes."""

import math
import tracemalloc

import numpy as np
import pytest
import warp as wp

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions, rotate_sh, rotation_matrices, sh_basis
from phy124.rendering import render
from phy124.rendering.projection import FILTERS, NEAR
from phy124.rendering.render import Renderer
from support.shapes import splats as cloud

FORMS = ("simd", "plain", "pixel")


@pytest.fixture(scope="module")
def renderers() -> dict[str, Renderer]:
    return {form: Renderer(device="cpu", blend=form) for form in FORMS}


def reference(
    gaussians: Gaussians, camera: Camera, background=(1.0, 1.0, 1.0), filter="dilate"
) -> np.ndarray:
    """Kerbl et al. 2023 written out plainly; [H,W,4], the last channel the coverage."""
    low_pass, keeps_light = FILTERS[filter]
    seen = gaussians.means.astype(float) @ camera.view[:3, :3].T + camera.view[:3, 3]
    directions = gaussians.means - np.array(camera.eye)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = sh_basis(directions, gaussians.sh.shape[1])
    colours = np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", basis, gaussians.sh.astype(float)))
    covariances = gaussians.covariances()
    tangent = 1.3 * np.array([camera.width, camera.height]) / 2 / camera.focal
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    light, left = np.zeros((camera.height, camera.width, 3)), np.ones((camera.height, camera.width))
    done = np.zeros_like(left, bool)
    for i in np.argsort(seen[:, 2], kind="stable"):
        depth, f = seen[i, 2], camera.focal
        if depth <= NEAR:
            continue
        u, v = np.clip(seen[i, :2] / depth, -tangent, tangent)
        jacobian = f / depth * np.array([[1, 0, -u], [0, 1, -v]]) @ camera.view[:3, :3]
        sharp = jacobian @ covariances[i] @ jacobian.T
        wide = sharp + low_pass * np.eye(2)
        conic, opacity = np.linalg.inv(wide), gaussians.opacities[i]
        if keeps_light:
            opacity = opacity * np.sqrt(max(np.linalg.det(sharp) / np.linalg.det(wide), 0))
        dx = x - (f * seen[i, 0] / depth + camera.width / 2)
        dy = y - (f * seen[i, 1] / depth + camera.height / 2)
        power = conic[0, 0] * dx * dx + 2 * conic[0, 1] * dx * dy + conic[1, 1] * dy * dy
        alpha = np.minimum(0.99, opacity * np.exp(-power / 2))
        rest = left * (1 - alpha)
        hit = (alpha >= 1 / 255) & ~done
        done |= hit & (rest < 1e-4)
        hit &= ~done
        light += np.where(hit, alpha * left, 0)[..., None] * colours[i]
        left = np.where(hit, rest, left)
    image = np.minimum(1, light + left[..., None] * np.array(background))
    return np.dstack([image, 1 - left])


def needles(rng) -> Gaussians:
    """Hair, 500 times as long as thick, and plates as thin."""
    g = cloud(rng, 400, spread=0.25)
    scales = np.where(np.arange(400)[:, None] % 2, [0.5, 0.001, 0.001], [0.2, 0.2, 0.0005])
    return Gaussians(g.means, g.quats, scales, g.opacities, g.sh)


def around_camera(rng) -> Gaussians:
    """Gaussians everywhere: behind the camera, beside it, and in front by millimetres."""
    g = cloud(rng, 500, spread=1.0)
    means = g.means.copy()
    means[:40] = np.array([1.5, 0, 0]) + rng.normal(size=(40, 3)) * 0.02
    return Gaussians(means, g.quats, g.scales, g.opacities, g.sh)


SCENES = {
    "cloud": (cloud, Camera.orbit(0, 0, 1.5, 96), (1, 1, 1)),
    "needles": (needles, Camera.orbit(40, 20, 1.5, 96), (0, 0, 0)),
    "odd size": (cloud, Camera.orbit(10, 5, 1.5, (117, 61)), (0.2, 0.5, 0.9)),
    "one row": (cloud, Camera.orbit(10, 5, 1.5, (50, 1)), (1, 0, 0)),
    "harmonics off axis": (
        lambda rng: cloud(rng, degree=3),
        Camera.orbit(200, -35, 1.1, (90, 70), target=(0.3, -0.2, 0.4), fov_y=80),
        (1, 1, 1),
    ),
    "degree 1": (lambda rng: cloud(rng, degree=1), Camera.orbit(90, 89, 1.3, 64), (1, 1, 1)),
    "degree 2": (lambda rng: cloud(rng, degree=2), Camera.orbit(0, 90, 1.3, 64), (1, 1, 1)),
    "around the camera": (around_camera, Camera.orbit(0, 0, 1.5, (80, 96)), (1, 1, 1)),
    "opaque": (lambda rng: cloud(rng, 1500, sizes=0.06), Camera.orbit(0, 0, 1.2, 80), (1, 1, 1)),
}


@pytest.mark.parametrize("name", SCENES)
def test_every_form_agrees_with_the_plain_compositor(renderers, rng, name):
    make, camera, background = SCENES[name]
    gaussians = make(rng)
    wanted = reference(gaussians, camera, background)
    assert wanted[..., 3].max() > 0.5  # there is something to see
    for form in FORMS:
        image = renderers[form](gaussians, camera, background, alpha=True)
        assert image.shape == wanted.shape and image.dtype == np.float32
        error = np.abs(image - wanted)
        # A contribution right at 1/255 may fall on either side: at most 1/255, and rarely.
        assert error.max() <= 1 / 255
        assert (error.max(axis=2) > 5e-4).mean() < 0.005
        assert -10 * math.log10((error**2).mean()) > 60


def huge(rng) -> Gaussians:
    g = cloud(rng, 60, spread=1.5)
    means = g.means - np.array([4.0, 0, 0])
    return Gaussians(means, g.quats, 20 * g.scales, g.opacities, g.sh)


def coincident(rng) -> Gaussians:
    """Twenty in one place, of one size: their order is that of the array."""
    g = cloud(rng, 20)
    means, scales = np.zeros((20, 3)), np.full((20, 3), 0.2)
    return Gaussians(means, g.quats, scales, 0.3 * g.opacities, g.sh)


JUDGED = {
    "random": lambda rng: cloud(rng, 600),
    "thin": needles,
    "huge": huge,
    "around the camera": around_camera,
    "coincident": coincident,
    "one": lambda rng: cloud(rng, 1, sizes=0.2, spread=0.0),
}


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("name", JUDGED)
def test_single_precision_costs_less_than_80_db(name, filter, rng):
    """Tolerance of the image; a contribution of exactly 1/255 may be drawn or skipped."""
    gaussians, camera = JUDGED[name](rng), Camera.orbit(30, 15, 1.5, (96, 80))
    wanted = reference(gaussians, camera, filter=filter)
    assert wanted[..., 3].max() > 0.1
    image = Renderer(device="cpu", filter=filter)(gaussians, camera, alpha=True)
    assert -10 * math.log10(((image - wanted) ** 2).mean() + 1e-20) > 80


def test_mip_pictures_are_as_bright_however_small(rng):
    """A thin wire seen from ever farther away: dilated, it becomes far too thick."""
    wire = Gaussians.from_rgb(
        np.zeros((1, 3)),
        np.array([[1.0, 0, 0, 0]]),
        np.array([[0.002, 0.002, 0.2]]),
        np.array([0.9]),
        np.ones((1, 3)),
    )
    shares = {}
    for filter in FILTERS:
        renderer = Renderer(device="cpu", filter=filter)
        covered = [
            renderer(wire, Camera.orbit(0, 0, 1.5, size), alpha=True)[..., 3].sum() / size**2
            for size in (512, 64)
        ]
        shares[filter] = covered[1] / covered[0]
    assert shares["dilate"] > 2.5 and shares["mip"] < 1.5


def test_no_filter_of_another_name():
    with pytest.raises(InputError, match="Choose dilate or mip"):
        Renderer(device="cpu", filter="none")


def test_the_forms_agree_with_each_other(renderers, rng):
    gaussians, camera = cloud(rng, 3000, degree=3), Camera.orbit(30, 20, 1.4, (150, 110))
    images = {form: renderers[form](gaussians, camera) for form in FORMS}
    # Not bit for bit: each kernel fuses products and sums where its own code lets it.
    np.testing.assert_allclose(images["plain"], images["pixel"], atol=1e-6)
    assert np.abs(images["simd"] - images["plain"]).max() < 1 / 255


def test_one_gaussian_in_the_middle(renderers):
    g = Gaussians.from_rgb(
        np.zeros((1, 3)),
        np.array([[1.0, 0, 0, 0]]),
        np.full((1, 3), 0.05),
        np.array([0.8]),
        np.array([[0.9, 0.3, 0.1]]),
    )
    for size in ((33, 33), (32, 32), (47, 20)):
        for form in FORMS:
            image = renderers[form](g, Camera.orbit(0, 0, 1.5, size), (0, 0, 1), alpha=True)
            np.testing.assert_allclose(image, image[::-1], atol=2e-6)
            np.testing.assert_allclose(image, image[:, ::-1], atol=2e-6)
            if size == (33, 33):  # the middle pixel's centre is on the axis
                expected = 0.8 * np.array([0.9, 0.3, 0.1, 1]) + 0.2 * np.array([0, 0, 1, 0])
                np.testing.assert_allclose(image[16, 16], expected, atol=1e-6)


def test_lists_shuffled_as_on_a_gpu_are_put_in_order(renderers, rng, monkeypatch):
    g, camera = cloud(rng), Camera.orbit(0, 0, 1.5, 64)
    whole, launch, lengths = renderers["pixel"](g, camera), wp.launch, []

    def shuffling(kernel, dim, **options):
        """Threads of a GPU come in any order: here, the last first."""
        if kernel is not render.project.bin_parallel:
            return launch(kernel, dim, **options)
        ends, ranks, lists = (array.numpy() for array in options["outputs"])
        starts = ends.copy()
        launch(kernel, dim, **options)
        for start, end in zip(starts, ends, strict=True):
            ranks[start:end] = ranks[start:end][::-1].copy()
            lists[start:end] = lists[start:end][::-1].copy()
            lengths.append(end - start)

    monkeypatch.setattr(wp, "launch", shuffling)
    np.testing.assert_array_equal(renderers["pixel"](g, camera), whole)
    assert max(lengths) > 50


def test_turning_scene_and_camera_together_changes_nothing(renderers, rng):
    g = cloud(rng, degree=3)
    camera, turned_camera = Camera.orbit(20, 25, 1.4, 80), Camera.orbit(95, 25, 1.4, 80)
    half = math.radians(75) / 2
    turn = np.array([[math.cos(half), 0, 0, math.sin(half)]])
    rotation = rotation_matrices(turn)[0]
    turned = Gaussians(
        g.means @ rotation.T,
        quaternions(rotation @ rotation_matrices(g.quats)),
        g.scales,
        g.opacities,
        rotate_sh(g.sh, turn.repeat(len(g), 0)),
    )
    image, again = renderers["simd"](g, camera), renderers["simd"](turned, turned_camera)
    assert np.abs(image - again).max() < 1 / 255
    assert np.abs(image - again).mean() < 1e-5
    assert np.abs(image - renderers["simd"](g, turned_camera)).max() > 0.1


def test_front_hides_back_and_right_is_plus_y(renderers):
    means = np.array([[0.3, 0, 0], [-0.3, 0, 0], [0, 0.4, 0.2]])
    g = Gaussians.from_rgb(
        means, np.tile([1.0, 0, 0, 0], (3, 1)), np.full((3, 3), 0.05), np.ones(3), np.eye(3)
    )
    front = renderers["simd"](g, Camera.orbit(0, 0, 1.5, 64), (0, 0, 0))
    assert front[31, 31].argmax() == 0 and front[31, 31, 0] > 0.9
    blue = np.unravel_index(front[..., 2].argmax(), (64, 64))
    assert blue[0] < 32 < blue[1]  # up and to the right
    back = renderers["simd"](g, Camera.orbit(180, 0, 1.5, 64), (0, 0, 0))
    assert back[31, 31].argmax() == 1


@pytest.mark.parametrize("form", FORMS)
def test_non_finite_gaussians_are_not_drawn(renderers, rng, form):
    g, camera = cloud(rng, 300), Camera.orbit(0, 0, 1.5, 64)
    broken = {
        name: getattr(g, name).copy() for name in ("means", "quats", "scales", "opacities", "sh")
    }
    broken["means"][0], broken["means"][1, 2] = np.nan, np.inf
    broken["quats"][2] = np.nan
    broken["scales"][3], broken["scales"][4] = np.nan, 1e30
    broken["opacities"][5], broken["opacities"][6] = np.nan, np.inf
    broken["sh"][7, 0, 1], broken["sh"][8] = np.nan, np.inf
    broken["opacities"][9] = -1
    image = renderers[form](Gaussians(**broken), camera)
    assert np.isfinite(image).all()
    kept = g.select(np.arange(10, 300))
    np.testing.assert_array_equal(image, renderers[form](kept, camera))


@pytest.mark.parametrize("form", FORMS)
def test_gigantic_gaussians_are_drawn_and_end(renderers, rng, form):
    g, camera = cloud(rng, 400), Camera.orbit(0, 0, 1.5, (200, 130))
    scales = np.repeat([[100.0], [1e4], [1e-12], [1e6]], 100, axis=0) * np.ones(3)
    big = Gaussians(g.means, g.quats, scales, np.full(400, 0.02), g.sh)
    image = renderers[form](big, camera, alpha=True)
    assert np.isfinite(image).all() and image.min() >= 0 and image.max() <= 1
    assert image[..., 3].min() > 0.97  # 200 veils of 2 %
    zero_turn = Gaussians(g.means, np.zeros((400, 4)), g.scales, g.opacities, g.sh)
    assert np.isfinite(renderers[form](zero_turn, camera)).all()


@pytest.mark.parametrize("form", FORMS)
def test_bounded_lists_give_the_same_image(renderers, rng, form, monkeypatch):
    g, camera = cloud(rng, 800), Camera.orbit(0, 0, 1.5, (130, 90))
    whole = renderers[form](g, camera)
    monkeypatch.setattr(render, "MAX_PAIRS", 700)  # fewer than some single tile holds
    small = Renderer(device="cpu", blend=form)
    np.testing.assert_array_equal(small(g, camera), whole)
    assert small._buffers["lists"].size < 2 * 1.2 * 801


def test_started_pictures_are_those_of_single_calls(rng, monkeypatch):
    g, renderer = cloud(rng, 800), Renderer(device="cpu", blend="pixel")
    cameras = [Camera.orbit(azimuth, 0, 1.5, (130, 90)) for azimuth in (0, 40, 80)]
    expected = [render.to_bytes(renderer(g, camera)) for camera in cameras]
    reads = []
    read = wp.array.numpy
    monkeypatch.setattr(wp.array, "numpy", lambda array: reads.append(array.size) or read(array))
    renderer._room = 10  # far too few entries, so that every picture is drawn twice
    waits = [renderer.start_picture(g, camera) for camera in cameras]
    assert not reads, "a GPU would have to wait for these"
    for wait, picture in zip(waits, expected, strict=True):
        np.testing.assert_array_equal(wait(), picture)
    reads.clear()
    renderer.picture(g, cameras[0])
    assert sorted(reads) == [1, 130 * 90 * 3], "the number of entries, and a byte per channel"


def test_pictures_are_copied_before_buffers_are_reused(rng, monkeypatch):
    """Another thread may start a picture as soon as the lock of the GPU is free."""
    g, renderer = cloud(rng, 800), Renderer(device="cpu", blend="pixel")
    front, side = (Camera.orbit(azimuth, 0, 1.5, (130, 90)) for azimuth in (0, 80))
    expected = renderer.picture(g, front)
    finish = renderer._finish

    def start_another(*arguments):
        drawn = finish(*arguments)
        renderer.start_picture(g, side)
        return drawn

    monkeypatch.setattr(renderer, "_finish", start_another)
    np.testing.assert_array_equal(renderer.picture(g, front), expected)


def test_runs_cover_every_tile_once_within_the_limit():
    counts = np.array([5, 0, 0, 7, 30, 1, 1, 1, 0])
    runs = list(render.runs(counts, 10))
    assert [a for a, _ in runs[1:]] == [b for _, b in runs[:-1]]
    assert runs[0][0] == 0 and runs[-1][1] == len(counts)
    assert all(counts[a:b].sum() <= 10 or b - a == 1 for a, b in runs)
    assert list(render.runs(counts, 100)) == [(0, 9)]


@pytest.mark.parametrize("form", FORMS)
def test_one_renderer_takes_any_sequence_of_sizes(rng, form):
    renderer = Renderer(device="cpu", blend=form)
    for count, size in ((50, (40, 30)), (900, (100, 120)), (0, (33, 7)), (300, (16, 16))):
        g, camera = cloud(rng, count), Camera.orbit(0, 0, 1.5, size)
        image = renderer(g, camera, (0.1, 0.2, 0.3))
        kept = image.copy()
        fresh = Renderer(device="cpu", blend=form)(g, camera, (0.1, 0.2, 0.3))
        np.testing.assert_array_equal(image, fresh)
        renderer(cloud(rng, 100), camera)
        np.testing.assert_array_equal(image, kept)  # not a view of the renderer's buffer
    np.testing.assert_allclose(
        renderer(cloud(rng, 0), camera, (0.1, 0.2, 0.3))[0, 0], [0.1, 0.2, 0.3]
    )


def test_a_picture_is_the_image_in_bytes(rng):
    renderer, g, camera = Renderer(device="cpu"), cloud(rng, 900), Camera.orbit(0, 0, 1.5, (60, 40))
    picture = renderer.picture(g, camera, (0.1, 0.2, 0.3))
    kept = picture.copy()
    assert picture.dtype == np.uint8 and picture.shape == (40, 60, 3)
    np.testing.assert_array_equal(picture, render.to_bytes(renderer(g, camera, (0.1, 0.2, 0.3))))
    np.testing.assert_array_equal(picture, kept)  # not a view of the renderer's buffer


def test_a_further_picture_needs_no_memory_but_its_own(rng):
    renderer, g, camera = Renderer(device="cpu"), cloud(rng, 800), Camera.orbit(0, 0, 1.5, 256)
    renderer.picture(g, camera)
    tracemalloc.start()
    picture = renderer.picture(g, camera)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert picture.nbytes < most < 1.5 * picture.nbytes


def test_a_second_frame_allocates_nothing_on_the_device(rng, monkeypatch):
    renderer, g, camera = Renderer(device="cpu"), cloud(rng, 800), Camera.orbit(0, 0, 1.5, 64)
    first = renderer(g, camera)
    made = []
    for name in ("empty", "zeros", "full"):
        plain = getattr(wp, name)
        monkeypatch.setattr(wp, name, lambda *a, plain=plain, **k: made.append(1) or plain(*a, **k))
    before = {name: buffer.ptr for name, buffer in renderer._buffers.items()}
    np.testing.assert_array_equal(renderer(g, camera), first)
    assert {name: buffer.ptr for name, buffer in renderer._buffers.items()} == before
    assert not made


@pytest.mark.parametrize(
    ("options", "call", "words"),
    [
        ({"device": "cuda:97"}, {}, "no such device"),
        ({"blend": "fast"}, {}, "form of blending"),
        ({}, {"background": (1, 1, 2)}, "from 0 to 1"),
        ({}, {"background": (1, 1, math.nan)}, "from 0 to 1"),
        ({}, {"camera": Camera.orbit(0, 0, 0.0, 64)}, "eye and target apart"),
        ({}, {"camera": Camera.orbit(0, 0, 1.5, 64, fov_y=180)}, "fov_y"),
        ({}, {"camera": Camera.orbit(0, 0, 1.5, (0, 64))}, "512 x 512"),
        ({}, {"camera": Camera.orbit(0, 0, 1.5, 100_000)}, "pixels"),
    ],
)
def test_refusals(three_gaussians, options, call, words):
    with pytest.raises(InputError, match=words):
        renderer = Renderer(**{"device": "cpu", **options})
        renderer(three_gaussians, **{"camera": Camera.orbit(0, 0, 1.5, 64), **call})


@pytest.mark.gpu
def test_cuda_agrees_with_the_cpu(renderers, rng, gpu):
    g, camera = cloud(rng, 5000, degree=3), Camera.orbit(30, 20, 1.4, (250, 190))
    error = np.abs(Renderer(device=gpu)(g, camera) - renderers["simd"](g, camera))
    assert error.max() <= 1 / 255 and (error > 1e-3).mean() < 0.001
