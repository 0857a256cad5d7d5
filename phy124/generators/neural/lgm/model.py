"""LGM's network with its 14-channel head: four posed views in, activated Gaussians out.

Tang et al. 2024, "LGM: Large Multi-View Gaussian Model", section 3.2 and the released weights.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from phy124.errors import InputError
from phy124.generators.neural.lgm.unet import UNet
from phy124.weights.checkpoints import StateDict, fill, read_tensors
from phy124.weights.store import compute_sha256

Rotations = Literal["each", "all"]
"""Over what quaternions are normalised: each Gaussian alone, or all Gaussians of an object.

The first generation of the weights (before April 2024) was trained with a mistake, "all", and drawn
without normalising again: its quaternions are tiny and mean "not rotated".
"""
GENERATIONS: dict[str, Rotations] = {
    "5a7ab3128a73dce6d2927d5c7c7ec79a7f7ca885fec960db86d991f272fe2e9d": "all",  # model_fp16
    "744d6324656342c64f871308e73db97f0eb51858d94329b30090e986a6d050ab": "each",  # ..._fixrot
    "186631d0736c4dd933676be5a47d492d4354f796e18526d174535b1ae96f1335": "each",  # model_fixrot
}
"""Public files by their sha256; both generations have the same shapes and names."""
CHANNELS = 14


@dataclass(frozen=True)
class Option:
    """Size of the network; sides in pixels."""

    down_channels: tuple[int, ...]
    down_attention: tuple[bool, ...]
    up_channels: tuple[int, ...]
    up_attention: tuple[bool, ...]
    input_size: int = 256
    """Side of each input view."""
    splat_size: int = 64
    """Side of each output map: 4 * splat_size^2 Gaussians."""


def _flags(bits: str) -> tuple[bool, ...]:
    return tuple(bit == "1" for bit in bits)


_DOWN = (64, 128, 256, 512, 1024, 1024)
_SMALL = Option(_DOWN, _flags("000111"), (1024, 1024, 512, 256), _flags("1110"))
OPTIONS = {
    "lrm": _SMALL,
    "small": _SMALL,
    "big": Option(
        _DOWN, _flags("000111"), (1024, 1024, 512, 256, 128), _flags("11100"), splat_size=128
    ),
    "tiny": Option((32, 64, 128, 256, 512), _flags("00001"), (512, 256, 128), _flags("100")),
}
"""The four options of the original; only the weights of `big` are public."""


class LgmModel(nn.Module):
    """U-Net and head; [B,4,9,H,W] -> [B,N,14], N = 4 * splat_size^2 at the input size.

    The 14 numbers are position 3 (in [-1,1]^3, y up, front +z), opacity, scale 3, quaternion wxyz
    4, colour 3, all activated.
    """

    def __init__(self, option: Option, *, rotations: Rotations | None = None) -> None:
        super().__init__()
        self.option = option
        self.rotations: Rotations | None = rotations
        """None: not known; the forward pass then takes "each", see `lgm.rotations`."""
        self.unet = UNet(
            option.down_channels, option.down_attention, option.up_channels, option.up_attention
        )
        self.conv = nn.Conv2d(CHANNELS, CHANNELS, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Gaussians of each object; the head always computes in float32 or better."""
        b, v, c, h, w = images.shape
        raw = self.conv(self.unet(images.reshape(b * v, c, h, w).to(self.conv.weight.dtype)))
        raw = raw.float() if raw.dtype in (torch.float16, torch.bfloat16) else raw
        return activate(raw.reshape(b, v, CHANNELS, *raw.shape[2:]), self.rotations or "each")


def activate(raw: Tensor, rotations: Rotations = "each") -> Tensor:
    """Raw maps [B,V,14,h,w] -> Gaussians [B,V*h*w,14], in view, row, column order."""
    x = raw.permute(0, 1, 3, 4, 2).flatten(1, 3)
    parts = (
        x[..., 0:3].clamp(-1, 1),
        torch.sigmoid(x[..., 3:4]),
        0.1 * F.softplus(x[..., 4:7]),
        F.normalize(x[..., 7:11], dim=-1 if rotations == "each" else 1),
        0.5 * torch.tanh(x[..., 11:14]) + 0.5,
    )
    return torch.cat(parts, dim=-1)


def load(
    path_or_state_dict: str | os.PathLike[str] | StateDict,
    option: str | Option = "big",
    *,
    device: str | torch.device = "cpu",
    dtype: torch.dtype = torch.float32,
) -> LgmModel:
    """Build the network and fill it strictly.

    A file of the first generation, recognised by its sha256, keeps that generation's quaternions.

    Args:
        path_or_state_dict: A file, or tensors.
        option: Key of `OPTIONS`.
        device: Where the network runs.
        dtype: Its precision.

    Raises:
        InputError: If the option is unknown or the tensors do not fit it.
    """
    chosen = _option(option)
    rotations: Rotations | None = None
    tensors = path_or_state_dict
    if isinstance(tensors, (str, os.PathLike)):
        rotations = GENERATIONS.get(compute_sha256(tensors))
        tensors = read_tensors(tensors)
    tensors = {k: v for k, v in tensors.items() if not k.startswith("lpips_loss.")}
    with torch.device("meta"):
        model = LgmModel(chosen, rotations=rotations)
    fill(model, tensors, f"LGM, option {option}" if isinstance(option, str) else "LGM")
    return model.to(device=device, dtype=dtype).eval().requires_grad_(False)


def _option(option: str | Option) -> Option:
    if isinstance(option, Option):
        return option
    if option not in OPTIONS:
        raise InputError(
            "option",
            option,
            f"LGM has the options {', '.join(OPTIONS)}.",
            "The public weights are those of `big`.",
        )
    return OPTIONS[option]
