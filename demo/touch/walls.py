"""Walls: what stands around the object of a live run, as a browser gets it."""

from __future__ import annotations

from typing import Any

import numpy as np

from phy124.live import Live
from phy124.rendering.stage.solids import floor_heights, place_walls


class Walls:
    """The floor of a live run and its other boundaries, as solids that move without turning.

    A frame is the height of the floor and the displacement of each solid, float32; NaN: there is no
    floor, or the solid is not there.
    """

    def __init__(self, live: Live) -> None:
        """Find what there is to be drawn.

        Args:
            live: The run.
        """
        self._live = live
        walls = place_walls(live.scene.boundaries, live.rest)
        self._floors = [wall for wall in walls if wall.is_floor]
        self._others = [wall for wall in walls if not wall.is_floor]

    @property
    def floor(self) -> float | None:
        """Height of the floor now [m]; None without one."""
        if not self._floors:
            return None
        return float(floor_heights(self._floors, self._live.rest, np.array([self._live.time]))[0])

    def data(self) -> list[dict[str, Any]]:
        """The solids at rest, as plain data."""
        solids = [wall.solid() for wall in self._others]
        return [
            {"centre": one.centre.tolist(), "axes": one.axes.tolist(),
             "half": one.half.tolist(), "radius": one.radius}
            for one in solids
        ]  # fmt: skip

    def frame(self) -> bytes:
        """Where they are now."""
        now = np.array([self._live.time])
        moved = [
            wall.displacements(now)[0] if wall.present(now)[0] else np.full(3, np.nan)
            for wall in self._others
        ]
        floor = np.nan if self.floor is None else self.floor
        return np.array([floor, *np.ravel(moved)], "<f4").tobytes()
