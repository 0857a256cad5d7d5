"""TripoSR: turns one image into a density field in one pass (Tochilkin et al. 2024, MIT)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phy124.generators.neural.triposr.generator import TripoSrGenerator


def make_triposr() -> TripoSrGenerator:
    """Return the generator `triposr`."""
    from phy124.generators.neural.triposr.generator import TripoSrGenerator

    return TripoSrGenerator()


GENERATORS = {"triposr": make_triposr}
WEIGHTS = ("triposr", "triposr-int8", "triposr-torch")
