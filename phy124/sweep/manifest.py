"""The manifest: a row per clip, one small file each while a sweep runs, then one Parquet table."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

from phy124.errors import InputError
from phy124.runtime.installation import install_command
from phy124.sweep.storage import Storage
from phy124.sweep.work import FINAL, Row

MANIFEST = "manifest.parquet"
"""Name of the table."""


def rows_in(storage: Storage) -> Iterator[Row]:
    """All rows as columns, in the order of their keys; final ones are taken from the table."""
    known = {row["key"]: row for row in _table(storage) if row["status"] in FINAL}
    for name in storage.names("rows"):
        row = known.get(PurePosixPath(name).stem)
        yield row or flat(json.loads(storage.read(name)))


def keys_in(storage: Storage) -> set[str]:
    """Keys of the clips that need not be made again."""
    return {row["key"] for row in rows_in(storage) if row["status"] in FINAL}


def flat(row: Row) -> Row:
    """A row as columns: what was set and the seconds of each stage have a column each."""
    plain = {key: value for key, value in row.items() if key not in ("set", "seconds")}
    set_ = {f"set.{path}": _cell(value) for path, value in row.get("set", {}).items()}
    seconds = {f"seconds.{stage}": value for stage, value in row.get("seconds", {}).items()}
    return {**plain, **set_, **seconds}


def write_manifest(storage: Storage) -> int:
    """Write the table of all clips there are, in the order of their numbers; returns how many.

    Of a clip that was made again, by another version or from a mended picture, the last row counts.
    """
    last: dict[Any, Row] = {}
    for row in sorted(rows_in(storage), key=lambda row: row["written"]):
        last[_clip(row)] = row
    rows = sorted(last.values(), key=lambda row: row["index"])
    if rows:
        arrow, parquet = _arrow()
        columns = dict.fromkeys(key for row in rows for key in row)
        table = arrow.table({name: _column([row.get(name) for row in rows]) for name in columns})
        written = io.BytesIO()
        parquet.write_table(table, written)
        storage.write(MANIFEST, written.getvalue())
    return len(rows)


def _clip(row: Row) -> tuple[Any, ...]:
    """Which clip a row is of: what the sweep asked for, whatever determines it besides."""
    asked = sorted((k, v) for k, v in row.items() if k.startswith("set.") and v is not None)
    return row["picture"], row["generator"], tuple(asked)


def read_manifest(storage: Storage) -> list[Row]:
    """The rows of the table.

    Raises:
        InputError: There is none.
    """
    rows = _table(storage)
    if not rows:
        limit = "it holds no results of a sweep."
        raise InputError("folder", storage.address, limit, "Give the --out of a sweep.")
    return rows


def _table(storage: Storage) -> list[Row]:
    """The rows of the table; none without one."""
    _, parquet = _arrow()
    try:
        content = storage.read(MANIFEST)
    except FileNotFoundError:
        return []
    return parquet.read_table(io.BytesIO(content)).to_pylist()


def _cell(value: object) -> object:
    """A value as a table can hold it: vectors and sections as JSON."""
    return json.dumps(value) if isinstance(value, (list, tuple, dict)) else value


def _column(values: list[object]) -> list[object]:
    """One column, all of one type: text if its values differ in kind."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    kind = float if kinds == {int, float} else str
    return [None if value is None else kind(str(value)) for value in values]


def _arrow() -> tuple[Any, Any]:
    """pyarrow and its Parquet.

    Raises:
        InputError: It is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        limit = "tables need the package pyarrow, which is not installed."
        raise InputError("sweep", MANIFEST, limit, f"Run `{install_command('sweep')}`.") from error
    return pyarrow, parquet
