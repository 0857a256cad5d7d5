"""Where the floor of the stage is: the scene's own, or just under the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.rendering.stage.solids import Placed


def floor_heights(walls: Sequence[Placed], rest: NDArray, times: NDArray) -> NDArray[np.float64]:
    """Height of the floor at each instant [T], m.

    It is that of the highest level plane of the scene that faces up. Without one it is the lowest
    point of the object at rest.
    """
    levels = [wall for wall in walls if wall.is_floor]
    if not levels:
        return np.full(len(times), rest[:, 2].min())
    heights = [wall.height + wall.displacements(times)[:, 2] for wall in levels]
    return np.max(heights, axis=0)
