"""The presets, for tests that run each of them."""

import pytest

from phy124.scene import Scene, preset_names

OF_ONE = [name for name in preset_names() if not Scene.named(name).objects]
"""Those of one object."""
USUAL = "land_on_cushion"
"""The preset of several objects that every run of the tests looks at."""


def each_preset() -> list:
    """All presets; but for one, those of several objects are slow."""
    slow = pytest.mark.slow
    others = [name for name in preset_names() if name not in (*OF_ONE, USUAL)]
    return [*OF_ONE, USUAL, *(pytest.param(name, marks=slow) for name in others)]
