"""Stopped: a simulation that ended early because its results would be wrong."""

from __future__ import annotations

from collections.abc import Sequence

from phy124.budget.remedies import advise
from phy124.errors import Remedy


class Stopped(RuntimeError):
    """The simulation ended early because its results would be wrong; the message says why.

    `remedies` are changes to the scene, each of which helps by itself.
    """

    def __init__(self, why: str, remedies: Sequence[Remedy] = ()) -> None:
        self.remedies = tuple(remedies)
        super().__init__(f"{why} {advise(remedies)}".strip())
