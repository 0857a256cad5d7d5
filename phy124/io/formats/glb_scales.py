"""Whether the scales of a GLB are standard deviations or their logarithms.

The ratified text of KHR_gaussian_splatting has lengths, its review draft had logarithms, and a file
does not say which it follows. A negative scale tells a logarithm, and so do some generators. Where
all logarithms are above 0, as in a file in millimetres, the Gaussians themselves tell: an object is
covered by Gaussians about as wide as they lie apart. Read as lengths, logarithms are far too small
for that.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

PLAYCANVAS = re.compile(r"splat-transform (\d+)\.(\d+)")
LENGTHS_SINCE = (2, 7)
"""Version of splat-transform that first wrote lengths."""
FEW = 0.01
"""Share of scales up to which negative ones tell nothing: a mirrored length is no logarithm."""
NEIGHBOURS = 4
SOME = 2000
"""Gaussians that are looked at."""
BARE = 0.55
"""Width, in distances to the neighbours, below which Gaussians leave an object full of holes."""
SHORT = 1.0
"""Scale below which all logarithms being above 0 tells nothing: they would be of one size."""
COVERING = (0.6, 6.0)
"""Widths of Gaussians that cover an object, in the same unit: objects had 1.2 to 3.5."""
NOTE = "Its scales are read as logarithms: {}."


def kind_of_scales(
    generator: str, parts: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]
) -> tuple[bool, list[str]]:
    """Whether scales are logarithms, and what is said about it where the file leaves it open.

    Args:
        generator: The program that wrote the file, as the file names it.
        parts: Scales [N,3] and centres [N,3] of each of its primitives.
    """
    negative = sum(np.count_nonzero(scales < 0) for scales, _ in parts)
    if negative > FEW * sum(scales.size for scales, _ in parts):
        return True, []
    if found := PLAYCANVAS.match(generator):
        logs = (int(found[1]), int(found[2])) < LENGTHS_SINCE
        return logs, [NOTE.format(f"{found[0]} wrote such ones")] if logs else []
    if generator.startswith("phy124"):
        return False, []
    if _too_small(*max(parts, key=lambda part: len(part[0]))):
        return True, [NOTE.format("as lengths they would leave it full of holes")]
    return False, []


def _too_small(scales: NDArray[np.float32], means: NDArray[np.float32]) -> bool:
    """Whether Gaussians cover an object only if their scales are logarithms."""
    sound = np.isfinite(means).all(axis=1) & np.isfinite(scales).all(axis=1)
    longest, places = scales[sound].max(axis=1, initial=0), means[sound].astype(np.float64)
    if len(places) <= NEIGHBOURS:
        return False
    from scipy.spatial import KDTree

    some = slice(None, None, max(1, len(places) // SOME))
    # Around k neighbours of a surface there is a circle of k times the area that each has.
    apart = KDTree(places).query(places[some], NEIGHBOURS + 1)[0][:, -1] / np.sqrt(NEIGHBOURS)
    spacing, length = float(np.median(apart)), float(np.median(longest[some]))
    with np.errstate(over="ignore"):
        width = np.exp(length)
    low, high = COVERING
    bare = SHORT < length < BARE * spacing
    return bare and low * spacing <= width <= high * spacing
