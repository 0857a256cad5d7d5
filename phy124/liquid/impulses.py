"""Sums each wall's impulse and moment on the liquid, and the walls' work."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import warp as wp

from phy124.kernels.liquid.impulses import COLUMNS, settle
from phy124.kernels.work import EXCHANGE

MEASURED = 6
"""Number of values in a wall's total: the impulse [N s] and the moment about the origin [N m s]."""


class WallImpulses:
    """Impulses of the walls in the current step, per worker, and totals over all steps."""

    def __init__(self, names: Sequence[str], count: int, workers: int, device: str) -> None:
        """Allocate sums for `count` walls and freely moving solids; the solids come last."""
        self.names = tuple(names)
        """Names of the walls of boundaries; these walls come first among all walls."""
        walls, real = max(count, 1), wp.float64
        self.step = wp.zeros((workers, walls, COLUMNS), dtype=real, device=device)
        """Impulses and work of the walls in the current step [workers,walls,7]."""
        self._totals = wp.zeros((walls, MEASURED), dtype=real, device=device)
        self.total = wp.zeros((1, EXCHANGE), dtype=real, device=device)
        """Total impulse and work of all walls, in the order of `phy124.kernels.work`."""
        outputs = [self.step, self._totals, self.total]
        launch: Any = wp.launch(
            settle, 1, inputs=[len(names)], outputs=outputs, device=device, record_cmd=True
        )
        self.settle: Callable[[], Any] = launch.launch
        """Function that adds the sums of a step to the totals and resets the sums."""

    def rows(self, worker: int) -> wp.array:
        """Return a worker's row of `step` [walls,7]."""
        return cast("wp.array", self.step[worker])

    def wrench(self, name: str) -> wp.array:
        """Return the total impulse and moment of a wall on the liquid [6]."""
        return cast("wp.array", self._totals[self.names.index(name)])

    def snapshot(self) -> dict[str, Any]:
        """Return the walls' total impulses."""
        names, totals = list(self.names), np.asarray(self._totals.numpy()).tolist()
        return {"names": names, "totals": totals, "all": self.total.numpy().tolist()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the walls' total impulses."""
        self.step.zero_()
        self.total.assign(np.array(snapshot["all"]))
        if list(snapshot["names"]) == list(self.names):
            self._totals.assign(np.array(snapshot["totals"]))
        else:
            self._totals.zero_()
