"""Interior: what is seen where elastic material is torn apart, in the colours of its surface.

The Gaussians of a generator lie on the surface, so an object that is torn would show a hole. Once
the grid has torn something, the particles inside that have lost a neighbour get Gaussians, too:
round ones, like grains. They are added to the finished clip, since nobody knows beforehand which
they are; until its place is opened, each lies hidden in the surface Gaussian above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, joined
from phy124.io.clip import Clip
from phy124.materials import AnyMaterial
from phy124.monitor.tearing import APART
from phy124.particles import Particles
from phy124.particles.grains import grains_at
from phy124.simulation.deform import by_object

NEIGHBOURS = 7
"""Particles that count as neighbours at rest: in a lattice six, and itself."""
HIDDEN = 1e-3
"""Size of a Gaussian that is not to be seen, relative to its size."""
Opened = dict[str, NDArray]


class Interior:
    """The inside of what is torn in one run; call `look` once for each frame."""

    def __init__(
        self,
        shown: Gaussians,
        particles: Particles,
        materials: Sequence[AnyMaterial],
        *,
        spacing: float,
        dx: float,
    ) -> None:
        """Remember the object at rest; nothing is computed before something is torn.

        Args:
            shown: All Gaussians that are shown anyway, N.
            particles: The particles that move.
            materials: Their materials; only what is elastic is torn.
            spacing: Distance of neighbouring particles at rest, m.
            dx: Grid spacing, m.
        """
        self._shown, self._rest, self._materials = shown, particles, materials
        self._spacing, self._dx = spacing, dx
        self._inside: NDArray[np.int64] | None = None
        self._opened: dict[int, Opened] = {}
        """For each frame with a tear: which of those inside lie open, and where they are."""

    def look(self, index: int, x: NDArray) -> None:
        """See what lies open in a frame in which something is torn.

        Args:
            index: Number of the frame.
            x: Positions of the particles [P,3], m.
        """
        if self._inside is None:
            self._prepare()
        assert self._inside is not None
        here = x[self._inside]
        ways = x[self._neighbours] - here[:, None]
        lost = ((ways**2).sum(axis=2) > (APART * self._dx) ** 2).any(axis=1)
        # Gaps are wider than a particle: what lies behind the first layer is seen, too.
        alone = np.zeros(len(x), bool)
        alone[self._inside[lost]] = True
        ids = np.flatnonzero(lost | alone[self._neighbours].any(axis=1))
        self._opened[index] = {"ids": ids, "x": here[ids].astype(np.float32)}

    def added_to(self, clip: Clip) -> Clip:
        """The clip with a Gaussian for each particle that lies open in any of its frames."""
        ids = np.unique(
            np.concatenate([np.zeros(0, int), *(o["ids"] for o in self._opened.values())])
        )
        if not len(ids):
            return clip
        if self._inside is None:
            self._prepare()
        above, grains = self._above[ids], self._grains.select(ids)
        means = clip.means[:, above].copy()
        scales = np.repeat(HIDDEN * grains.scales[None], len(clip), axis=0)
        latest: Opened = {"ids": ids[:0], "x": means[0, :0]}
        for index in range(len(clip)):
            latest = self._opened.get(index, latest)
            at = np.searchsorted(ids, latest["ids"])
            means[index, at], scales[index, at] = latest["x"], grains.scales[at]
        each = {"means": means, "quats": clip.quats[:, above], "scales": scales}
        for name in ("rotations", "velocities"):
            if getattr(clip, name) is not None:
                each[name] = getattr(clip, name)[:, above]
        if clip.contacts is not None:
            each["contacts"] = np.zeros_like(means)
        more = {n: np.concatenate([getattr(clip, n), a], axis=1) for n, a in each.items()}
        moving = (clip.means[0], clip.quats[0], clip.scales[0])
        surface = Gaussians(*moving, clip.opacities, clip.sh, clip.object_id)
        whole = joined([surface, grains])
        fixed = {name: getattr(whole, name) for name in ("opacities", "sh", "object_id")}
        return replace(clip, **more, **fixed)

    def snapshot(self) -> dict[str, Any]:
        """What lay open in the frames so far."""
        return {str(index): dict(opened) for index, opened in self._opened.items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self._opened = {int(index): opened for index, opened in snapshot.items()}

    def _prepare(self) -> None:
        """Find the elastic particles without a Gaussian, their neighbours, and their looks."""
        rest = self._rest
        elastic = np.array([s.device_law.project is None for s in self._materials])[rest.material]
        free = elastic & (rest.gaussian < 0)
        # What touches at the start and parts later is not torn: each object is looked at alone.
        found = []
        for ours, theirs in by_object(self._shown, rest):
            if len(theirs):
                found.append(self._of_object(ours, theirs, free[theirs]))
        grains, above, inside, neighbours = zip(*found, strict=True)
        self._grains, self._above = joined(grains), np.concatenate(above)
        self._inside, self._neighbours = np.concatenate(inside), np.concatenate(neighbours)

    def _of_object(
        self, ours: NDArray[np.intp], theirs: NDArray[np.intp], free: NDArray[np.bool_]
    ) -> tuple[Gaussians, NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Grains, the Gaussians above them, their particles, and these particles' neighbours.

        Args:
            ours: The Gaussians of an object.
            theirs: Its particles.
            free: Which of these may have a grain.
        """
        x = self._rest.x[theirs]
        shown = self._shown if len(ours) == len(self._shown) else self._shown.select(ours)
        places = np.flatnonzero(free)
        grains, above, clear = grains_at(shown, x[places], self._spacing)
        inside = places[clear]
        most = min(NEIGHBOURS, len(x))
        near = np.reshape(
            scipy.spatial.KDTree(x).query(x[inside], k=most, workers=-1)[1], (len(inside), most)
        )
        # A tiny object has fewer neighbours: the last one counts more often.
        near = np.pad(near, ((0, 0), (0, NEIGHBOURS - most)), mode="edge")
        return grains, ours[above], theirs[inside], theirs[near]
