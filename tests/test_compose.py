"""The object drawn back into its photograph: the camera, the colours, what is behind, the film."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.relief import relief
from phy124.io.clip import Clip
from phy124.rendering import frames
from phy124.rendering.compose import Photograph, compose
from phy124.rendering.compose.colours import Adjoint, match_colours
from phy124.rendering.compose.photograph import match
from phy124.rendering.render import Renderer, to_bytes
from phy124.scene import View
from support.clips import flight
from support.videos import read_video

pytestmark = pytest.mark.usefixtures("coarse_solids")

ROOT = Path(__file__).parents[1]
SIZE = (160, 120)


def patched(count: int = 3000) -> Gaussians:
    """A ball of 1 m with patches of colour, on z = 0."""
    rng = np.random.default_rng(5)
    away = rng.normal(size=(count, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    rgb = 0.5 + 0.4 * np.sin(5 * away @ rng.normal(size=(3, 3)))
    quats, scales = np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), 0.02)
    means = 0.48 * away + [0, 0, 0.5]
    return Gaussians.from_rgb(means, quats, scales, np.full(count, 0.95), rgb)


def photographed(gaussians: Gaussians, camera: Camera) -> Photograph:
    """Return the camera's picture of the object on a table in two greys."""
    image = Renderer(device="cpu")(gaussians, camera, (0, 0, 0), alpha=True)
    table = np.where(np.arange(camera.height)[:, None, None] < 70, 0.7, 0.5)
    rgb = image[..., :3] + (1 - image[..., 3:]) * table
    return Photograph(to_bytes(rgb.astype(np.float32)), image[..., 3].astype(np.float32))


def test_a_shifted_camera_sees_the_same_picture_elsewhere():
    g, fov = patched(), 40.0
    plain = Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), 100, 80, fov)
    shifted = Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), 100, 80, fov, (7.0, -5.0))
    seen, moved = (Renderer(device="cpu")(g, camera) for camera in (plain, shifted))
    np.testing.assert_allclose(moved[:-5, 7:], seen[5:, :-7], atol=2e-5)
    pixels, _ = shifted.project(np.zeros((1, 3)) + [0, 0, 0.5])
    assert pixels[0] == pytest.approx([57, 35])


def test_the_camera_of_a_photograph_is_found():
    fov = np.degrees(2 * np.arctan(60 / 170))
    true = Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), *SIZE, float(fov), (-21.3, 9.6))
    camera, quality = match(patched(), photographed(patched(), true))
    assert quality > 38
    # Which of distance and focal length it is cannot be told from a single picture.
    apparent = [
        item.focal / np.linalg.norm(np.subtract(item.eye, item.target)) for item in (camera, true)
    ]
    assert apparent[0] == pytest.approx(apparent[1], rel=5e-3)
    assert camera.centre == pytest.approx(true.centre, abs=0.3)


def test_an_end_drawn_straight_does_not_make_the_object_smaller():
    """Without perspective it is drawn as a line, and ours shows an arc below it."""
    picture = Image.open(ROOT / "demo/examples/cupcake.png").convert("RGBA")
    made, photograph = relief(picture, count=20_000), Photograph.of(picture, picture)
    camera, _ = match(made, photograph)
    assert match_colours(made, camera, photograph).psnr > 33


def test_seen_colours_approach_the_photograph():
    true = Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), *SIZE, 40.0)
    photograph = photographed(patched(), true)
    sh = patched().sh.copy()
    sh[:, 0] += np.random.default_rng(0).normal(scale=0.5, size=sh[:, 0].shape)
    g = patched()
    wrong = Gaussians(g.means, g.quats, g.scales, g.opacities, sh)
    before = match_colours(g, true, photograph).psnr
    result = match_colours(wrong, true, photograph)
    better = result.sh
    assert 30 < result.psnr <= before
    behind = g.means[:, 0] < -0.2
    np.testing.assert_array_equal(better[behind], sh[behind])
    assert (result.sizes[behind] == 1).all()
    assert np.abs(better - sh).max() > 0.1


@pytest.mark.parametrize("blend", ["simd", "pixel"])
def test_sums_by_gaussian_are_the_adjoint_of_drawing(rng, blend):
    """<W c, r> = <c, W^T r>, for colours that nothing clips."""
    g, camera = patched(400), Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), *SIZE, 40.0)
    colours = rng.uniform(0.1, 0.5, (400, 3))
    lit = Gaussians.from_rgb(g.means, g.quats, g.scales, 0.6 * g.opacities, colours)
    renderer, values = Adjoint(device="cpu", blend=blend), rng.normal(size=(*SIZE[::-1], 3))
    drawn = renderer(lit, camera, (0, 0, 0), alpha=True)
    sums, weights = renderer.sums(lit, camera, values)
    assert (colours * sums).sum() == pytest.approx((drawn[..., :3] * values).sum(), rel=1e-3)
    assert weights.sum() == pytest.approx(drawn[..., 3].sum(), rel=1e-3)


def test_both_forms_of_the_sums_agree_gaussian_by_gaussian(rng):
    g, camera = patched(2000), Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), *SIZE, 40.0)
    values = rng.normal(size=(*SIZE[::-1], 3))
    (sums, weights), (wanted, answer) = (
        Adjoint(device="cpu", blend=blend).sums(g, camera, values) for blend in ("simd", "pixel")
    )
    assert answer.max() > 1
    np.testing.assert_allclose(weights, answer, atol=1e-3 * answer.max())
    np.testing.assert_allclose(sums, wanted, atol=1e-3 * np.abs(wanted).max())


def test_background_behind_the_object_is_filled_from_around():
    photograph = photographed(patched(), Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), *SIZE, 60.0))
    filled = photograph.erase_object()
    away = photograph.alpha < 1e-3
    table = np.where(np.arange(120) < 70, 0.7, 0.5) * 255
    far = np.zeros_like(away)
    far[:, :8] = far[:, -8:] = True
    assert np.abs(filled[far].astype(float) - photograph.rgb[far]).max() <= 1
    assert away.any() and np.abs(filled.mean(axis=2) - table[:, None]).mean() < 12


def test_a_picture_that_is_all_object_leaves_white():
    photograph = Photograph(np.full((40, 40, 3), 90, np.uint8), np.ones((40, 40), np.float32))
    assert (photograph.erase_object() == 255).all()


def test_a_photograph_without_an_object_is_refused():
    empty = Image.new("RGBA", (64, 64))
    with pytest.raises(InputError, match="it shows no part of the object"):
        Photograph.of(empty, empty)


def test_the_first_picture_is_the_photograph(tmp_path, monkeypatch):
    camera = Camera((2.0, 0.0, 0.5), (0.0, 0.0, 0.5), *SIZE, 50.0)
    photograph = photographed(patched(), camera)
    still = flight([(0, 0, 0), (0, 0, 0)])
    g = patched()
    clip = Clip(
        np.stack([g.means, g.means + np.float32([0, 0.3, 0])]),
        np.stack([g.quats] * 2),
        np.stack([g.scales] * 2),
        g.opacities,
        g.sh,
        still.times,
    )
    render_frames, threads = frames.render_frames, []

    def render(*args, **options):
        threads.append(options["threads"])
        return render_frames(*args, **options)

    monkeypatch.setattr("phy124.rendering.compose.render_frames", render)
    path, about = compose(clip, View(), photograph, tmp_path, threads=3)
    assert threads == [3]
    assert about["psnr"] >= about["psnr_before"] > 30
    first, last = read_video(path).astype(float)
    inside, outside = photograph.alpha > 0.99, np.zeros((120, 160), bool)
    outside[:40, :30] = True
    for place, bound in ((inside, 24), (outside, 35)):  # MP4s lose colour
        error = ((first - photograph.rgb)[place] ** 2).mean() + 1e-6
        assert 10 * np.log10(255**2 / error) > bound
    assert np.abs(last - first)[inside].mean() > 5


@pytest.mark.slow
def test_generate_composes_and_so_does_render_afterwards(tmp_path, capsys):
    out = tmp_path / "out"
    command = ["generate", "demo/examples/duck.png", "--accuracy", "draft", "--frames", "3"]
    assert main([*command, "--views", "front", "--compose", "--out", str(out)]) == 0
    assert "first frame and photograph, " in capsys.readouterr().out
    assert json.loads((out / "report.json").read_text("utf-8"))["compose"]["psnr"] > 30
    first = read_video(out / "composed.mp4")
    (out / "composed.mp4").unlink()
    again = ["render", str(out / "clip.safetensors"), "--compose", "demo/examples/duck.png"]
    assert main([*again, "--views", "front"]) == 0
    np.testing.assert_array_equal(read_video(out / "composed.mp4"), first)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--generator", "x.ply"], "does not use a picture"),
        (["--resume"], "Resume the run without --compose"),
    ],
)
def test_impossible_composition_is_refused_before_any_work(tmp_path, capsys, more, words):
    command = ["generate", "demo/examples/duck.png", "--compose", "--out", str(tmp_path / "out")]
    assert main([*command, *more]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_clip_without_a_cutout_cannot_be_composed(tmp_path, capsys):
    flight([(0, 0, 0)]).save(tmp_path / "clip.safetensors")
    command = ["render", str(tmp_path / "clip.safetensors"), "--views", "front", "--size", "32"]
    assert main([*command, "--compose", "demo/examples/duck.png"]) == 2
    assert "has no cutout.png" in capsys.readouterr().err
    (tmp_path / "cutout.png").write_text("no picture")
    assert main([*command, "--compose", "demo/examples/duck.png"]) == 2
    assert "cutout.png: It is not a PNG" in capsys.readouterr().err
