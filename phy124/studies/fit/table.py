"""Tables of measurements: CSV files with a line of names, numbers that are all there."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError

Values = NDArray[np.float64]


class Table(NamedTuple):
    """Measurements, one per row."""

    times: Values
    """When [R], s."""
    names: NDArray[np.str_]
    """Of which point or wall [R]."""
    values: Values
    """[R,C]."""
    columns: tuple[str, ...]
    """Names of the values [C]."""


def read_table(
    path: str | os.PathLike[str], field: str, name: str, kinds: Sequence[tuple[str, ...]]
) -> Table:
    """Read a file of measurements.

    Args:
        path: The file.
        field: The option that named it.
        name: The column that says which point or wall a row is about.
        kinds: The columns of values, in each of the ways there are.

    Raises:
        InputError: It cannot be read, lacks a column, has no rows, or a value is no number.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if any(cell.strip() for cell in line)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        limit = f"it cannot be read ({getattr(error, 'strerror', None) or 'it is no text'})."
        raise InputError(field, path, limit, "Give a .csv file.") from None
    header = [cell.strip().lower() for cell in lines[0]] if lines else []
    columns = next((kind for kind in kinds if set(kind) <= set(header)), None)
    if columns is None or not {"time", name} <= set(header):
        ways = " or ".join(",".join(("time", name, *kind)) for kind in kinds)
        limit = f"its first line is {','.join(header)!r}."
        raise InputError(field, path, limit, f"Begin it with {ways}.")
    if len(lines) == 1:
        raise InputError(field, path, "it has no rows.", "Give at least two instants.")
    places = [header.index(column) for column in ("time", *columns)]
    numbers = np.array([_numbers(path, field, i, line, places) for i, line in enumerate(lines[1:])])
    names = np.array([line[header.index(name)].strip() for line in lines[1:]])
    return Table(numbers[:, 0], names, numbers[:, 1:], columns)


def _numbers(
    path: object, field: str, index: int, line: list[str], places: list[int]
) -> list[float]:
    """The numbers of a row."""
    try:
        found = [float(line[place]) for place in places]
    except (ValueError, IndexError):
        found = [np.nan]
    if not np.isfinite(found).all():
        limit = f"row {index + 1} ({','.join(line)[:60]}) has something else than finite numbers."
        raise InputError(field, path, limit, "Leave out the rows in which a point was not seen.")
    return found
