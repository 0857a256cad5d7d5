"""Observations: what was measured, and what a clip would have shown instead."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.studies.fit.table import Values

Groups = NDArray[np.int64]
ROUNDED = 1e-3
"""Times in files may be rounded by this much [s]."""


class Observation(Protocol):
    """Measurements of one kind."""

    name: str
    """What they are, in the plural."""
    unit: str
    measured: Values
    """[M]."""
    groups: Groups
    """Which of them err together, numbered from 0 [M]: those of one point, say."""
    last: float
    """When the last one was made [s]."""

    def predicted(self, clip: Clip) -> Values:
        """The same of a clip [M]."""
        ...


class Kind(NamedTuple):
    """Where the measurements of one kind are among all."""

    name: str
    unit: str
    place: slice


class Observations:
    """All that was measured, as one vector."""

    def __init__(self, parts: list[Observation]) -> None:
        self.parts = parts
        self.measured = np.concatenate([part.measured for part in parts])
        self.kinds: list[Kind] = []
        groups, first, before = [], 0, 0
        for part in parts:
            groups.append(part.groups + before)
            before += int(part.groups.max()) + 1
            self.kinds.append(Kind(part.name, part.unit, slice(first, first + len(part.measured))))
            first += len(part.measured)
        self.groups = np.concatenate(groups)

    @property
    def last(self) -> float:
        """When the last measurement was made [s]."""
        return max(part.last for part in self.parts)

    def predicted(self, clip: Clip) -> Values:
        """The same of a clip [M]."""
        return np.concatenate([part.predicted(clip) for part in self.parts])


def at_times(times: Values, values: Values, wanted: Values) -> Values:
    """Values [T,...] at other instants [R]: as they are where these are frames, else by a spline.

    Args:
        times: Instants of the values [T], s.
        values: The values.
        wanted: The instants asked for [R], s.
    """
    nearest = np.abs(times[None] - wanted[:, None]).argmin(1)
    if np.allclose(times[nearest], wanted, atol=ROUNDED / 10):
        return values[nearest]
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(times, values, k=min(3, len(times) - 1))(wanted)


def refuse_outside(field: str, source: object, times: Values, length: float) -> None:
    """Make sure that a scene lasts as long as what was measured.

    Args:
        field: The option that named the measurements.
        source: Where they are.
        times: When they were made [s].
        length: When the scene's last frame is [s].

    Raises:
        InputError: Some are before its beginning or after its end.
    """
    if times.min() < -ROUNDED:
        limit = f"it begins at {times.min():.3g} s, before the scene, which begins at 0."
        raise InputError(field, source, limit, "Count its time from the scene's beginning.")
    if times.max() > length + ROUNDED:
        limit = f"it goes on until {times.max():.3g} s, and the scene's last frame is at "
        remedy = f"Add --set time.seconds={times.max() + 0.1:.3g}, or shorten it."
        raise InputError(field, source, f"{limit}{length:.3g} s.", remedy)
