"""The text encoder, the image encoder and the autoencoder of ImageDream.

The networks come from transformers (CLIP) and diffusers (VAE), with the sizes of Stable Diffusion
2.1 and CLIP ViT-H/14. No configuration files are needed, because the sizes are stated here.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from diffusers.models.autoencoders.autoencoder_kl import AutoencoderKL
from PIL import Image
from torch import Tensor, nn
from transformers import CLIPTextConfig, CLIPTextModel, CLIPVisionConfig, CLIPVisionModel

from phy124.weights.checkpoints import fill, read_tensors, strip_prefix

HEADS, HEAD_WIDTH = 12, 64


class PerceiverAttention(nn.Module):
    """Attention from latents [B,K,C] to the image tokens and to the latents."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = HEADS * HEAD_WIDTH
        self.norm1 = nn.LayerNorm(channels)
        self.norm2 = nn.LayerNorm(channels)
        self.to_q = nn.Linear(channels, inner, bias=False)
        self.to_kv = nn.Linear(channels, 2 * inner, bias=False)
        self.to_out = nn.Linear(inner, channels, bias=False)

    def forward(self, x: Tensor, latents: Tensor) -> Tensor:
        """Return [B,K,C] for image tokens x [B,M,C]."""
        x, latents = self.norm1(x), self.norm2(latents)
        k, v = self.to_kv(torch.cat([x, latents], dim=1)).chunk(2, dim=-1)
        q, k, v = (t.unflatten(-1, (HEADS, -1)).transpose(1, 2) for t in (self.to_q(latents), k, v))
        # To avoid an overflow in half precision, queries and keys are both multiplied by the square
        # root of the scale, and the softmax is computed in float32.
        scale = HEAD_WIDTH**-0.25
        weights = ((q * scale) @ (k * scale).transpose(-2, -1)).float().softmax(dim=-1).to(v.dtype)
        return self.to_out((weights @ v).transpose(1, 2).flatten(2))


def _feed_forward(channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.LayerNorm(channels),
        nn.Linear(channels, 4 * channels, bias=False),
        nn.GELU(),
        nn.Linear(4 * channels, channels, bias=False),
    )


class Resampler(nn.Module):
    """Converts image tokens [B,M,inputs] to a fixed number of tokens [B,K,C]."""

    def __init__(self, inputs: int, channels: int, tokens: int, depth: int = 4) -> None:
        super().__init__()
        self.latents = nn.Parameter(torch.randn(1, tokens, channels) / channels**0.5)
        self.proj_in = nn.Linear(inputs, channels)
        self.proj_out = nn.Linear(channels, channels)
        self.norm_out = nn.LayerNorm(channels)
        self.layers = nn.ModuleList(
            nn.ModuleList([PerceiverAttention(channels), _feed_forward(channels)])
            for _ in range(depth)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Let learnt latents attend to the image tokens."""
        latents = self.latents.expand(len(x), -1, -1)
        x = self.proj_in(x)
        for layer in self.layers:
            attention, feed_forward = layer  # pyright: ignore[reportGeneralTypeIssues]
            latents = attention(x, latents) + latents
            latents = feed_forward(latents) + latents
        return self.norm_out(self.proj_out(latents))


VAE: dict[str, Any] = {
    "down_block_types": ["DownEncoderBlock2D"] * 4,
    "up_block_types": ["UpDecoderBlock2D"] * 4,
    "block_out_channels": [128, 256, 512, 512],
    "layers_per_block": 2,
    "latent_channels": 4,
    "scaling_factor": 0.18215,
}
TEXT: dict[str, Any] = {
    "hidden_size": 1024,
    "intermediate_size": 4096,
    "num_hidden_layers": 23,
    "num_attention_heads": 16,
    "hidden_act": "gelu",
    "vocab_size": 49408,
}
VISION: dict[str, Any] = {
    "hidden_size": 1280,
    "intermediate_size": 5120,
    "num_hidden_layers": 32,
    "num_attention_heads": 16,
    "hidden_act": "gelu",
    "image_size": 224,
    "patch_size": 14,
}
EMPTY_PROMPT = (49406, 49407, *([0] * 75))
"""Tokens of the empty prompt: start, end, padding. No tokenizer is needed, because the prompt is
always empty.
"""
SPARE = ("position_ids", "visual_projection.weight", "text_projection.weight", "logit_scale")
"""Names of tensors that some CLIP files contain, but ImageDream does not need."""
CLIP_SIZE = 224
CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
CLIP_STD = (0.26862954, 0.26130258, 0.27577711)


def vae(path: Path | None = None, **changes: Any) -> AutoencoderKL:
    """Build the autoencoder, with the weights of `path` if there is one."""
    return build_filled(lambda: AutoencoderKL(**{**VAE, **changes}), path, "", "the VAE")


def text_encoder(path: Path | None = None, **changes: Any) -> CLIPTextModel:
    """Build Stable Diffusion 2.1's text encoder, with the weights of `path` if there is one."""
    config = CLIPTextConfig(**{**TEXT, **changes})
    return build_filled(lambda: CLIPTextModel(config), path, "text_model.", "the text encoder")


def image_encoder(path: Path | None = None, **changes: Any) -> CLIPVisionModel:
    """Build CLIP's image encoder, ViT-H/14, with the weights of `path` if there is one."""
    config = CLIPVisionConfig(**{**VISION, **changes})
    return build_filled(
        lambda: CLIPVisionModel(config), path, "vision_model.", "the picture encoder"
    )


def build_filled(build: Callable[[], Any], path: Path | None, prefix: str, name: str) -> Any:
    """Build a network and, if `path` is set, load its weights in the file's precision.

    With transformers before version 5, the network's tensor names also begin with `prefix`.

    Args:
        build: Creates the network.
        path: File of weights.
        prefix: Prefix of the names in the file.
        name: Name of the network in messages.

    Raises:
        InputError: If the file cannot be read or does not fit the network.
    """
    if path is None:
        return build().eval().requires_grad_(False)
    with torch.device("meta"):
        network: nn.Module = build()
    tensors = read_tensors(path)
    if prefix and not any(key.startswith(prefix) for key in network.state_dict()):
        tensors = strip_prefix(tensors, prefix)
    fill(network, {k: v for k, v in tensors.items() if not k.endswith(SPARE)}, name)
    for module in network.modules():
        for key, buffer in module.named_buffers(recurse=False):
            if buffer.is_meta:  # only older files contain this buffer
                positions = torch.arange(buffer.shape[-1])[None]
                module.register_buffer(key, positions, persistent=False)
    return network.eval().requires_grad_(False)


@torch.inference_mode()
def empty_prompt(encoder: CLIPTextModel) -> Tensor:
    """Return the text tokens [1,77,1024] of the empty prompt."""
    tokens = torch.tensor([EMPTY_PROMPT], device=encoder.device)
    return encoder(tokens).last_hidden_state


@torch.inference_mode()
def picture_tokens(encoder: CLIPVisionModel, image: Tensor) -> Tensor:
    """Return CLIP's image tokens [1,257,1280]: the next-to-last layer's output, not normalised."""
    pixels = clip_pixels(image)[None].to(encoder.device, encoder.dtype)
    return encoder(pixels, output_hidden_states=True).hidden_states[-2]


def clip_pixels(image: Tensor) -> Tensor:
    """Resize, crop and normalise an image [3,H,W] for CLIP; return [3,S,S]."""
    pixels = (image.permute(1, 2, 0).cpu().float().numpy() * 255).astype(np.uint8)
    (height, width), size = pixels.shape[:2], CLIP_SIZE
    scale = size / min(height, width)
    wide, high = max(size, int(width * scale)), max(size, int(height * scale))
    resized = Image.fromarray(pixels).resize((wide, high), Image.Resampling.BICUBIC)
    left, top = (wide - size) // 2, (high - size) // 2
    cropped = np.asarray(resized.crop((left, top, left + size, top + size)), np.float32) / 255
    normal = (cropped - np.array(CLIP_MEAN, np.float32)) / np.array(CLIP_STD, np.float32)
    return torch.from_numpy(normal).permute(2, 0, 1)
