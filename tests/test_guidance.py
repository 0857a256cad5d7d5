"""Score distillation: its gradient, and the guidance by Zero123."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from phy124.errors import InputError
from phy124.generators.neural.dreamgaussian import zero123
from phy124.generators.neural.dreamgaussian.guidance import Pose, add_noise, alphas_cumprod, sds


@pytest.fixture(scope="module")
def folder(golden):
    return golden / "generators"


def test_sds_has_the_stated_gradient_and_value():
    latents = torch.randn(2, 4, 3, 3, requires_grad=True)
    predicted, noise = torch.randn(2, 2, 4, 3, 3)
    loss = sds(latents, predicted, noise, 0.7)
    loss.backward()
    torch.testing.assert_close(latents.grad, 0.7 * (predicted - noise))
    torch.testing.assert_close(loss, 0.5 * (0.7 * (predicted - noise)).square().sum())


def test_noise_schedule_is_that_of_the_sampler(folder):
    golden = np.load(folder / "imagedream_pipeline.npz")["alphas_cumprod"]
    np.testing.assert_allclose(alphas_cumprod(), golden, rtol=1e-4)
    x, n = torch.ones(2), torch.full((2,), 2.0)
    alpha = float(golden[500])
    torch.testing.assert_close(add_noise(x, n, 500), x * alpha**0.5 + n * (1 - alpha) ** 0.5)


SMALL = {
    "unet": {"block_out_channels": (32, 32), "layers_per_block": 1, "cross_attention_dim": 768}
    | {"down_block_types": ("CrossAttnDownBlock2D", "DownBlock2D")}
    | {"up_block_types": ("UpBlock2D", "CrossAttnUpBlock2D"), "attention_head_dim": 8},
    "vision": {"hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2}
    | {"num_attention_heads": 2},
}


@pytest.fixture(scope="module")
def small_zero123(folder):
    from phy124.generators.neural.imagedream import encoders

    torch.manual_seed(0)
    small_vae = {"block_out_channels": [32, 32, 32, 32], "layers_per_block": 1}
    return {
        "unet": zero123.unet(**SMALL["unet"]),
        "vae": encoders.vae(folder / "vae_tiny.weights.fp16.safetensors", **small_vae).float(),
        "vision": zero123.vision(**SMALL["vision"]),
        "projection": zero123.CameraProjection().requires_grad_(False),
    }


def test_zero123_gradient_is_guided_noise_difference(small_zero123, monkeypatch):
    calls = []
    unet = small_zero123["unet"]

    def recording(x, t, encoder_hidden_states):
        calls.append((x, t, encoder_hidden_states))
        return unet(x, t, encoder_hidden_states=encoder_hidden_states)

    guidance = zero123.Zero123(torch.rand(3, 40, 40), {**small_zero123, "unet": recording})
    image = torch.rand(1, 3, 32, 32, requires_grad=True)
    guidance(image, [Pose(10, 30, 0)], 0.37, torch.Generator().manual_seed(1)).backward()
    ((x, t, context),) = calls
    assert t.tolist() == [630, 630] and x.shape == (2, 8, 32, 32) and context.shape == (2, 1, 768)
    torch.testing.assert_close(x[0, :4], x[1, :4])
    # The conditioned half comes first; the other sees neither picture nor pose.
    assert x[0, 4:].abs().sum() > 0 and x[1, 4:].abs().sum() == 0 and context[1].abs().sum() == 0
    assert float(image.grad.abs().sum()) > 0
    with_it, without = unet(x, t, encoder_hidden_states=context).sample.chunk(2)
    torch.testing.assert_close(
        guidance._noise(x[:1, :4], 630, [Pose(10, 30, 0)]), without + 5 * (with_it - without)
    )


def test_zero123_networks_load_from_files(small_zero123, tmp_path, monkeypatch):
    from phy124.weights import store as weights

    folder = tmp_path / "zero123-xl-diffusers"
    for name, part in (("unet", "unet"), ("image_encoder", "vision"), ("vae", "vae")):
        file = "model" if name == "image_encoder" else "diffusion_pytorch_model"
        (folder / name).mkdir(parents=True)
        tensors = {k: v.contiguous() for k, v in small_zero123[part].state_dict().items()}
        save_file(tensors, folder / name / f"{file}.fp16.safetensors")
    (folder / "clip_camera_projection").mkdir()
    path = folder / "clip_camera_projection/diffusion_pytorch_model.fp16.safetensors"
    save_file(small_zero123["projection"].state_dict(), path)
    assert weights.is_complete("zero123", tmp_path)
    # Full-size networks refuse the small files by name.
    with pytest.raises(InputError, match="differ from the 686 tensors of Zero123's U-Net"):
        zero123.load_trained(tmp_path, "cpu", torch.float32)
