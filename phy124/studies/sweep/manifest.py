"""Writes and reads the manifest of a sweep, which has one row per clip.

While a sweep runs, each row is a small file. At the end, the rows become a Parquet table. The table
is assembled from columns, because rows of Python objects would need ten times as much memory.
"""

import io
import json
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.runtime.installation import needs_extra
from phy124.studies.sweep.keys import Seen
from phy124.studies.sweep.plan import Item
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import MADE, RETRY, Row, settings_of

MANIFEST = "manifest.parquet"
BATCH = 2048
"""Number of rows that are read before they are converted to columns."""
FOLDERS = [f"rows/{digit:x}" for digit in range(16)]
"""Folders of the row files, one for each first digit of the keys."""


def keys_in(storage: Storage) -> Iterator[str]:
    """Yield the keys of finished clips."""
    return (_key(name) for name in _names(storage) if not name.endswith(RETRY))


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


def write_manifest(storage: Storage, clips: Iterable[tuple[str, Item]]) -> int:
    """Write the table of a plan's finished clips in the order of the plan; return their number.

    The settings of a clip are those of the plan, even if another plan made the clip.

    Args:
        storage: The sweep's storage, which may also contain clips of other plans.
        clips: Key and settings of each clip of the plan. Clips with the same key are listed once.
    """
    arrow, parquet = load_arrow()
    keys = Seen()
    settings = list(_settings(storage, clips, keys, arrow))
    results = list(_results(storage, keys, arrow))
    if results:
        plan, made = _combine(settings, arrow), _combine(results, arrow)
        made = made.take(_newest(made, plan["key"].to_numpy().astype("S")))
        for name in made.column_names:
            if name not in plan.column_names:
                plan = plan.append_column(name, made[name])
    elif (other := _read(storage)) is not None:
        plan = other.slice(0, 0)  # all clips are those of another plan
    else:
        return 0
    written = io.BytesIO()
    parquet.write_table(plan, written)
    storage.write(MANIFEST, written.getvalue())
    return len(plan)


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


def _settings(
    storage: Storage, clips: Iterable[tuple[str, Item]], keys: Seen, arrow: Any
) -> Iterator[Any]:
    """Yield tables of the settings of a plan's finished clips, and add their keys to `keys`."""
    there = Seen(map(_key, _names(storage)))

    def rows() -> Iterator[Row]:
        for key, item in clips:
            if key in there and key not in keys:
                keys.add(key)
                yield {"key": key, **settings_of(item)}

    return _tables(rows(), arrow)


def _results(storage: Storage, keys: Seen, arrow: Any) -> Iterator[Any]:
    """Yield tables of the results of the clips with these keys, without their settings."""
    known = Seen()
    if (table := _read(storage)) is not None:
        there, rows = Seen(keys_in(storage)), table.select(["key", "status"]).to_pylist()
        # The rows of all other clips are read again.
        kept = [r["status"] in MADE and r["key"] in there and r["key"] in keys for r in rows]
        results = [name for name in table.column_names if not _is_setting(name)]
        table = table.select(results).filter(kept)
        known = Seen(table["key"].to_pylist())
        if len(table):
            yield table
    new = (
        name
        for name in _names(storage)
        if _key(name) in keys and (name.endswith(RETRY) or _key(name) not in known)
    )
    rows = (json.loads(storage.read(name)) for name in new)
    yield from _tables(
        ({n: v for n, v in row.items() if not _is_setting(n)} for row in rows), arrow
    )


def _is_setting(name: str) -> bool:
    return name in ("index", "picture", "generator", "set") or name.startswith("set.")


def _tables(rows: Iterator[Row], arrow: Any) -> Iterator[Any]:
    while batch := [flat(row) for row in islice(rows, BATCH)]:
        columns = dict.fromkeys(key for row in batch for key in row)
        yield arrow.table({name: _column([row.get(name) for row in batch]) for name in columns})


def _combine(tables: list[Any], arrow: Any) -> Any:
    return arrow.concat_tables(_alike(tables, arrow), promote_options="permissive")


def _alike(tables: list[Any], arrow: Any) -> list[Any]:
    kinds: dict[str, set[bool]] = {}
    for field in (field for table in tables for field in table.schema):
        if field.type != arrow.null():
            kinds.setdefault(field.name, set()).add(field.type == arrow.string())
    mixed = {name for name, is_text in kinds.items() if len(is_text) > 1}

    def convert(field: Any) -> Any:
        return field.with_type(arrow.string()) if field.name in mixed else field

    return [table.cast(arrow.schema(map(convert, table.schema))) for table in tables]


def _newest(table: Any, keys: NDArray) -> NDArray:
    """Return the index of each key's newest row in a table that contains all keys."""
    rows = table["key"].to_numpy().astype("S")
    order = np.lexsort((table["written"].to_numpy(), rows))
    return order[np.searchsorted(rows[order], keys, side="right") - 1]


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
    limit = "tables need the package pyarrow, which is not installed."
    with needs_extra("sweep", "sweep", MANIFEST, limit):
        import pyarrow
        from pyarrow import parquet
    return pyarrow, parquet
