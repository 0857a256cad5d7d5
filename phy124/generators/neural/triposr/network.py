"""TripoSR's network: maps an image to a triplane, and triplane features to density and colour.

Tochilkin et al. 2024, "TripoSR: Fast 3D Object Reconstruction from a Single Image", after Hong et
al. 2024, "LRM". Submodules have the same names as in the public checkpoint `model.ckpt` of
stabilityai/TripoSR.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from phy124.generators.neural.imagedream.attention import SpatialTransformer
from phy124.weights.checkpoints import StateDict, fill

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet's colours."""
DENSITY_BIAS = -1.0
"""Constant that is added to the decoder's first output; the density is the exponential of the sum.
"""
UNUSED = "image_tokenizer.model.pooler."
"""Prefix of tensors that TripoSR never uses."""
OFFSET = 0.1
"""Number that is added to the number of patches per side when position embeddings are resized.

The network was trained with version 4.35 of transformers, which adds this number too.
"""


@dataclass(frozen=True)
class Sizes:
    """Sizes of the network; the defaults are the sizes of the public checkpoint."""

    patch: int = 16
    """Side of the image patches [pixels]."""
    positions: int = 14
    """Number of patches per side with position embeddings."""
    vision_width: int = 768
    vision_layers: int = 12
    vision_heads: int = 12
    plane: int = 32
    """Side of each plane [tokens]."""
    width: int = 1024
    layers: int = 16
    heads: int = 16
    channels: int = 40
    """Channels of each plane."""
    decoder_width: int = 64
    decoder_layers: int = 9


class VisionAttention(nn.Module):
    """Self-attention over image patches."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.attention = nn.ModuleDict(
            {name: nn.Linear(width, width) for name in ("query", "key", "value")}
        )
        self.output = nn.ModuleDict({"dense": nn.Linear(width, width)})

    def forward(self, x: Tensor) -> Tensor:
        """Map tokens [B,L,C] to the same shape."""
        q, k, v = (
            self.attention[name](x).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for name in ("query", "key", "value")
        )
        return self.output["dense"](
            F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
        )


class VisionLayer(nn.Module):
    """One layer of the vision transformer."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.attention = VisionAttention(width, heads)
        self.intermediate = nn.ModuleDict({"dense": nn.Linear(width, 4 * width)})
        self.output = nn.ModuleDict({"dense": nn.Linear(4 * width, width)})
        self.layernorm_before = nn.LayerNorm(width, eps=1e-12)
        self.layernorm_after = nn.LayerNorm(width, eps=1e-12)

    def forward(self, x: Tensor) -> Tensor:
        """Map tokens [B,L,C] to the same shape."""
        x = self.attention(self.layernorm_before(x)) + x
        hidden = F.gelu(self.intermediate["dense"](self.layernorm_after(x)))
        return self.output["dense"](hidden) + x


class Embeddings(nn.Module):
    """Turns an image into a class token and patch tokens with positions."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.positions = sizes.positions
        self.cls_token = nn.Parameter(torch.zeros(1, 1, sizes.vision_width))
        count = 1 + sizes.positions**2
        self.position_embeddings = nn.Parameter(torch.zeros(1, count, sizes.vision_width))
        conv = nn.Conv2d(3, sizes.vision_width, sizes.patch, stride=sizes.patch)
        self.patch_embeddings = nn.ModuleDict({"projection": conv})

    def forward(self, image: Tensor) -> Tensor:
        """Return the class token and one token per patch [B,1+L,C] of an image [B,3,H,W]."""
        patches = self.patch_embeddings["projection"](image)
        rows, columns = patches.shape[2:]
        tokens = patches.flatten(2).transpose(1, 2)
        tokens = torch.cat([self.cls_token.expand(tokens.shape[0], -1, -1), tokens], dim=1)
        return tokens + self._positions(rows, columns)

    def _positions(self, rows: int, columns: int) -> Tensor:
        """Position embeddings [1,1+L,C] are resized as by transformers 4.35."""
        known = self.positions
        if (rows, columns) == (known, known):
            return self.position_embeddings
        first, grid = self.position_embeddings[:, :1], self.position_embeddings[:, 1:]
        grid = grid.transpose(1, 2).unflatten(2, (known, known))
        factors = ((rows + OFFSET) / known, (columns + OFFSET) / known)
        grid = F.interpolate(grid, scale_factor=factors, mode="bicubic", align_corners=False)
        return torch.cat([first, grid.flatten(2).transpose(1, 2)], dim=1)


class VisionTransformer(nn.Module):
    """DINO's ViT-B/16 (Caron et al. 2021): turns an image into tokens."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        width = sizes.vision_width
        self.embeddings = Embeddings(sizes)
        layers = (VisionLayer(width, sizes.vision_heads) for _ in range(sizes.vision_layers))
        self.encoder = nn.ModuleDict({"layer": nn.Sequential(*layers)})
        self.layernorm = nn.LayerNorm(width, eps=1e-12)

    def forward(self, image: Tensor) -> Tensor:
        """Return tokens [B,1+L,C] of colours [B,3,H,W] in 0..1."""
        mean, std = (image.new_tensor(v)[:, None, None] for v in (MEAN, STD))
        tokens = self.embeddings((image - mean) / std)
        return self.layernorm(self.encoder["layer"](tokens))


class Decoder(nn.Module):
    """Maps triplane features to density and colour."""

    def __init__(self, inputs: int, width: int, layers: int) -> None:
        super().__init__()
        modules: list[nn.Module] = []
        for i in range(layers):
            modules += [nn.Linear(width if i else inputs, width), nn.SiLU()]
        self.layers = nn.Sequential(*modules, nn.Linear(width, 4))

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Map features [N,120] to density [N,1] and colour [N,3] in 0..1."""
        out = self.layers(features)
        return torch.exp(out[:, :1] + DENSITY_BIAS), torch.sigmoid(out[:, 1:])


class TripoSr(nn.Module):
    """TripoSR's network: maps an image to a triplane."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.sizes = sizes
        width = sizes.width
        self.image_tokenizer = nn.ModuleDict({"model": VisionTransformer(sizes)})
        planes = torch.randn(3, width, sizes.plane, sizes.plane) / math.sqrt(width)
        self.tokenizer = nn.ParameterDict({"embeddings": nn.Parameter(planes)})
        self.backbone = SpatialTransformer(
            width,
            sizes.vision_width,
            sizes.heads,
            depth=sizes.layers,
            picture_tokens=0,
            picture_weight=1.0,
        )
        conv = nn.ConvTranspose2d(width, sizes.channels, 2, stride=2)
        self.post_processor = nn.ModuleDict({"upsample": conv})
        self.decoder = Decoder(3 * sizes.channels, sizes.decoder_width, sizes.decoder_layers)

    def forward(self, image: Tensor) -> Tensor:
        """Map colours [1,3,512,512] in 0..1 to the triplane [1,3,40,64,64]."""
        seen = self.image_tokenizer["model"](image)
        # The three planes are stacked into one tall map; the map's shape does not affect the
        # transformer.
        planes = self.tokenizer["embeddings"].transpose(0, 1).flatten(1, 2)[None]
        planes = self.backbone(planes, seen, 1)[0].unflatten(1, (3, -1)).transpose(0, 1)
        return self.post_processor["upsample"](planes)[None]


def load(tensors: StateDict, sizes: Sizes | None = None) -> TripoSr:
    """Build the network and load the tensors.

    Raises:
        InputError: If the tensors are not those of TripoSR.
    """
    with torch.device("meta"):
        network = TripoSr(sizes or Sizes())
    needed = {name: value for name, value in tensors.items() if not name.startswith(UNUSED)}
    fill(network, needed, "TripoSR")
    return network.float().eval().requires_grad_(False)
