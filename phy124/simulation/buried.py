"""Walls inside which an object already stands: contact stops what comes, it pushes nothing out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from phy124.boundaries import Boundary
from phy124.boundaries.planes import Plane
from phy124.errors import InputError
from phy124.mpm import Model

DEEP = 1.0
"""Depth inside a wall that counts [cells]; less is how closely surfaces are known."""
MOST = 0.1
"""Largest fraction of the material that may be so deep; less gets a note."""


class Buried(NamedTuple):
    """A wall with material behind it at the start."""

    kind: str
    fraction: float
    """Fraction of the material that meets the wall and is deeper than `DEEP` cells behind it."""
    depth: float
    """Depth of the deepest particle [m]."""

    @property
    def what(self) -> str:
        """A clause that says it."""
        return (
            f"{self.fraction:.1%} of the material starts inside it, up to {self.depth:.2g} m deep"
        )


def refuse_buried(boundaries: Sequence[Boundary], model: Model) -> None:
    """Make sure that no object starts inside a flat wall.

    Raises:
        InputError: More than `MOST` of what meets the wall does.
    """
    for found in buried(boundaries, model):
        if found.fraction > MOST:
            raise InputError(
                "boundaries", found.kind, f"{found.what}; a wall stops what comes, and pushes "
                "nothing out.",
                "Move the wall, or lift the object (object.lift).",
            )  # fmt: skip


def notes(boundaries: Sequence[Boundary], model: Model) -> list[str]:
    """A sentence for each flat wall that a little of the material starts inside."""
    return [
        f"The {found.kind}: {found.what}, and stays there." for found in buried(boundaries, model)
    ]


def buried(boundaries: Sequence[Boundary], model: Model) -> Iterator[Buried]:
    """The flat walls that have material behind them at the start."""
    moves = model.moves
    for boundary in boundaries:
        for wall in boundary.parts():
            if not isinstance(wall, Plane):
                continue
            point, normal, _ = wall.geometry(model)
            track = wall.track(model)
            shift = np.zeros(3) if track is None else track.values(np.zeros(1))[0]
            own = np.zeros(len(model), bool)
            own[model.named(wall.object)] = True
            x = model.rest[own & moves]
            depth = -((x - (np.asarray(point) + shift)) @ np.asarray(normal))
            deep = depth > DEEP * model.dx
            if deep.any():
                yield Buried(
                    type(boundary).__name__.lower(), float(deep.mean()), float(depth.max())
                )
