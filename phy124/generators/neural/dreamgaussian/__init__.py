"""The first stage of DreamGaussian: optimisation by score distillation (Tang et al. 2024)."""

from phy124.generators.neural.dreamgaussian.density import Density
from phy124.generators.neural.dreamgaussian.generator import (
    WITH_IMAGEDREAM,
    DreamGaussian,
    Settings,
    fit,
    start,
)
from phy124.generators.neural.dreamgaussian.guidance import Guidance, Pose, sds
from phy124.generators.neural.dreamgaussian.splats import Rates, Splats

__all__ = [
    "WITH_IMAGEDREAM",
    "Density",
    "DreamGaussian",
    "Guidance",
    "Pose",
    "Rates",
    "Settings",
    "Splats",
    "fit",
    "sds",
    "start",
]
