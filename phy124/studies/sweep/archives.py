"""Packs the clips of a sweep into tar files, as WebDataset reads them."""

from __future__ import annotations

import io
import json
import tarfile
from typing import Any

from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage

NAME = "archives/{:06d}.tar"
"""Name of a tar file by its number."""


def pack(storage: Storage, per_file: int) -> int:
    """Write tar files of so many clips each, in the order of their numbers; returns how many.

    Each clip is KEY.clip.safetensors and KEY.json, its row.
    """
    rows = [row for row in read_manifest(storage) if row["status"] == "done"]
    groups = [rows[start : start + per_file] for start in range(0, len(rows), per_file)]
    for number, group in enumerate(groups):
        storage.write(NAME.format(number), _packed(storage, group))
    return len(groups)


def _packed(storage: Storage, rows: list[dict[str, Any]]) -> bytes:
    """One tar file; equal clips give equal bytes."""
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for row in rows:
            # What differs from run to run stays outside.
            told = {k: v for k, v in row.items() if not k.startswith(("seconds.", "written"))}
            clip = storage.read(f"{row['folder']}/clip.safetensors")
            for ending, content in (
                ("clip.safetensors", clip),
                ("json", json.dumps(told, sort_keys=True).encode()),
            ):
                entry = tarfile.TarInfo(f"{row['key']}.{ending}")
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))
    return written.getvalue()
