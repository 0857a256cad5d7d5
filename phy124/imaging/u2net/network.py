"""Defines U2-Net, a U-Net in which every stage is itself a small U-Net.

Source: Qin et al. 2020, "U^2-Net: Going Deeper with Nested U-Structure for Salient Object
Detection". The submodules have the same names as in the public .pth files.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from phy124.weights.checkpoints import StateDict, fill

SIDES = 6


class ConvBnRelu(nn.Module):
    """3x3 convolution, batch normalisation and ReLU, at constant resolution."""

    def __init__(self, inputs: int, outputs: int, dilation: int = 1) -> None:
        super().__init__()
        self.conv_s1 = nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation)
        self.bn_s1 = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return feature maps [B,outputs,H,W]."""
        return F.relu(self.bn_s1(self.conv_s1(x)))


def _pool(x: Tensor) -> Tensor:
    return F.max_pool2d(x, 2, stride=2, ceil_mode=True)


def _resize_like(x: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(x, size=like.shape[2:], mode="bilinear", align_corners=False)


class ResidualU(nn.Module):
    """Residual U-block RSU-L, with `levels` convolutions down, `levels` - 1 up, and a shortcut.

    With `dilated` (RSU-4F), the resolution is constant. Instead of pooling, dilations of 1, 2, 4
    and 8 widen the receptive field.
    """

    def __init__(
        self, levels: int, inputs: int, middle: int, outputs: int, *, dilated: bool = False
    ) -> None:
        super().__init__()
        self.levels, self.dilated = levels, dilated
        self.rebnconvin = ConvBnRelu(inputs, outputs)
        for i in range(1, levels + 1):
            dilation = 2 ** (i - 1) if dilated else 1 + (i == levels)
            layer = ConvBnRelu(outputs if i == 1 else middle, middle, dilation)
            self.add_module(f"rebnconv{i}", layer)
        for i in range(levels - 1, 0, -1):
            dilation = 2 ** (i - 1) if dilated else 1
            layer = ConvBnRelu(2 * middle, outputs if i == 1 else middle, dilation)
            self.add_module(f"rebnconv{i}d", layer)

    def forward(self, x: Tensor) -> Tensor:
        """Return feature maps [B,outputs,H,W]."""
        whole = self.rebnconvin(x)
        x, skips = whole, []
        for i in range(1, self.levels + 1):
            # The last level has the same resolution as the level before it.
            pooled = not self.dilated and 1 < i < self.levels
            x = self.get_submodule(f"rebnconv{i}")(_pool(x) if pooled else x)
            skips.append(x)
        x = skips.pop()
        for i in range(self.levels - 1, 0, -1):
            skip = skips.pop()
            joined = torch.cat([_resize_like(x, skip), skip], dim=1)
            x = self.get_submodule(f"rebnconv{i}d")(joined)
        return x + whole


@dataclass(frozen=True)
class Widths:
    """Numbers of channels of each stage of the U-Net: inputs, inside the stage, outputs."""

    down: tuple[tuple[int, int, int], ...]
    """Encoder stages 1 to 6."""
    up: tuple[tuple[int, int, int], ...]
    """Decoder stages 5d to 1d."""


WIDTHS = {
    "u2net": Widths(
        (
            (3, 32, 64),
            (64, 32, 128),
            (128, 64, 256),
            (256, 128, 512),
            (512, 256, 512),
            (512, 256, 512),
        ),
        ((1024, 256, 512), (1024, 128, 256), (512, 64, 128), (256, 32, 64), (128, 16, 64)),
    ),
    "u2netp": Widths(((3, 16, 64), *[(64, 16, 64)] * 5), ((128, 16, 64),) * 5),
}
LEVELS = (7, 6, 5, 4, 4, 4)
"""Encoder stages 1 to 6; the last two stages are dilated."""


class U2Net(nn.Module):
    """Maps normalised images [B,3,H,W] to saliency maps (d0, ..., d6), each [B,1,H,W] in 0..1.

    d0 is the result of the network; d1 to d6 are the side outputs from which d0 is fused.
    """

    def __init__(self, widths: Widths) -> None:
        super().__init__()
        for i, (levels, channels) in enumerate(zip(LEVELS, widths.down, strict=True), 1):
            self.add_module(f"stage{i}", ResidualU(levels, *channels, dilated=i >= 5))
        for i, channels in zip(range(5, 0, -1), widths.up, strict=True):
            self.add_module(f"stage{i}d", ResidualU(LEVELS[i - 1], *channels, dilated=i == 5))
        deep = [channels[2] for channels in reversed(widths.up)] + [widths.down[-1][2]]
        for i, channels in enumerate(deep, 1):
            self.add_module(f"side{i}", nn.Conv2d(channels, 1, 3, padding=1))
        self.outconv = nn.Conv2d(SIDES, 1, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """Return (d0, ..., d6); the height and width of `x` may be odd."""
        skips = []
        for i in range(1, 7):
            x = self.get_submodule(f"stage{i}")(x if i == 1 else _pool(x))
            skips.append(x)
        outputs = [skips.pop()]
        for i in range(5, 0, -1):
            skip = skips.pop()
            x = torch.cat([_resize_like(outputs[-1], skip), skip], dim=1)
            outputs.append(self.get_submodule(f"stage{i}d")(x))
        first = self.get_submodule("side1")(outputs[-1])
        sides = [first]
        for i in range(2, 7):
            side = self.get_submodule(f"side{i}")(outputs[SIDES - i])
            sides.append(_resize_like(side, first))
        joined = self.outconv(torch.cat(sides, dim=1))
        return tuple(torch.sigmoid(d) for d in (joined, *sides))


def load(tensors: StateDict) -> U2Net:
    """Build U2-Net or U2-NetP from the tensors.

    Raises:
        InputError: If the tensors fit neither network.
    """
    middle = tensors.get("stage1.rebnconv1.conv_s1.weight")
    small = middle is not None and middle.shape[0] == WIDTHS["u2netp"].down[0][1]
    name = "u2netp" if small else "u2net"
    with torch.device("meta"):
        network = U2Net(WIDTHS[name])
    fill(network, tensors, "U2-NetP" if small else "U2-Net")
    return network.float().eval().requires_grad_(False)
