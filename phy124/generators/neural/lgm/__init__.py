"""LGM: four views to 65,536 Gaussians in one pass of a network (Tang et al. 2024, MIT)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from phy124.generators.options import Precision, Sampler

if TYPE_CHECKING:
    from phy124.generators.neural.lgm.generator import Lgm


def make_lgm(
    *,
    device: str | None = None,
    steps: int | None = None,
    sampler: Sampler | None = None,
    precision: Precision | None = None,
    align: bool = False,
) -> Lgm:
    """Return the generator.

    Args:
        device: Where it runs; None: a GPU if there is one.
        steps: Steps of ImageDream's diffusion.
        sampler: How the diffusion takes its steps.
        precision: Numbers that its network computes with.
        align: Whether the result is rotated to match the picture.
    """
    from phy124.generators.neural.lgm.generator import Lgm

    return Lgm(device=device, steps=steps, sampler=sampler, precision=precision, align=align)


GENERATORS = {"lgm": make_lgm, "lgm-aligned": partial(make_lgm, align=True)}
WEIGHTS = ("lgm", "lgm-fp32", "imagedream")
