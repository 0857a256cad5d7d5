"""Measured forces: what the object exerts on walls at some instants."""

from __future__ import annotations

import numpy as np

from phy124.errors import InputError, suggest
from phy124.io.clip import Clip
from phy124.studies.fit.observation import Groups, at_times
from phy124.studies.fit.table import Table, Values


class Forces:
    """Forces on walls, each the mean since the frame before."""

    name, unit = "forces", "N"

    def __init__(self, table: Table, walls: tuple[str, ...]) -> None:
        """Find the walls.

        Args:
            table: When, on which wall, and the force.
            walls: Names of the walls of the scene.

        Raises:
            InputError: There is no wall of a name.
        """
        for name in table.names:
            if name not in walls:
                limit = "the scene has no wall of that name."
                remedy = suggest(str(name), walls) if walls else "Give it a boundary."
                raise InputError("forces", name, limit, remedy)
        self._wall = np.array([walls.index(str(name)) for name in table.names])
        self._times, self.last = table.times, float(table.times.max())
        self.measured: Values = table.values.ravel()
        self.groups: Groups = np.repeat(np.arange(len(table.times)), 3)

    def predicted(self, clip: Clip) -> Values:
        """Those of a clip."""
        assert clip.wrenches is not None
        instants, row = np.unique(self._times, return_inverse=True)
        return at_times(clip.times, clip.wrenches[:, :, 0], instants)[row, self._wall].ravel()
