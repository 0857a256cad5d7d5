"""The first stage of DreamGaussian: optimisation by score distillation (Tang et al. 2024)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phy124.generators.neural.dreamgaussian.generator import DreamGaussian


def make_dreamgaussian(*, device: str | None = None, steps: int | None = None) -> DreamGaussian:
    """Return the generator `dreamgaussian`.

    If `device` is None, a GPU is used if there is one. `steps` is the number of optimisation steps.
    """
    from phy124.generators.neural.dreamgaussian.generator import DreamGaussian

    return DreamGaussian(device=device, steps=steps)


GENERATORS = {"dreamgaussian": make_dreamgaussian}
WEIGHTS = ("zero123",)
