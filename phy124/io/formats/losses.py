"""Describes how much a file changes the Gaussians that were written to it."""

from pathlib import Path

import numpy as np

from phy124.gaussians import Gaussians
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.formats import Format

DISPLACED = 1e-3
"""Displacement of a centre that is described, relative to the object's size."""
RESHAPED = 0.1
"""Change of a Gaussian's scale that is described, relative to the Gaussian's largest scale."""
SHARE = 0.01
"""Fraction of the Gaussians that may change more without a description."""

REMEDY = "ply"


def describe_losses(path: Path, written: Gaussians, format: Format) -> list[str]:
    """Return a sentence if the Gaussians in a file differ visibly from the original Gaussians.

    Args:
        path: The file.
        written: The Gaussians in the axes of phy124, with finite values.
        format: The format of the file.

    Raises:
        InputError: The file cannot be read.
    """
    if format.read is None or format.name == REMEDY or not len(written):
        return []
    content = format.read(path)
    turn = orientation(*content.axes)
    stored = rotate_gaussians(content.gaussians, turn)
    if len(stored) != len(written):
        return []
    middle = np.quantile(written.means, (SHARE, 1 - SHARE), axis=0)
    size = float(np.ptp(middle, axis=0).max()) or 1.0
    away = np.abs(stored.means + turn @ content.origin - written.means).max(axis=1) / size
    longest = np.maximum(written.scales.max(axis=1), 1e-30)
    change = np.abs(stored.scales.astype(np.float64) - written.scales).max(axis=1) / longest
    parts = [
        f"{what} of {100 * share:.0f} % of them by up to {100 * values.max():.2g} % of {whole}"
        for values, limit, what, whole in (
            (away, DISPLACED, "displaces the centres", "the object's size"),
            (change, RESHAPED, "changes the scales", "their longest axis"),
        )
        if (share := float((values > limit).mean())) > SHARE
    ]
    if not parts:
        return []
    return [
        f"{format.title} cannot store the Gaussians of an object of {size:.2g} m exactly enough: "
        f"it {' and '.join(parts)}. Use the format {REMEDY}, which stores float32."
    ]


def note_lost(gaussians: Gaussians, format: Format) -> list[str]:
    """Return notes about data that a format cannot store."""
    if gaussians.sh_degree <= format.degree:
        return []
    return [
        f"{format.title} stores no harmonics above degree {format.degree}: changes of colour with "
        "the direction are left out."
    ]
