"""Reads the clips of a sweep, and packs them into tar files for WebDataset."""

import io
import json
import re
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from phy124.io.clip import Clip
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage, fetch
from phy124.studies.sweep.work import Row


class Sample(NamedTuple):
    """A clip and its row of the manifest."""

    row: Row
    clip: Clip


class Dataset:
    """A sequence of all complete clips of a sweep, also for torch's DataLoader."""

    def __init__(self, folder: str) -> None:
        """Read the manifest in a folder or at an fsspec address.

        Raises:
            InputError: The folder contains no results of a sweep.
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
        name = f"{row['folder']}/clip.safetensors"
        if self._storage.here is not None:
            return Clip.load(self._storage.here / name)
        with fetch(self._storage.place(name)) as path:
            clip = Clip.load(path)
            arrays = {
                name: np.array(value)
                for name, value in vars(clip).items()
                if isinstance(value, np.ndarray)
            }
        return replace(clip, **arrays)


FOLDER = "archives"
NAME = FOLDER + "/{:06d}.tar"
NUMBERED = re.compile(FOLDER + r"/\d+\.tar")


def pack(storage: Storage, per_file: int) -> int:
    """Write all complete clips to tar files with at most `per_file` clips; return their number.

    Each clip is stored as two files: KEY.clip.safetensors, and KEY.json with its row of the
    manifest. Numbered tar files that are left from a longer plan are removed.
    """
    rows = [row for row in read_manifest(storage) if row["status"] == "done"]
    groups = [rows[start : start + per_file] for start in range(0, len(rows), per_file)]
    files = [NAME.format(number) for number in range(len(groups))]
    for file, group in zip(files, groups, strict=True):
        storage.write(file, _pack(storage, group))
    for file in storage.names(FOLDER):
        if NUMBERED.fullmatch(file) and file not in files:
            storage.remove(file)
    return len(groups)


def _pack(storage: Storage, rows: list[dict[str, Any]]) -> bytes:
    """Return the bytes of a tar file, which are equal for equal clips."""
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for row in rows:
            # Remove columns that differ from run to run.
            constant = {k: v for k, v in row.items() if not k.startswith(("seconds.", "written"))}
            clip = storage.read(f"{row['folder']}/clip.safetensors")
            for ending, content in (
                ("clip.safetensors", clip),
                ("json", json.dumps(constant, sort_keys=True).encode()),
            ):
                entry = tarfile.TarInfo(f"{row['key']}.{ending}")
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))
    return written.getvalue()
