"""LGM's network: turns four views with known cameras into Gaussians.

Tang et al. 2024, "LGM: Large Multi-View Gaussian Model", section 3.2 and the released weights.
"""

import os
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from phy124.errors import InputError
from phy124.generators.neural.lgm.unet import UNet
from phy124.generators.neural.orbit import focal, orbit
from phy124.generators.neural.splatting import orbit_view, rasterize
from phy124.weights.checkpoints import StateDict, fill, read_tensors
from phy124.weights.store import compute_sha256

RADIUS = 1.5
"""Distance of the cameras from the origin."""
AZIMUTHS = (0, 90, 180, 270)
"""Azimuths of the views [degrees]: the front, then counter-clockwise as seen from above."""


def pluecker(camera_to_world: NDArray, size: int) -> NDArray[np.float32]:
    """Return the Pluecker ray of every pixel [6,S,S]: moment o x d, then unit direction d.

    `camera_to_world` [4,4] is in OpenGL axes; pixel centres lie at half integers.
    """
    f = focal(size)
    x = (np.arange(size) - size / 2 + 0.5) / f
    right, up = np.meshgrid(x, -x)
    directions = np.stack([right, up, np.full_like(right, -1)], axis=-1) @ camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    moments = np.cross(np.broadcast_to(camera_to_world[:3, 3], directions.shape), directions)
    rays = np.concatenate([moments, directions], axis=-1)
    return rays.transpose(2, 0, 1).astype(np.float32)


def four_rays(size: int, *, elevation: float = 0.0) -> NDArray[np.float32]:
    """Return the rays of LGM's four views [4,6,S,S]; elevation > 0 [degrees] looks from below."""
    return np.stack([pluecker(orbit(elevation, a, RADIUS), size) for a in AZIMUTHS])


Rotations = Literal["each", "all"]
"""Whether quaternions are normalised for each Gaussian, or over all Gaussians of an object.

LGM's weights from before April 2024 were trained with "all" by mistake. The quaternions of these
weights are so small that they had no effect in the training, because the renderer did not normalise
quaternions.
"""
GENERATIONS: dict[str, Rotations] = {
    "5a7ab3128a73dce6d2927d5c7c7ec79a7f7ca885fec960db86d991f272fe2e9d": "all",  # model_fp16
    "744d6324656342c64f871308e73db97f0eb51858d94329b30090e986a6d050ab": "each",  # ..._fixrot
    "186631d0736c4dd933676be5a47d492d4354f796e18526d174535b1ae96f1335": "each",  # model_fixrot
}
"""Quaternion normalisation of LGM's public weight files, by sha256. The tensors' names and shapes
do not show the normalisation.
"""
CHANNELS = 14


@dataclass(frozen=True)
class Option:
    """Layer sizes of the network, and image sizes [pixels]."""

    down_channels: tuple[int, ...]
    down_attention: tuple[bool, ...]
    up_channels: tuple[int, ...]
    up_attention: tuple[bool, ...]
    input_size: int = 256
    """Side of each input view [pixels]."""


def _flags(bits: str) -> tuple[bool, ...]:
    return tuple(bit == "1" for bit in bits)


_DOWN = (64, 128, 256, 512, 1024, 1024)
_SMALL = Option(_DOWN, _flags("000111"), (1024, 1024, 512, 256), _flags("1110"))
OPTIONS = {
    "lrm": _SMALL,
    "small": _SMALL,
    "big": Option(_DOWN, _flags("000111"), (1024, 1024, 512, 256, 128), _flags("11100")),
    "tiny": Option((32, 64, 128, 256, 512), _flags("00001"), (512, 256, 128), _flags("100")),
}
"""The four configurations of the original program; weights are public only for `big`."""


class LgmModel(nn.Module):
    """U-Net and head: map input [B,4,9,H,W] to Gaussians [B,N,14], where N = 65,536 for `big`.

    The 14 numbers are position (3 numbers in -1..1, y up, front +z), opacity, scale (3), quaternion
    wxyz (4) and colour (3).
    """

    def __init__(self, option: Option, *, rotations: Rotations | None = None) -> None:
        super().__init__()
        self.option = option
        self.rotations: Rotations | None = rotations
        """If the normalisation is unknown (None), `forward` normalises each quaternion separately.
        """
        self.unet = UNet(
            option.down_channels, option.down_attention, option.up_channels, option.up_attention
        )
        self.conv = nn.Conv2d(CHANNELS, CHANNELS, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Return the Gaussians of each object; activations are computed in float32 or float64."""
        b, v, c, h, w = images.shape
        raw = self.conv(self.unet(images.reshape(b * v, c, h, w).to(self.conv.weight.dtype)))
        raw = raw.float() if raw.dtype in (torch.float16, torch.bfloat16) else raw
        return activate(raw.reshape(b, v, CHANNELS, *raw.shape[2:]), self.rotations or "each")


def activate(raw: Tensor, rotations: Rotations = "each") -> Tensor:
    """Apply the activation functions to maps [B,V,14,h,w]; return Gaussians [B,V*h*w,14]."""
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
    """Build the network and load the weights.

    Args:
        path_or_state_dict: A file, or tensors by name.
        option: Key of `OPTIONS`, or an `Option`.
        device: Device of the network.
        dtype: Precision of the network.

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
            "Weights are published only for `big`.",
        )
    return OPTIONS[option]


NOT_ROTATED = (1.0, 0.0, 0.0, 0.0)
SIDE = 128
"""Side of the compared images [pixels]."""
MARGIN = 0.98
"""Largest ratio of the error with "all" to the error with "each" at which "all" is chosen. The
ratio is below 1, because "all" is rarely right.
"""


def remove_rotations(rows: Tensor) -> Tensor:
    """Return a copy of Gaussians [N,14] with identity quaternions."""
    rows = rows.clone()
    rows[:, 7:11] = rows.new_tensor(NOT_ROTATED)
    return rows


def judge(rows: Tensor, images: Tensor) -> Rotations:
    """Return the method of normalising quaternions for which Gaussians [N,14] look more like
    `images`.
    """
    pictures = torch.nn.functional.interpolate(images, (SIDE, SIDE), mode="area")
    each, none = error(rows, pictures), error(remove_rotations(rows), pictures)
    return "all" if none < MARGIN * each else "each"


def error(rows: Tensor, pictures: Tensor) -> float:
    """Return the mean squared error of four rendered views [4,3,S,S]."""
    drawn = [draw_rows(rows, azimuth, pictures.shape[-1]) for azimuth in AZIMUTHS]
    return float(((torch.stack(drawn) - pictures) ** 2).mean())


@torch.no_grad()
def draw_rows(rows: Tensor, azimuth: float, size: int) -> Tensor:
    """Render Gaussians [N,14] from an azimuth [degrees]: an image [3,S,S] over white."""
    rows = rows.float()
    view = orbit_view(0.0, azimuth, RADIUS, size)
    parts = rows[:, 0:3], rows[:, 7:11], rows[:, 4:7], rows[:, 3], rows[:, 11:14]
    return rasterize(*parts, view, rows.new_ones(3)).rgb.permute(2, 0, 1).clamp(0, 1)
