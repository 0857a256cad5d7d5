"""TripoSR: turns one image into a density field in one pass (Tochilkin et al. 2024, MIT)."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from phy124.weights.store import is_complete

if TYPE_CHECKING:
    from phy124.generators.neural.triposr.generator import TripoSrGenerator


def make_triposr() -> TripoSrGenerator:
    """Return the generator `triposr`."""
    from phy124.generators.neural.triposr.generator import TripoSrGenerator

    return TripoSrGenerator()


def is_present() -> bool:
    """Whether the weights and the package that runs the network are installed."""
    return any(
        is_complete(name) and find_spec("torch" if name == "triposr-torch" else "onnxruntime")
        for name in WEIGHTS
    )


GENERATORS = {"triposr": make_triposr}
WEIGHTS = ("triposr", "triposr-int8", "triposr-torch")
