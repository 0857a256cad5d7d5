"""PATH.ply: Gaussians that another program made, brought to the default place and size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.ply import read_ply
from phy124.progress import Progress, silent

if TYPE_CHECKING:
    from PIL import Image

MIN_OPACITY = 0.005
"""Fainter Gaussians are left out, as LGM does when it saves."""
TAIL = 0.005
"""Share of the opacity that may lie off either end before outliers are told from the object."""
MARGIN = 0.5
"""How far from that core, in its sizes, a Gaussian still belongs to the object."""


@dataclass(frozen=True)
class PlyFile:
    """The generator that reads a file instead of looking at the picture."""

    path: str
    up: str | None = None
    """Axis of the file that points up, as in `phy124.ply.read_ply`."""
    front: str | None = None
    """Axis of the file that the object's front faces."""
    dialect: str = "3dgs"
    """Program that wrote it, where `up` is not given."""

    def __call__(
        self,
        image_rgba: Image.Image | NDArray[np.uint8] | None = None,
        *,
        seed: int = 0,
        progress: Progress = silent,
    ) -> Gaussians:
        """The file's Gaussians, longest side 1 m; neither picture nor seed matter.

        Raises:
            InputError: As `read_ply`, or all Gaussians are nearly transparent or in one point.
        """
        del image_rgba, seed
        return self.read(progress)[0]

    def read(self, progress: Progress = silent) -> tuple[Gaussians, list[str]]:
        """The same, and a sentence for each reason for which some were left out."""
        progress("read", 0, 1)
        ply = read_ply(self.path, up=self.up, front=self.front, dialect=self.dialect)
        visible = ply.gaussians.opacities >= MIN_OPACITY
        gaussians = ply.gaussians.select(visible)
        if not len(gaussians):
            limit = f"All its Gaussians are fainter than {MIN_OPACITY}."
            raise InputError("PLY file", self.path, limit, "Give a file with a visible object.")
        placed = normalised(gaussians, self.path)
        progress("read", 1, 1)
        left_out = {
            "had NaN or infinite values": ply.dropped,
            f"were fainter than {MIN_OPACITY}": int((~visible).sum()),
        }
        given = len(visible) + ply.dropped
        return placed, [
            f"{count} of {given} Gaussians of the file {why} and were dropped."
            for why, count in left_out.items()
            if count
        ]


def normalised(gaussians: Gaussians, name: str = "") -> Gaussians:
    """Centred on the origin, the longest side 1 m; single Gaussians far off do not count.

    Raises:
        InputError: All centres lie in one point.
    """
    low, high = robust_bounds(gaussians)
    size = float((high - low).max())
    if not size > 0:
        limit = "All its Gaussians lie in one point."
        raise InputError("PLY file", name, limit, "Give a file with an object in it.")
    return gaussians.moved(1 / size, -(low + high) / 2 / size)


def robust_bounds(gaussians: Gaussians) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest centre along each axis [3], m, without outliers.

    The core holds all but `TAIL` of the opacity at either end; the bounds are those of all
    Gaussians within `MARGIN` core sizes of it, so that a clean object loses nothing.
    """
    means = gaussians.means.astype(np.float64)
    core = np.stack([_quantiles(axis, gaussians.opacities) for axis in means.T], axis=1)
    reach = MARGIN * (core[1] - core[0]).max()
    near = ((means >= core[0] - reach) & (means <= core[1] + reach)).all(axis=1)
    return means[near].min(axis=0), means[near].max(axis=0)


def _quantiles(values: NDArray[np.float64], weights: NDArray) -> NDArray[np.float64]:
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order], dtype=np.float64)
    ends = np.searchsorted(share, [TAIL * share[-1], (1 - TAIL) * share[-1]])
    return values[order][np.minimum(ends, len(values) - 1)]
