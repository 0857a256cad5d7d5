"""Meetings: computes all contact between bodies, and of each body with itself."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.lattice.contact import make_place
from phy124.lattice.clamps import PassedOn
from phy124.lattice.impulses import ContactWork
from phy124.lattice.itself import FRICTION, Meeting
from phy124.lattice.partners import FAR, Partners
from phy124.lattice.surface import Surface
from phy124.lattice.walls import AHEAD, CLOSE, REACH, Nodes
from phy124.lattice.workers import Division
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.pairs import Pairs
from phy124.mpm.stage import Named
from phy124.mpm.tracks import Tracks

SAMPLED = 1.5
"""Distance between neighbouring sampled surface points [cells]."""


class Meetings(Kept):
    """Contact between bodies, and between parts of a body."""

    kept = ("of_bodies", "of_pairs")

    def __init__(
        self,
        surface: Surface,
        model: Model,
        nodes: Nodes,
        tracks: Tracks,
        pairs: Pairs,
        restore: float,
        division: Division,
    ) -> None:
        """Prepare the contact; initially, no points touch.

        `restore` [1/s] is the speed at which penetrating points separate, divided by their depth.
        """
        self.work: ContactWork | None = None
        self.way = math.inf
        """Upper bound of all displacements since the surfaces were last compared [m]."""
        self._slack = 0.0
        """Relative displacement after which the surfaces are compared again [m]."""
        self._dx = model.dx
        inside = np.flatnonzero(surface.meets_bodies)
        cube = np.floor(surface.x[inside] / (SAMPLED * model.dx)).astype(np.int64)
        keys = np.column_stack([surface.body[inside], cube])
        sample = inside[np.unique(keys, axis=0, return_index=True)[1]]
        self._bodies = [np.flatnonzero(surface.body[sample] == b) for b in range(model.bodies)]
        self._x = wp.zeros(len(sample), dtype=types(model.real).vec3, device=model.device)
        self._place = model.launch(
            make_place(model.real, nodes.rows),
            len(sample),
            [
                wp.array(sample.astype(np.int32), dtype=int, device=model.device),
                *nodes.points,
                nodes.u,
            ],
            [self._x],
        )
        partners = Partners(surface, model, nodes, division)
        everywhere = surface, model, nodes, tracks, partners, restore
        self.of_bodies = [
            Meeting(*everywhere, sample[self._bodies[body]], (body, body), friction=FRICTION)
            for body in range(model.bodies)
            if body not in model.held
        ]
        """Contact of each body with itself."""
        self.of_pairs = [
            Meeting(
                *everywhere,
                sample[np.concatenate([self._bodies[pair.first], self._bodies[pair.second]])],
                (pair.first, pair.second),
                friction=pair.friction,
                sticky=pair.sticky,
                sums=pairs.sums_of(index),
            )
            for index, pair in enumerate(pairs.all)
        ]
        """Contact of pairs of bodies."""

    @property
    def every(self) -> list[Meeting]:
        """The contacts of bodies with themselves, followed by the contacts of pairs of bodies."""
        return [*self.of_bodies, *self.of_pairs]

    def stages(self, passed: PassedOn | None) -> list[list[Named]]:
        """Return the kernel launches of a substep that apply, correct and sum contact impulses."""
        stages = [meeting.record(self.work, passed) for meeting in self.every]
        return [[each[k] for each in stages if len(each) > k] for k in range(3)]

    def follow(self, step: float) -> None:
        """Determine the pairs of points again if bodies have moved relative to each other.

        A point moves at most `step` [m] in a substep.
        """
        if self._place is None:
            return
        for meeting in self.every:
            meeting.limit(min(REACH * self._dx, 2 * AHEAD * step + CLOSE * self._dx))
        if 2 * self.way < self._slack:
            return
        self._place.launch()
        x: NDArray[Any] = self._x.numpy()
        bodies = [x[index].astype(np.float64) for index in self._bodies]
        for meeting in self.of_bodies:
            meeting.follow(bodies[meeting.bodies[0]])
        boxes = [
            (part.min(axis=0), part.max(axis=0)) if len(part) and self.of_pairs else None
            for part in bodies
        ]
        for meeting in self.of_pairs:
            a, b = (boxes[body] for body in meeting.bodies)
            if a is None or b is None:
                continue
            if np.all(np.maximum(a[0], b[0]) - np.minimum(a[1], b[1]) < FAR * self._dx):
                meeting.follow(np.concatenate([bodies[body] for body in meeting.bodies]))
            else:
                meeting.part()
        self.way, self._slack = 0.0, min((m.slack for m in self.of_bodies), default=math.inf)
        if self.of_pairs:
            self._slack = 0.0

    def forget(self, body: int) -> None:
        """Reset the contact of a body with other bodies, after the body has been moved."""
        self.way = math.inf
        for meeting in self.of_pairs:
            if body in meeting.bodies:
                meeting.forget()

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        super().restore(snapshot)
        self.way = math.inf
