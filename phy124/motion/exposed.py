"""Shows Gaussians of inner particles. The Gaussians stay hidden in the surface until a tear exposes
the particles.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array, Gaussians

HIDDEN = 1e-3
"""Size of a Gaussian while it is hidden, relative to its full size."""


@dataclass(frozen=True, eq=False)
class Exposed:
    """The G Gaussians of inner particles, and the frames in which each Gaussian is exposed.

    A hidden Gaussian is a small copy of the Gaussian above it; an exposed Gaussian is at the
    position of its particle. The E exposures are sorted by Gaussian, then by frame.
    """

    grains: Gaussians
    """The Gaussians at full size, with the positions of their particles at rest."""
    above: NDArray[np.int32]
    """Index of the surface Gaussian that hides each Gaussian [G]."""
    grain: NDArray[np.int32]
    """Index of the Gaussian of each exposure [E], 0 to G - 1."""
    frame: NDArray[np.int32]
    """Index of the frame of each exposure [E]."""
    x: NDArray[np.float32]
    """Position of the particle in each exposure [E,3], m."""

    @cached_property
    def _by_frame(self) -> NDArray[np.intp]:
        return np.argsort(self.frame, kind="stable")

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        """Indices of each frame's first exposure in the order of frames; the last entry is E."""
        frames = np.arange(self.frame.max(initial=-1) + 2)
        return np.searchsorted(self.frame[self._by_frame], frames)

    def show(
        self, row: Mapping[str, Array], index: int, grains: NDArray[np.intp]
    ) -> dict[str, Array]:
        """Return the arrays of a frame, with the centres and sizes of the exposed Gaussians set.

        Args:
            row: Arrays of M Gaussians by name. A hidden Gaussian has the values of the Gaussian
                above it.
            index: Index of the frame.
            grains: For each of the M Gaussians, its index among the G grains; -1 if it is not a
                grain.
        """
        means, scales = row["means"].copy(), row["scales"].copy()
        rows = np.flatnonzero(grains >= 0)
        scales[rows] = HIDDEN * self.grains.scales[grains[rows]]
        start, end = self._starts[index : index + 2] if index + 1 < len(self._starts) else (0, 0)
        exposures = np.full(len(self.above), -1)
        exposures[self.grain[self._by_frame[start:end]]] = self._by_frame[start:end]
        each = exposures[grains[rows]]
        rows, each = rows[each >= 0], each[each >= 0]
        means[rows], scales[rows] = self.x[each], self.grains.scales[grains[rows]]
        return {**row, "means": means, "scales": scales}
