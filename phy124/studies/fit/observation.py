"""Reads measurements from tables, and predicts them from a clip."""

import csv
import os
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError, suggest
from phy124.io.clip import Clip

Values = NDArray[np.float64]


class Table(NamedTuple):
    """A table of measurements."""

    times: Values
    """Time of each row [R], s."""
    names: NDArray[np.str_]
    """Name of the point or wall [R]."""
    values: Values
    """Measured values [R,C]."""
    columns: tuple[str, ...]


def read_table(
    path: str | os.PathLike[str], field: str, name: str, kinds: Sequence[tuple[str, ...]]
) -> Table:
    """Read a table of measurements from a file.

    Args:
        path: The .csv file.
        field: The option that names the file, for messages.
        name: The column that contains the names of points or walls.
        kinds: Allowed sets of names for the columns of values.

    Raises:
        InputError: The file cannot be read, has no rows, lacks a column, or contains a value that
            is not a finite number.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if any(cell.strip() for cell in line)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        limit = f"it cannot be read ({getattr(error, 'strerror', None) or 'it is not text'})."
        raise InputError(field, path, limit, "Give a .csv file.") from None
    header = [cell.strip().lower() for cell in lines[0]] if lines else []
    columns = next((kind for kind in kinds if set(kind) <= set(header)), None)
    if columns is None or not {"time", name} <= set(header):
        ways = " or ".join(",".join(("time", name, *kind)) for kind in kinds)
        limit = f"its first line is {','.join(header)!r}."
        raise InputError(field, path, limit, f"The first line must begin with {ways}.")
    if len(lines) == 1:
        raise InputError(field, path, "it has no rows.", "Give measurements at two or more times.")
    places = [header.index(column) for column in ("time", *columns)]
    numbers = np.array([_numbers(path, field, i, line, places) for i, line in enumerate(lines[1:])])
    names = np.array([line[header.index(name)].strip() for line in lines[1:]])
    return Table(numbers[:, 0], names, numbers[:, 1:], columns)


def _numbers(
    path: object, field: str, index: int, line: list[str], places: list[int]
) -> list[float]:
    try:
        numbers = [float(line[place]) for place in places]
    except (ValueError, IndexError):
        numbers = [np.nan]
    if not np.isfinite(numbers).all():
        limit = f"row {index + 1} ({','.join(line)[:60]}) has values that are not finite numbers."
        raise InputError(field, path, limit, "Remove the rows in which a point was not seen.")
    return numbers


Groups = NDArray[np.int64]
FEWEST = 8
"""Smallest number of groups for the bootstrap.

The errors of a point or wall at all times are correlated, so its measurements are a group. If there
are fewer points or walls, their measurements are divided into equal intervals of time, whose errors
are treated as independent.
"""
ROUNDED = 1e-3
"""Largest assumed rounding error of times in files [s]."""


class Observation(Protocol):
    """Measurements of one kind, such as heights, and their prediction from a clip."""

    name: str
    """Name of the kind, in the plural."""
    unit: str
    measured: Values
    """Measured values [M]."""
    groups: Groups
    """Index of each measurement's group [M], from 0; errors within a group are correlated."""
    last: float
    """Time of the last measurement [s]."""

    def predict(self, clip: Clip) -> Values:
        """Predict the measurements [M] from a clip."""
        ...


class Kind(NamedTuple):
    """A kind of measurement, and its slice of the vector of all measurements."""

    name: str
    unit: str
    place: slice


class Observations:
    """All kinds of measurements, concatenated into one vector."""

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
        """Time of the last measurement [s]."""
        return max(part.last for part in self.parts)

    def predict(self, clip: Clip) -> Values:
        """Predict all measurements [M] from a clip."""
        return np.concatenate([part.predict(clip) for part in self.parts])


def at_times(times: Values, values: Values, wanted: Values) -> Values:
    """Interpolate values [T,...] at the times [T] to other times [R]; return [R,...].

    A spline is used unless all times [R] coincide with frames.
    """
    nearest = np.abs(times[None] - wanted[:, None]).argmin(1)
    if np.allclose(times[nearest], wanted, atol=ROUNDED / 10):
        return values[nearest]
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(times, values, k=min(3, len(times) - 1))(wanted)


def divide(track: NDArray[np.int64], times: Values) -> Groups:
    """Return the group of each row [R] of a table, from 0.

    `track` [R] is the index of the point or wall that a row belongs to. A group contains rows of
    one point or wall that are consecutive in time.
    """
    counts = np.bincount(track)
    parts = -(-FEWEST // len(counts))
    order = np.lexsort((times, track))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order)) - (np.cumsum(counts) - counts)[track[order]]
    part = rank * parts // counts[track]
    return np.unique(track * parts + part, return_inverse=True)[1]


def refuse_outside(field: str, source: object, times: Values, length: float) -> None:
    """Refuse measurements outside the time range of a scene.

    Args:
        field: The option that names the file, for messages.
        source: The file that contains the measurements.
        times: Times of the measurements [s].
        length: Time of the scene's last frame [s].

    Raises:
        InputError: A measurement is before the first frame or after the last frame.
    """
    if times.min() < -ROUNDED:
        limit = f"it begins at {times.min():.3g} s, before the scene, which begins at 0."
        raise InputError(
            field, source, limit, "Give times that count from the beginning of the scene."
        )
    if times.max() > length + ROUNDED:
        limit = f"it goes on until {times.max():.3g} s, and the scene's last frame is at "
        remedy = f"Add --set time.seconds={times.max() + 0.1:.3g}, or shorten the recording."
        raise InputError(field, source, f"{limit}{length:.3g} s.", remedy)


class Forces:
    """Measured forces on walls; each is the mean over the time since the previous frame."""

    name, unit = "forces", "N"

    def __init__(self, table: Table, walls: tuple[str, ...]) -> None:
        """Match the names in a table of forces with the scene's walls.

        Raises:
            InputError: The table names a wall that the scene does not have.
        """
        for name in table.names:
            if name not in walls:
                limit = "the scene has no wall with this name."
                remedy = (
                    suggest(str(name), walls)
                    if walls
                    else "Add a boundary with this name to the scene."
                )
                raise InputError("forces", name, limit, remedy)
        self._wall = np.array([walls.index(str(name)) for name in table.names])
        self._times, self.last = table.times, float(table.times.max())
        self.measured: Values = table.values.ravel()
        self.groups: Groups = np.repeat(divide(self._wall, table.times), 3)

    def predict(self, clip: Clip) -> Values:
        """Predict the forces [M] from a clip."""
        assert clip.wrenches is not None
        instants, row = np.unique(self._times, return_inverse=True)
        return at_times(clip.times, clip.wrenches[:, :, 0], instants)[row, self._wall].ravel()
