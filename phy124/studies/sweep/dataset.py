"""The clips of a sweep from Python, and from torch, whose DataLoader takes it as it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from phy124.io.clip import Clip
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import Row


class Sample(NamedTuple):
    """One clip and what the manifest says of it."""

    row: Row
    clip: Clip


class Dataset:
    """All complete clips of a sweep, by number; `len` and `[...]` are all that torch asks for."""

    def __init__(self, folder: str) -> None:
        """Read the manifest.

        Args:
            folder: The `out` of a sweep: a folder, or an address that fsspec knows.

        Raises:
            InputError: It holds no results of a sweep.
        """
        self._storage = Storage(folder)
        self.rows = [row for row in read_manifest(self._storage) if row["status"] == "done"]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, number: int) -> Sample:
        row = self.rows[number]
        return Sample(row, self._clip(row))

    def __iter__(self) -> Iterator[Sample]:
        return (self[number] for number in range(len(self)))

    def _clip(self, row: Row) -> Clip:
        """A clip; one of another machine is fetched, and in memory."""
        name = f"{row['folder']}/clip.safetensors"
        if self._storage.here is not None:
            return Clip.load(self._storage.here / name)
        with self._storage.local(name) as path:
            clip = Clip.load(path)
            arrays = {
                name: np.array(value)
                for name, value in vars(clip).items()
                if isinstance(value, np.ndarray)
            }
        return replace(clip, **arrays)
