"""CLIP-T against the golden numbers; pictures and physics against exact answers."""

import json
import math
import re
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from transformers import CLIPConfig, CLIPModel, CLIPVisionConfig, CLIPVisionModelWithProjection

from phy124.commands.evaluate import Evaluate
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.metrics import (
    centre_paths_differ,
    evaluate,
    flicker,
    measure_physics,
    motion,
    psnr,
    similarity,
    ssim,
)
from support.clips import with_floor

TINY = {
    "hidden_size": 32,
    "intermediate_size": 64,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "image_size": 32,
    "patch_size": 8,
    "projection_dim": 16,
}


@pytest.fixture(scope="module")
def tiny_clip(tmp_path_factory):
    """A folder as huggingface.co has it, with a tiny CLIP of random weights."""
    folder = tmp_path_factory.mktemp("clip")
    torch.manual_seed(0)
    CLIPVisionModelWithProjection(CLIPVisionConfig(**TINY)).save_pretrained(folder)
    return str(folder)


def falling(frames=6, fps=24.0, count=50, speed=0.0) -> Clip:
    """Gaussians in free fall, each frame exact."""
    rng = np.random.default_rng(0)
    rest = rng.uniform(-0.5, 0.5, (count, 3))
    t = np.arange(frames) / fps
    path = np.stack([speed * t, 0 * t, -0.5 * 9.81 * t**2], axis=1)
    v = np.stack([speed + 0 * t, 0 * t, -9.81 * t], axis=1)
    return Clip(
        means=(rest + path[:, None]).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (frames, count, 1)),
        scales=np.full((frames, count, 3), 0.02, np.float32),
        opacities=np.ones(count, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
        times=t,
        velocities=np.repeat(v[:, None], count, axis=1).astype(np.float32),
        report={"mass": 2.5},
    )


def test_both_formulas_equal_the_golden_numbers(golden):
    expected = np.load(golden / "generators/clip_t.npz")
    for i, embeddings in enumerate(expected["emb"]):
        np.testing.assert_allclose(
            similarity.cosine_pairs(embeddings), expected["cosine_pairs"][i], rtol=1e-10
        )
        np.testing.assert_allclose(
            similarity.distance_pairs(embeddings), expected["spherical_pairs"][i], rtol=1e-9
        )
        assert similarity.cosine(embeddings) == pytest.approx(expected["cosine_mean"][i])
        assert similarity.distance(embeddings) == pytest.approx(expected["spherical_mean"][i])


def test_distance_is_half_the_squared_angle_even_where_tiny():
    for angle in (1e-6, 0.1, 2.0, math.pi):
        rows = np.array([[1.0, 0], [math.cos(angle), math.sin(angle)]]) * 7
        assert similarity.distance(rows) == pytest.approx(angle**2 / 2, rel=1e-6)
        assert similarity.cosine(rows) == pytest.approx(math.cos(angle))
    with pytest.raises(ValueError, match="must have shape"):
        similarity.cosine(np.ones((1, 4)))


def test_clip_embeds_pictures_as_transformers_does(tiny_clip, rng):
    images = (rng.random((3, 40, 48, 3)) * 255).astype(np.uint8)
    model = similarity.ClipModel(tiny_clip)
    rows = model(images)
    assert rows.shape == (3, 16)
    network = CLIPVisionModelWithProjection.from_pretrained(tiny_clip).eval()
    pixels = np.stack([similarity._pixels(image, 32, "rgb") for image in images])
    with torch.inference_mode():
        wanted = network(pixel_values=torch.from_numpy(pixels)).image_embeds
    np.testing.assert_allclose(rows, wanted, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(model(images / 255), rows, atol=1e-6)
    red = similarity._pixels(np.full((8, 8, 3), [255, 0, 0], np.uint8), 32, "rgb")
    assert red[0].min() > 1 > -1 > red[1:].max()
    other = similarity.ClipModel(tiny_clip, order="bgr")(images[..., ::-1])
    np.testing.assert_allclose(other, rows, atol=1e-6)


def test_whole_clip_models_serve_as_well(tmp_path, rng):
    """Repositories hold both towers; the answer is that of CLIP's own picture features."""
    torch.manual_seed(0)
    text = {k: v for k, v in TINY.items() if k not in ("image_size", "patch_size")}
    text |= {"vocab_size": 99, "max_position_embeddings": 8, "bos_token_id": 1, "eos_token_id": 2}
    both = CLIPModel(CLIPConfig(vision_config=TINY, text_config=text, projection_dim=16)).eval()
    both.save_pretrained(tmp_path)
    images = (rng.random((2, 32, 32, 3)) * 255).astype(np.uint8)
    pixels = np.stack([similarity._pixels(image, 32, "rgb") for image in images])
    with torch.inference_mode():
        vision = both.vision_model(pixel_values=torch.from_numpy(pixels)).pooler_output
        wanted = both.visual_projection(vision)
    rows = similarity.ClipModel(str(tmp_path))(images)
    np.testing.assert_allclose(rows, wanted, rtol=1e-4, atol=1e-6)


def test_missing_and_foreign_clip_models_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    with pytest.raises(InputError, match=r"phy124 weights fetch clip"):
        similarity.ClipModel()
    for name in (str(tmp_path), "nobody/nothing"):
        with pytest.raises(
            InputError, match=r"not a CLIP model that is stored on this machine.*hf download"
        ):
            similarity.ClipModel(name)


@pytest.mark.parametrize("brightness", [1, 0.03])
def test_psnr_and_ssim_equal_skimage(rng, brightness):
    a = brightness * rng.random((40, 30, 3))
    b = np.clip(a + 0.1 * brightness * rng.normal(size=a.shape), 0, 1)
    assert psnr(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=1))
    wanted = structural_similarity(
        a,
        b,
        channel_axis=2,
        data_range=1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    assert ssim(a, b) == pytest.approx(wanted, abs=1e-6)
    assert psnr(a, a) == math.inf and ssim(a, a) == pytest.approx(1)
    bytes_ = (a * 255).astype(np.uint8)
    assert psnr(bytes_, bytes_ / 255) == math.inf


def test_motion_and_flicker_separate_videos(rng):
    still = np.repeat(rng.random((1, 8, 8, 3)), 5, axis=0)
    assert motion(still) == 0 and flicker(still) == 0
    ramp = np.linspace(0, 1, 5)[:, None, None, None] * np.ones((5, 8, 8, 3))
    assert motion(ramp) == pytest.approx(25) and flicker(ramp) == pytest.approx(0, abs=1e-12)
    blink = (np.arange(5) % 2)[:, None, None, None] * np.ones((5, 8, 8, 3))
    assert motion(blink) == 100 and flicker(blink) == pytest.approx(100)
    moving = np.ones((9, 8, 16, 3))
    for t in range(9):
        moving[t, 2:6, t + 1 : t + 5] = 0.2
    assert motion(moving) > 1 and flicker(moving) == pytest.approx(0, abs=1e-12)
    assert motion(blink[:1]) == 0 and flicker(blink[:2]) == 0


def test_physics_of_exact_free_fall():
    clip = falling(speed=3.0)
    p = measure_physics(clip)
    assert p.mass == 2.5 and p.finite
    assert (p.volume_lowest, p.volume_highest) == pytest.approx((1, 1))
    # The trapezoid is exact for constant acceleration.
    assert p.momentum_residual == pytest.approx(0, abs=1e-5)
    size = float(np.ptp(clip.means[0], axis=0).max())
    assert p.travelled == pytest.approx(math.hypot(0.625, 0.21289) / size, rel=0.03)


def test_physics_of_one_gaussian_is_in_metres():
    assert measure_physics(falling(count=1)).travelled == pytest.approx(0.21289, rel=0.01)


def test_physics_does_not_count_surroundings():
    clips = falling(speed=1.0), falling(speed=0.9)
    floored = [with_floor(clip) for clip in clips]
    assert asdict(measure_physics(floored[0])) == pytest.approx(asdict(measure_physics(clips[0])))
    assert centre_paths_differ(*floored) == pytest.approx(centre_paths_differ(*clips))


def test_physics_sees_cheats():
    honest = falling()
    frozen = falling()
    frozen.means[:] = frozen.means[0]
    at_rest = measure_physics(frozen)
    assert at_rest.momentum_residual > 0.5 and at_rest.travelled == 0
    swollen = falling()
    swollen.scales[3] *= 2
    assert measure_physics(swollen).volume_highest == pytest.approx(8)
    broken = falling()
    broken.means[2, 0, 0] = np.nan
    seen = measure_physics(broken)
    assert not seen.finite and seen.travelled == pytest.approx(measure_physics(honest).travelled)
    assert centre_paths_differ(honest, broken) < 1e-3
    still = Clip(**{**vars(honest), "velocities": None})
    assert measure_physics(still).momentum_residual is None


def test_paths_of_two_clips_are_compared_in_path_lengths():
    a, b = falling(speed=1.0), falling(speed=1.0)
    assert centre_paths_differ(a, b) == 0
    b.means[:, :, 0] += 5  # where it starts does not matter
    assert centre_paths_differ(a, b) < 1e-6
    slower = falling(speed=0.9)
    length = math.hypot(5 / 24, 0.5 * 9.81 * (5 / 24) ** 2)
    assert centre_paths_differ(a, slower) == pytest.approx(0.1 * 5 / 24 / length, rel=1e-3)
    with pytest.raises(ValueError, match="frames"):
        centre_paths_differ(a, falling(frames=4))


def test_evaluation_states_model_formula_and_motion(tiny_clip, rng):
    videos = {
        "front": (rng.random((6, 40, 40, 3)) * 255).astype(np.uint8),
        "back": np.repeat((rng.random((1, 40, 40, 3)) * 255).astype(np.uint8), 6, axis=0),
    }
    result = evaluate(falling(), videos, model=similarity.ClipModel(tiny_clip))
    front, back = result.views
    assert back.cosine == pytest.approx(1) and back.distance == pytest.approx(0, abs=1e-9)
    assert back.motion == 0 and front.motion > 10
    assert front.cosine < back.cosine and front.distance > back.distance
    table = result.table()
    for part in (tiny_clip, "rgb", "mean cosine", "4DGen", "motion %", "momentum", "mass 2.500"):
        assert part in table
    data = result.data()
    assert data["clip_model"] == tiny_clip and data["views"][0]["motion"] == front.motion
    assert set(data["formulas"]) == {"cosine", "distance"}


def test_evaluation_without_clip_warns_of_frozen_videos():
    videos = {"front": np.zeros((6, 8, 8, 3))}
    table = evaluate(falling(), videos, missing="no weights here").table()
    assert "CLIP-T was not computed: no weights here" in table
    assert "frozen video always has a perfect" in table


def test_command_line_evaluates_a_clip(tiny_clip, tmp_path, capsys, monkeypatch):
    from phy124.__main__ import main
    from phy124.scene import Scene

    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    clip, path = falling(frames=3), tmp_path / "clip.safetensors"
    Clip(**{**vars(clip), "scene": Scene.named("drop").data()}).save(path)
    arguments = ["evaluate", str(path), "--size", "32", "--device", "cpu"]
    assert main([*arguments, "--clip-model", tiny_clip]) == 0
    table = capsys.readouterr().out
    assert all(part in table for part in ("front", "right", "back", "left", tiny_clip, "4DGen"))
    data = json.loads((tmp_path / "evaluation.json").read_text())
    assert [view["view"] for view in data["views"]] == ["front", "right", "back", "left"]
    assert all(0 < view["cosine"] <= 1 and view["motion"] > 0 for view in data["views"])
    assert data["physics"]["mass"] == 2.5
    assert main([*arguments, "--json"]) == 0
    without = json.loads(capsys.readouterr().out)
    assert without["clip_model"] is None and "phy124 weights fetch clip" in without["missing"]
    assert main([*arguments, "--clip-model", str(tmp_path)]) == 2
    assert "not a CLIP model" in capsys.readouterr().err
    assert main([*arguments, "--clip-model", "none"]) == 0
    capsys.readouterr()
    for wrong, reason in (
        (["--out", str(path)], "name of a file that this command reads"),
        (["--size", "0"], "view.size"),
        (["--elevation", "nan"], "view.elevation"),
    ):
        assert main(["evaluate", str(path), *wrong]) == 2 and reason in capsys.readouterr().err
    assert len(Clip.load(path)) == 3


def test_documentation_names_the_options_and_figures_there_are():
    page = (Path(__file__).parents[1] / "docs/lab/evaluation.md").read_text("utf-8")
    header = evaluate(falling(), {"front": np.zeros((2, 4, 4, 3))}, missing="-").table()
    for figure in ("CLIP-T cos", "CLIP-T dist", "motion %", "flicker %", "momentum residual"):
        assert figure in page and figure in header
    options = {f"--{f.name.replace('_', '-')}" for f in fields(Evaluate)}
    assert set(re.findall(r"--[a-z][a-z-]*", page)) <= options
