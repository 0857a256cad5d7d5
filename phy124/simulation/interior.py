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
from numpy.typing import NDArray
from scipy.spatial import KDTree

from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.materials import AnyMaterial
from phy124.monitor.tearing import APART
from phy124.particles import Particles
from phy124.particles.grains import grains_at, joined

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
        whole = joined(
            Gaussians(clip.means[0], clip.quats[0], clip.scales[0], clip.opacities, clip.sh), grains
        )
        return replace(clip, **more, opacities=whole.opacities, sh=whole.sh)

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
        free = np.flatnonzero(elastic & (rest.gaussian < 0))
        self._grains, self._above, clear = grains_at(self._shown, rest.x[free], self._spacing)
        self._inside = free[clear]
        count = min(NEIGHBOURS, len(rest.x))
        found = KDTree(rest.x).query(rest.x[self._inside], k=count, workers=-1)[1]
        self._neighbours = np.reshape(found, (len(self._inside), count))
