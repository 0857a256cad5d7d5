"""Snapshots contain copies, survive a file, and restore what a class names."""

import json
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from phy124.mpm.kept import Kept, put_rows


class Pair(NamedTuple):
    first: float
    second: float


@dataclass(frozen=True, eq=False)
class Sums:
    impulse: np.ndarray
    work: float


class Part(Kept):
    kept = ("count",)

    def __init__(self):
        self.count = 0


class Whole(Kept):
    kept = ("_pair", "sums", "parts", "part", "rows", "x", "speeds", "tally", "names", "none")

    def __init__(self):
        self._pair, self.sums = Pair(1.0, 2.0), Sums(np.ones(3), 4.0)
        self.parts, self.part = [Part(), Part()], Part()
        self.rows, self.x = wp.ones((2, 3), dtype=wp.float64), np.arange(3)
        self.speeds, self.tally, self.names = [0.5], {"a": 1}, ("a", "b")
        self.none: Any = None

    def change(self):
        self._pair, self.sums = Pair(0.0, 0.0), Sums(np.zeros(3), 0.0)
        self.parts[1].count = self.part.count = 7
        self.rows.zero_()
        self.x += 1
        self.speeds.append(1.0)
        self.tally["a"] = 2
        self.names, self.none = ("c",), np.ones(2)


def plain(value):
    """As `phy124.pipeline.resume` stores it: arrays beside JSON."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, wp.array):
        return value.numpy()
    return value if isinstance(value, np.ndarray) else json.loads(json.dumps(value))


def check(whole):
    assert whole._pair == Pair(1.0, 2.0) and isinstance(whole._pair, Pair)
    assert whole.sums.work == 4.0 and (whole.sums.impulse == 1).all()
    assert [part.count for part in (*whole.parts, whole.part)] == [0, 0, 0]
    assert (whole.rows.numpy() == 1).all() and whole.x.tolist() == [0, 1, 2]
    assert whole.speeds == [0.5] and whole.tally == {"a": 1}
    assert whole.names == ("a", "b") and whole.none is None


def test_a_snapshot_restores_everything_again_and_again():
    whole = Whole()
    snapshot, rows, parts = whole.snapshot(), whole.rows, list(whole.parts)
    for _ in range(2):
        whole.change()
        whole.restore(snapshot)
        check(whole)
    assert whole.rows is rows and whole.parts == parts


def test_a_snapshot_survives_a_file():
    whole = Whole()
    snapshot = plain(whole.snapshot())
    assert "pair" in snapshot
    whole.change()
    whole.restore(snapshot)
    check(whole)


def test_attributes_that_a_snapshot_lacks_are_unchanged():
    part = Part()
    part.count = 3
    part.restore({})
    assert part.count == 3


def test_another_number_of_workers_gets_the_total():
    rows = np.arange(6.0).reshape(3, 2)
    sums = wp.zeros((2, 2), dtype=wp.float64)
    put_rows(sums, rows)
    assert sums.numpy().tolist() == [[6.0, 9.0], [0.0, 0.0]]
    put_rows(sums, wp.array(rows[:2], dtype=wp.float64))
    assert sums.numpy().tolist() == rows[:2].tolist()
