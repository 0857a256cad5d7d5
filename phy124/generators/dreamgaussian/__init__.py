"""The first stage of DreamGaussian: optimisation by score distillation (Tang et al. 2024)."""

from phy124.generators.dreamgaussian.density import Density
from phy124.generators.dreamgaussian.generator import (
    WITH_IMAGEDREAM,
    DreamGaussian,
    Settings,
    fit,
    start,
)
from phy124.generators.dreamgaussian.guidance import Guidance, Pose, sds
from phy124.generators.dreamgaussian.splats import Rates, Splats

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
