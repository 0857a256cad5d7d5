"""Kept: base class of objects whose state consists of attributes that their class lists.

A snapshot consists of arrays and plain data, so a snapshot can be stored in a file
(phy124/pipeline/resume.py). A snapshot shares no memory with the object, and can be restored
repeatedly.
"""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import warp as wp


class Kept:
    """An object whose state is in the attributes named in `kept`."""

    kept: tuple[str, ...] = ()
    """Names of the attributes that belong to the state. The keys of a snapshot are these names
    without a leading underscore.
    """

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot of the state, as arrays and plain data."""
        return {name.lstrip("_"): copy_of(getattr(self, name)) for name in self.kept}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the attributes that a snapshot contains; do not change other attributes."""
        for name in self.kept:
            key = name.lstrip("_")
            if key in snapshot:
                now = getattr(self, name)
                value = put_back(now, snapshot[key])
                if value is not now:
                    setattr(self, name, value)


def copy_of(value: Any) -> Any:
    """Return a copy of a value for a snapshot: an array, or plain data.

    Lists of objects become dictionaries by index.
    """
    if hasattr(value, "snapshot"):
        return value.snapshot()
    if isinstance(value, wp.array):
        return wp.clone(value)
    if isinstance(value, np.ndarray):
        return value.copy()
    if is_dataclass(value):
        return {field.name: copy_of(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, list) and not all(isinstance(item, (int, float)) for item in value):
        return {str(index): copy_of(item) for index, item in enumerate(value)}
    return type(value)(value) if isinstance(value, (list, dict)) else value


def put_back(now: Any, copy: Any) -> Any:
    """Restore a value from a copy that `copy_of` made, and return the value.

    Objects, lists of objects, and arrays on the device are changed in place. If `copy` was read
    from a file, its tuples may have become lists.
    """
    if hasattr(now, "restore"):
        now.restore(copy)
        return now
    if isinstance(now, wp.array):
        put_rows(now, copy)
        return now
    if isinstance(copy, np.ndarray):
        return copy.copy()
    if is_dataclass(now):
        return type(now)(**{name: put_back(getattr(now, name), copy[name]) for name in copy})
    if isinstance(now, list) and isinstance(copy, dict):
        now[:] = [put_back(*pair) for pair in zip(now, copy.values(), strict=True)]
        return now
    if isinstance(now, tuple):
        return type(now)(*copy) if hasattr(now, "_fields") else tuple(copy)
    return type(now)(copy) if isinstance(now, (list, dict)) else copy


def put_rows(sums: wp.array, rows: Any) -> None:
    """Set an array of sums from a snapshot.

    If there is a row per worker and the number of workers has changed, the first row gets the
    total.
    """
    if len(rows) != len(sums):
        rows = np.asarray(rows.numpy() if isinstance(rows, wp.array) else rows)
        first = np.zeros(sums.shape)
        first[0] = rows.sum(axis=0)
        rows = first
    sums.assign(rows)
