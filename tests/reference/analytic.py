"""Problems with exact solutions; they live in the package, as `phy124 accuracy` runs them too."""

from phy124.accuracy.problems import (
    Bounce,
    Column,
    Spin,
    Vortex,
    bar_frequency,
    bouncing_ball,
    column_pressure,
    fall,
    free_fall,
    hydrostatic_column,
    spin,
    vibrating_bar,
    vortex,
)

__all__ = [
    "Bounce",
    "Column",
    "Spin",
    "Vortex",
    "bar_frequency",
    "bouncing_ball",
    "column_pressure",
    "fall",
    "free_fall",
    "hydrostatic_column",
    "spin",
    "vibrating_bar",
    "vortex",
]
