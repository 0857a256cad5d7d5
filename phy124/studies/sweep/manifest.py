"""Writes and reads the manifest of a sweep, which has one row per clip.

While a sweep runs, each row is a small file. At the end, the rows become a Parquet table. The table
is assembled from columns, because rows of Python objects would need ten times as much memory.
"""

import io
import json
from collections.abc import Iterator
from itertools import islice
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from phy124.errors import InputError
from phy124.runtime.installation import install_command
from phy124.studies.sweep.keys import Seen
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import FAILED, Row

MANIFEST = "manifest.parquet"
BATCH = 2048
"""Number of rows that are read before they are converted to columns."""
FOLDERS = [f"rows/{digit:x}" for digit in range(16)]
"""Folders of the row files, one for each first digit of the keys."""


def keys_in(storage: Storage) -> Iterator[str]:
    """Yield the keys of finished clips."""
    return (_key(name) for name in _names(storage) if not name.endswith(FAILED))


def sweep_rows(storage: Storage) -> None:
    """Remove incomplete files of killed processes from the sweep's folders."""
    for folder in ("", *FOLDERS):
        storage.sweep(folder)


def flat(row: Row) -> Row:
    """Flatten a row: each value in `set` and each time in `seconds` becomes a column."""
    plain = {key: value for key, value in row.items() if key not in ("set", "seconds")}
    set_ = {f"set.{path}": _cell(value) for path, value in row.get("set", {}).items()}
    seconds = {f"seconds.{stage}": value for stage, value in row.get("seconds", {}).items()}
    return {**plain, **set_, **seconds}


def write_manifest(storage: Storage) -> int:
    """Write the table of all clips in the order of their indices; return their number.

    If a clip has several rows, the table contains only the newest row. A new row is written if the
    picture or the code has changed.
    """
    arrow, parquet = load_arrow()
    tables = list(_tables(storage, arrow))
    if not tables:
        return 0
    whole = arrow.concat_tables(_alike(tables, arrow), promote_options="permissive")
    whole = whole.take(_last(whole))
    written = io.BytesIO()
    parquet.write_table(whole, written)
    storage.write(MANIFEST, written.getvalue())
    return len(whole)


def read_manifest(storage: Storage) -> list[Row]:
    """Read the rows of the manifest.

    Raises:
        InputError: The folder does not contain a table.
    """
    table = _read(storage)
    if table is None:
        limit = "the folder contains no results of a sweep."
        raise InputError(
            "folder",
            storage.address,
            limit,
            "Give the folder to which a sweep wrote its results (its --out).",
        )
    return table.to_pylist()


def _tables(storage: Storage, arrow: Any) -> Iterator[Any]:
    known = Seen()
    if (table := _read(storage)) is not None:
        there, rows = Seen(keys_in(storage)), table.select(["key", "status"]).to_pylist()
        # A clip that failed earlier may have succeeded since then.
        table = table.filter([r["status"] != "failed" and r["key"] in there for r in rows])
        known = Seen(table["key"].to_pylist())
        yield table
    new = (name for name in _names(storage) if name.endswith(FAILED) or _key(name) not in known)
    while rows := [flat(json.loads(storage.read(name))) for name in islice(new, BATCH)]:
        columns = dict.fromkeys(key for row in rows for key in row)
        yield arrow.table({name: _column([row.get(name) for row in rows]) for name in columns})


def _alike(tables: list[Any], arrow: Any) -> list[Any]:
    kinds: dict[str, set[bool]] = {}
    for field in (field for table in tables for field in table.schema):
        if field.type != arrow.null():
            kinds.setdefault(field.name, set()).add(field.type == arrow.string())
    mixed = {name for name, is_text in kinds.items() if len(is_text) > 1}

    def convert(field: Any) -> Any:
        return field.with_type(arrow.string()) if field.name in mixed else field

    return [table.cast(arrow.schema(map(convert, table.schema))) for table in tables]


def _last(table: Any) -> Any:
    asked = table["asked"].to_numpy().astype("S")
    order = np.lexsort((table["written"].to_numpy(), asked))
    newest = np.append(asked[order][1:] != asked[order][:-1], True)
    places = order[newest]
    return places[np.argsort(table["index"].to_numpy()[places], kind="stable")]


def _names(storage: Storage) -> Iterator[str]:
    return (name for folder in FOLDERS for name in storage.names(folder))


def _key(name: str) -> str:
    return PurePosixPath(name).name.partition(".")[0]


def _read(storage: Storage) -> Any:
    try:
        written = storage.read(MANIFEST)
    except FileNotFoundError:
        return None
    _, parquet = load_arrow()
    return parquet.read_table(io.BytesIO(written))


def _cell(value: object) -> object:
    return json.dumps(value) if isinstance(value, (list, tuple, dict)) else value


def _column(values: list[object]) -> list[object]:
    """Convert mixed types in a column to floats if all values are numbers, otherwise to text."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    kind = float if kinds == {int, float} else str
    return [None if value is None else kind(str(value)) for value in values]


def load_arrow() -> tuple[Any, Any]:
    """Import pyarrow and pyarrow.parquet.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        limit = "tables need the package pyarrow, which is not installed."
        raise InputError("sweep", MANIFEST, limit, f"Run `{install_command('sweep')}`.") from error
    return pyarrow, parquet
