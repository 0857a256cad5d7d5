"""The meaning of LGM's quaternions, where the file does not say.

Both generations of the weights have the same names and shapes. A file with an unknown checksum is
judged by its result: drawn into the four views it was given, the right interpretation fits them
better.
"""

from __future__ import annotations

import torch
from torch import Tensor

from phy124.generators.neural.lgm.model import Rotations
from phy124.generators.neural.lgm.rays import AZIMUTHS, RADIUS
from phy124.generators.neural.splatting import orbit_view, rasterize

NOT_ROTATED = (1.0, 0.0, 0.0, 0.0)
SIDE = 128
"""Side of the pictures that are compared, pixels."""
MARGIN = 0.98
"""Ratio of errors that the old interpretation must beat, since the new generation is usual."""


def unrotated(rows: Tensor) -> Tensor:
    """Gaussians [N,14] with identity quaternions, as the first generation was drawn."""
    rows = rows.clone()
    rows[:, 7:11] = rows.new_tensor(NOT_ROTATED)
    return rows


def judge(rows: Tensor, images: Tensor) -> Rotations:
    """Which reading of the quaternions in `rows [N,14]` redraws `images [4,3,H,W]` better."""
    pictures = torch.nn.functional.interpolate(images, (SIDE, SIDE), mode="area")
    each, none = error(rows, pictures), error(unrotated(rows), pictures)
    return "all" if none < MARGIN * each else "each"


def error(rows: Tensor, pictures: Tensor) -> float:
    """Mean squared error of the four redrawn views against `pictures [4,3,S,S]` over white."""
    drawn = [draw(rows, azimuth, pictures.shape[-1]) for azimuth in AZIMUTHS]
    return float(((torch.stack(drawn) - pictures) ** 2).mean())


@torch.no_grad()
def draw(rows: Tensor, azimuth: float, size: int, *, elevation: float = 0.0) -> Tensor:
    """Picture [3,S,S] over white of Gaussians seen from LGM's orbit.

    Args:
        rows: LGM's Gaussians [N,14].
        azimuth: Degrees.
        size: Side of the picture, pixels.
        elevation: Degrees; positive is below the object.
    """
    rows = rows.float()
    view = orbit_view(elevation, azimuth, RADIUS, size)
    parts = rows[:, 0:3], rows[:, 7:11], rows[:, 4:7], rows[:, 3], rows[:, 11:14]
    return rasterize(*parts, view, rows.new_ones(3)).rgb.permute(2, 0, 1).clamp(0, 1)
