"""LGM: four views to 65,536 Gaussians in one pass of a network (Tang et al. 2024, MIT)."""

from phy124.generators.neural.lgm.generator import Lgm, to_gaussians
from phy124.generators.neural.lgm.model import OPTIONS, LgmModel, Option, load

__all__ = ["OPTIONS", "Lgm", "LgmModel", "Option", "load", "to_gaussians"]
