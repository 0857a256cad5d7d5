"""ImageDream against the original program's outputs, step by step."""

import copy
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from transformers import CLIPTextConfig, CLIPTextModel, CLIPVisionConfig, CLIPVisionModel

from phy124.errors import Cancelled, InputError
from phy124.generators.neural.imagedream import encoders, pipeline
from phy124.generators.neural.imagedream.pipeline import (
    SCHEDULE,
    Condition,
    ImageDream,
    cameras,
    decode,
    denoise,
    encode,
    predict,
    scheduler_of,
)
from phy124.generators.neural.imagedream.unet import (
    Config,
    MultiViewUNet,
    load_unet,
    timestep_embedding,
    with_picture,
)
from reference import formula

CLOSE = {"rtol": 1e-4, "atol": 2e-5}
PIPELINE = {"rtol": 1e-3, "atol": 1e-3}
SMALL_VAE = {"block_out_channels": [32, 32, 32, 32], "layers_per_block": 1}
SMALL_CLIP = {
    "hidden_size": 32,
    "intermediate_size": 64,
    "num_hidden_layers": 3,
    "num_attention_heads": 2,
}


@pytest.fixture(scope="module")
def folder(golden) -> Path:
    return golden / "generators"


@pytest.fixture(scope="module")
def unet(folder) -> MultiViewUNet:
    config = json.loads((folder / "imagedream_unet_tiny.json").read_text())["config"]
    return load_unet(folder / "imagedream_unet_tiny.weights.fp16.safetensors", **config)


@pytest.fixture(scope="module")
def vae(folder):
    return encoders.vae(folder / "vae_tiny.weights.fp16.safetensors", **SMALL_VAE).float()


@pytest.fixture(scope="module")
def expected(folder) -> dict[str, torch.Tensor]:
    arrays = np.load(folder / "imagedream_pipeline.npz")
    return {key: torch.from_numpy(arrays[key]) for key in arrays.files}


@pytest.fixture(scope="module")
def condition(expected) -> Condition:
    return Condition(
        torch.cat([expected["neg"], expected["pos"]]),
        expected["image_embeds"].float(),
        expected["image_latents_pos"],
        torch.from_numpy(cameras()),
    )


class TinyParts:
    """Networks of the golden data with made-up encoders."""

    def __init__(self, unet, vae):
        self.unet, self.vae = unet, vae

    def text(self):
        return formula.inputs("text", (1, 77, 16), -1, 1)

    def picture(self, image):
        return formula.inputs("picture", (1, 257, 1280), -1, 1) * image.mean()


def test_unet_equals_the_original(folder, unet):
    arrays = np.load(folder / "imagedream_unet_tiny.npz")
    e = {key: torch.from_numpy(arrays[key]) for key in arrays.files}
    ip = torch.cat([torch.zeros(5, 9, 1280), e["ip_pos"].expand(5, 9, 1280)])
    camera = e["camera"].repeat(2, 1)
    with torch.inference_mode():
        y = unet(e["x"], e["timesteps"], e["context"], 5, camera, ip, e["ip_img"])
        tokens = unet.image_embed(e["ip_pos"][None])
        pose = unet.camera_embed(e["camera"])
    np.testing.assert_allclose(y, e["y"], **CLOSE)
    np.testing.assert_allclose(tokens, e["ip_tokens"], **CLOSE)
    np.testing.assert_allclose(pose, e["camera_embed"], **CLOSE)
    replaced = with_picture(e["x"], e["ip_img"], 5)
    np.testing.assert_array_equal(replaced, e["x_after_ip_overwrite"])
    sinusoids = timestep_embedding(torch.tensor([1, 34, 958]), 32)
    np.testing.assert_allclose(sinusoids, e["timestep_embedding"], **CLOSE)


def test_mvdream_is_the_same_network_without_a_picture(folder):
    config = json.loads((folder / "imagedream_unet_tiny.json").read_text())["config"]
    config["ip_dim"] = 0
    with torch.device("meta"):
        empty = MultiViewUNet(Config(**config))
    del config["ip_dim"]  # told by the tensors
    unet = load_unet(formula.state_dict(empty), **config)
    arrays = np.load(folder / "mvdream_unet_tiny.npz")
    x, t, context, camera = (torch.from_numpy(arrays[k]) for k in ("x", "t", "context", "camera"))
    with torch.inference_mode():
        np.testing.assert_allclose(unet(x, t, context, 4, camera), arrays["y"], **CLOSE)


@pytest.mark.parametrize("name", ["imagedream_unet", "mvdream_unet"])
def test_keys_and_shapes_are_those_of_the_public_files(folder, name):
    table = json.loads((folder / f"tables/{name}.json").read_text())
    config = {"ip_dim": 0, **table["meta"]["config"]}
    with torch.device("meta"):
        unet = MultiViewUNet(Config(**config))
    assert {k: list(v.shape) for k, v in unet.state_dict().items()} == table["shapes"]


@pytest.mark.parametrize(
    ("build", "table", "prefix"),
    [
        (encoders.vae, "sd_vae", ""),
        (encoders.text_encoder, "sd21_text_encoder", "text_model."),
        (encoders.image_encoder, "clip_vit_h14_vision", "vision_model."),
    ],
)
def test_surrounding_networks_have_the_public_shapes(folder, build, table, prefix):
    with torch.device("meta"):
        shapes = {k: list(v.shape) for k, v in build().state_dict().items()}
    if not any(key.startswith(prefix) for key in shapes):
        shapes = {prefix + k: v for k, v in shapes.items()}
    assert shapes == json.loads((folder / f"tables/{table}.json").read_text())["shapes"]


def test_cameras_equal_the_original(folder):
    arrays = np.load(folder / "imagedream_cameras.npz")
    for elevation in (0, 15, -20):
        np.testing.assert_allclose(cameras(elevation), arrays[f"lgm_elev{elevation}"], **CLOSE)


def test_vae_equals_the_original(folder, vae):
    arrays = np.load(folder / "vae_tiny.npz")
    with torch.inference_mode():
        posterior = vae.encode(torch.from_numpy(arrays["x"])).latent_dist
        decoded = vae.decode(torch.from_numpy(arrays["z"])).sample
    np.testing.assert_allclose(posterior.mean, arrays["mean"], **CLOSE)
    np.testing.assert_allclose(posterior.logvar, arrays["logvar"], **CLOSE)
    np.testing.assert_allclose(decoded, arrays["decoded"], **CLOSE)


def test_schedule_equals_the_original(folder, expected):
    output = json.loads((folder / "imagedream_pipeline.json").read_text())["scheduler"]
    assert output.items() <= SCHEDULE.items()
    scheduler = scheduler_of("ddim", 3)
    np.testing.assert_allclose(scheduler.alphas_cumprod, expected["alphas_cumprod"], **CLOSE)
    assert float(scheduler.final_alpha_cumprod) == pytest.approx(
        float(expected["final_alpha_cumprod"]), rel=1e-6
    )
    for steps in (3, 30, 50):
        scheduler.set_timesteps(steps)
        np.testing.assert_array_equal(scheduler.timesteps, expected[f"timesteps_{steps}"])


def test_every_step_equals_the_original(unet, vae, expected, condition):
    """Three steps with guidance 5; latents reach 50, so 1e-3 is tight."""
    start = expected["init_latents"]
    with torch.inference_mode():
        noise = predict(unet, start, expected["timesteps_3"][0], condition)
        np.testing.assert_allclose(noise, expected["eps_step0"], **PIPELINE)
        steps = list(denoise(unet, start, condition, 3, 5.0))
        views = decode(vae, steps[-1]).permute(0, 2, 3, 1)
    np.testing.assert_allclose(torch.stack(steps), expected["latents_steps"], **PIPELINE)
    np.testing.assert_allclose(views[:, ::8, ::8], expected["out_stride8"], **PIPELINE)


def test_bfloat16_in_the_network_leaves_the_latents_exact(
    unet, vae, expected, condition, monkeypatch
):
    """Only the noise is predicted in it; guidance and steps are float32."""
    short, start = copy.deepcopy(unet).to(torch.bfloat16), expected["init_latents"]
    with torch.inference_mode():
        noise = predict(short, start, expected["timesteps_3"][0], condition.to(torch.bfloat16))
    assert noise.dtype == torch.float32
    monkeypatch.setattr(pipeline, "decode", lambda vae, latents: latents)
    image = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0))
    made = {}
    for dtype in (torch.float32, torch.bfloat16):
        parts = TinyParts(copy.deepcopy(unet).to(dtype), vae)
        monkeypatch.setattr(pipeline, "SIZE", 64)
        options = {"steps": 1, "sampler": "dpmsolver++", "parts": parts, "unet_dtype": dtype}
        made[dtype] = ImageDream(**options)(image, seed=3)
        assert made[dtype].dtype == torch.float32
    apart = (made[torch.bfloat16] - made[torch.float32]).std() / made[torch.float32].std()
    assert 1e-6 < float(apart) < 0.1


def solved(sampler: str, steps: int) -> float:
    """Relative error where the data are normal with deviation 0.5, whose solution is known.

    The noise in x is then sqrt(1 - a) x / d^2, and x / d is the same at every level of noise, with
    d^2 = a 0.25 + 1 - a and a what remains of the picture.
    """
    scheduler = scheduler_of(sampler, steps)
    a = scheduler.alphas_cumprod.double()
    d = (0.25 * a + 1 - a).sqrt()
    start = x = torch.ones(1, dtype=torch.float64)
    for t in scheduler.timesteps:
        x = scheduler.step((1 - a[t]).sqrt() * x / d[t] ** 2, t, x, return_dict=False)[0]
    exact = start * d[0] / d[int(scheduler.timesteps[0])]
    return abs(float(x / exact) - 1)


def test_ddim_is_of_first_order_and_dpmsolver_of_second():
    first, second = ([solved(name, n) for n in (10, 20)] for name in ("ddim", "dpmsolver++"))
    assert 1.5 < first[0] / first[1] < 2.5
    assert 3.0 < second[0] / second[1] < 6.0
    assert second[0] < solved("ddim", 30)
    assert solved("dpmsolver++", 1) < 1


def test_networks_are_in_memory_one_after_the_other(tmp_path, monkeypatch):
    monkeypatch.setattr(pipeline, "require", lambda name, weights: defaultdict(lambda: tmp_path))
    monkeypatch.setattr(encoders, "vae", lambda path: torch.nn.Linear(1, 1))
    monkeypatch.setattr(pipeline, "load_unet", lambda path, **place: [place["dtype"]])
    parts = pipeline.TrainedParts(None, "cpu", torch.float32, torch.bfloat16)
    assert "unet" not in vars(parts), "it is read once the encoders are released"
    assert parts.unet == [torch.bfloat16] and parts.unet is parts.unet


def test_encoders_are_read_once_if_there_is_room(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(pipeline, "require", lambda name, weights: defaultdict(lambda: tmp_path))
    monkeypatch.setattr(encoders, "vae", lambda path: torch.nn.Linear(1, 1))
    for kind, answer in (("text", "empty_prompt"), ("image", "picture_tokens")):
        network = torch.nn.Linear(1, 1)
        monkeypatch.setattr(
            encoders, f"{kind}_encoder", lambda path, k=kind, n=network: read.append(k) or n
        )
        monkeypatch.setattr(encoders, answer, lambda *options: torch.zeros(1))
    for short in (False, True):
        monkeypatch.setattr(pipeline, "is_short", lambda needed, device, s=short: s)
        parts = pipeline.TrainedParts(None, "cpu", torch.float32)
        for _ in range(2):
            parts.text(), parts.picture(torch.zeros(3, 8, 8))
    assert read == ["text", "image", "text", "image", "image"]


def test_picture_latents_are_a_sample_of_the_posterior(vae, expected):
    """The golden latents hold the sampling noise, so they are tested for its size and mean."""
    image = expected["image"].permute(2, 0, 1)
    with torch.inference_mode():
        samples = [encode(vae, image, torch.Generator().manual_seed(seed)) for seed in range(2)]
        square = torch.nn.functional.interpolate(image[None], (256, 256), mode="bilinear")
        posterior = vae.encode(2 * square - 1).latent_dist
    for latents in (*samples, expected["image_latents_pos"]):
        noise = (latents / 0.18215 - posterior.mean) / posterior.std
        assert abs(float(noise.mean())) < 0.06 and abs(float(noise.std()) - 1) < 0.05
    assert not torch.equal(*samples)


def test_same_seed_same_views_and_progress_per_step(unet, vae, monkeypatch):
    assert pipeline.SIZE == 256
    monkeypatch.setattr(pipeline, "SIZE", 64)
    generator = ImageDream(steps=1, parts=TinyParts(unet, vae))
    image, steps = torch.rand(3, 40, 40, generator=torch.Generator().manual_seed(0)), []
    first = generator(image, seed=3, progress=lambda *arguments: steps.append(arguments))
    assert first.shape == (5, 3, 64, 64)
    assert float(first.min()) >= 0 and float(first.max()) <= 1
    assert steps == [("imagedream", 0, 1), ("imagedream", 1, 1)]
    monkeypatch.setattr(pipeline, "decode", lambda vae, latents: latents)
    again, other = generator(image, seed=3), generator(image, seed=4)
    torch.testing.assert_close(decode(vae, again), first, rtol=0, atol=0)
    assert not torch.equal(again, other)


def test_cancelling_stops_after_the_step_in_hand(unet, vae):
    messages = []

    def progress(stage, done, total):
        messages.append(done)
        if done == 1:
            raise Cancelled

    with pytest.raises(Cancelled):
        ImageDream(steps=9, parts=TinyParts(unet, vae))(torch.rand(3, 8, 8), progress=progress)
    assert messages == [0, 1]


def test_authors_checkpoint_and_unknown_fields(unet):
    config = {**vars(unet.config), "image_size": 32, "use_checkpoint": False}
    prefixed = {"model.diffusion_model." + k: v for k, v in unet.state_dict().items()}
    again = load_unet(prefixed, **config)
    assert again.out[2].weight.equal(unet.out[2].weight)
    with pytest.raises(InputError, match="unknown field"):
        load_unet(prefixed, chanels=3)
    with pytest.raises(InputError, match=r"differ from the 773 tensors of ImageDream's U-Net"):
        load_unet(unet.state_dict())


@pytest.mark.parametrize("prefix", ["", "vision_model."])
def test_picture_encoder_reads_files_of_old_and_new_names(tmp_path, prefix):
    torch.manual_seed(0)
    model = CLIPVisionModel(CLIPVisionConfig(**{**encoders.VISION, **SMALL_CLIP})).eval()
    tensors = {k.removeprefix("vision_model."): v for k, v in model.state_dict().items()}
    tensors = {prefix + k: v for k, v in tensors.items()}
    tensors["visual_projection.weight"] = torch.zeros(2, 2)
    save_file(tensors, tmp_path / "model.safetensors")
    encoder = encoders.image_encoder(tmp_path / "model.safetensors", **SMALL_CLIP)
    image = torch.rand(3, 240, 230)
    tokens = encoders.picture_tokens(encoder, image)
    with torch.inference_mode():
        pixels = encoders.clip_pixels(image)[None]
        layers = model(pixels, output_hidden_states=True).hidden_states
    assert len(layers) == SMALL_CLIP["num_hidden_layers"] + 1
    torch.testing.assert_close(tokens, layers[-2])


def test_text_encoder_reads_files_and_needs_no_tokenizer(tmp_path):
    torch.manual_seed(0)
    small = {**SMALL_CLIP, "num_hidden_layers": 2}
    model = CLIPTextModel(CLIPTextConfig(**{**encoders.TEXT, **small})).eval()
    tensors = {
        "text_model." + k.removeprefix("text_model."): v for k, v in model.state_dict().items()
    }
    tensors["text_model.embeddings.position_ids"] = torch.arange(77)[None]
    save_file(tensors, tmp_path / "model.safetensors")
    encoder = encoders.text_encoder(tmp_path / "model.safetensors", **small)
    tokens = encoders.empty_prompt(encoder)
    assert tokens.shape == (1, 77, 32)
    with torch.inference_mode():
        wanted = model(torch.tensor([[49406, 49407] + [0] * 75])).last_hidden_state
    torch.testing.assert_close(tokens, wanted)


def test_clip_pixels_are_normalised_and_cropped():
    image = torch.zeros(3, 100, 300)
    image[:, :, 100:200] = 1
    pixels = encoders.clip_pixels(image)
    assert pixels.shape == (3, 224, 224)
    white = (1 - torch.tensor(encoders.CLIP_MEAN)) / torch.tensor(encoders.CLIP_STD)
    torch.testing.assert_close(pixels[:, 112, 112], white)
    torch.testing.assert_close(pixels[:, 5, 40], white)


def test_missing_weights_name_the_command(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    with pytest.raises(InputError, match=r"phy124 weights fetch imagedream"):
        ImageDream(weights=tmp_path)(torch.zeros(3, 8, 8))
