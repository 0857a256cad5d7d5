"""LGM: turns four views into 65,536 Gaussians in one network pass (Tang et al. 2024, MIT)."""

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
    """Return the generator `lgm`.

    Args:
        device: Device; None: a GPU if there is one.
        steps: Number of steps of ImageDream's diffusion; None: the default.
        sampler: Solver of the diffusion; None: the default.
        precision: Precision of the diffusion's network; None: chosen by the device.
        align: Whether the result is rotated to match the image.
    """
    from phy124.generators.neural.lgm.generator import Lgm

    return Lgm(device=device, steps=steps, sampler=sampler, precision=precision, align=align)


GENERATORS = {"lgm": make_lgm, "lgm-aligned": partial(make_lgm, align=True)}
WEIGHTS = ("lgm", "lgm-fp32", "imagedream")
