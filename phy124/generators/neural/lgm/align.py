"""Rotates LGM's result to match the input picture, after Ren et al. 2023, "DreamGaussian4D".

ImageDream does not keep the azimuth of the picture it is given, so the object's front drifts.
DreamGaussian4D draws the result from all around, takes the azimuth that resembles the picture best,
draws four new views from there, and runs LGM on them once more.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from phy124.generators.neural.lgm.rays import AZIMUTHS
from phy124.generators.neural.lgm.rotations import draw
from phy124.progress import Progress, silent

SIDE = 128
"""Side of the pictures that are compared, pixels."""


def front(
    rows: Tensor, image: Tensor, *, step: int = 1, side: int = SIDE, progress: Progress = silent
) -> int:
    """Azimuth in degrees from which the Gaussians resemble the picture best.

    Args:
        rows: LGM's Gaussians [N,14].
        image: The picture over white [3,H,W].
        step: Spacing of the azimuths tried, degrees.
        side: Side of the pictures that are compared, pixels.
        progress: Called as in `phy124.progress`.
    """
    wanted = interpolate(image[None].float(), (side, side), mode="area")[0].to(rows)
    azimuths = range(0, 360, step)
    errors = []
    for i, azimuth in enumerate(azimuths):
        progress("align", i, len(azimuths))
        errors.append(float(((draw(rows, azimuth, side) - wanted) ** 2).mean()))
    progress("align", len(azimuths), len(azimuths))
    return azimuths[int(torch.tensor(errors).argmin())]


def four_views(rows: Tensor, azimuth: float, size: int) -> Tensor:
    """Pictures [4,3,S,S] over white from `azimuth` on, a quarter turn apart."""
    return torch.stack([draw(rows, azimuth + turn, size) for turn in AZIMUTHS])
