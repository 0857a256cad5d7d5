"""Imports packages without the parts that only their documentation and tests need.

When SciPy is imported, it formats the docstrings of its functions. SciPy copies NumPy's names, and
thereby imports parts of NumPy that phy124 does not use. tyro uses typeguard. For a single class,
typeguard imports `unittest`, which imports the event loop and TLS. pydantic has 70 typed
dictionaries for its schemas, but only type checkers read these dictionaries. Without these parts,
the imports take half of the time.
"""

import sys
import typing
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Lock
from types import ModuleType
from typing import Any

UNUSED = {
    **{f"numpy.{name}": () for name in ("char", "ctypeslib", "f2py", "polynomial", "testing")},
    "unittest.mock": ("Mock", "patch"),
}
"""Modules that are not imported, each with the classes that other modules import from it."""
TYPED_ONLY = "pydantic_core.core_schema"
"""Name of the module with typed dictionaries that only type checkers read."""
SCIPY = ("scipy.ndimage", "scipy.sparse.linalg", "scipy.spatial", "scipy.fft")
"""SciPy's modules that a run uses."""
FILMING = ("scipy.fft", "scipy.special")
"""SciPy's modules that rendering a clip uses."""
_lock = Lock()


class PlainDict(dict[str, Any]):
    """Replacement for a typed dictionary: a dictionary type without fields."""

    def __init_subclass__(cls, **_: object) -> None:
        """Accept the options of a typed dictionary, and ignore the options."""


class PlainDocs(defaultdict[str, list[Any]]):
    """Replacement for SciPy's parsed docstring; keeps the text, and ignores changes of sections."""

    def __init__(self, function: object) -> None:
        super().__init__(list)
        self._text = getattr(function, "__doc__", None) or ""

    def __str__(self) -> str:
        return f"\n{self._text}"  # callers drop the first line, which is the signature


def import_lightly(*names: str) -> None:
    """Import modules, with empty modules in place of the modules in `UNUSED`."""
    with _lock:
        missing = [name for name in names if name not in sys.modules]
        if missing:
            with _stand_ins(), _plain_docs(missing), _plain_dicts(missing):
                for name in missing:
                    import_module(name)


@contextmanager
def _stand_ins() -> Iterator[None]:
    """Within this context, an empty module replaces each module in `UNUSED` that is not imported
    yet.
    """
    added: list[tuple[str, ModuleType | None]] = []
    for name, classes in UNUSED.items():
        package, _, last = name.rpartition(".")
        parent = sys.modules.get(package)
        if name in sys.modules or (parent is None and package == "numpy"):
            continue  # NumPy itself would not accept an empty module
        module = sys.modules[name] = ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (), {}))
        if parent is not None:
            setattr(parent, last, module)
        added.append((name, parent))
    try:
        yield
    finally:
        for name, parent in added:
            del sys.modules[name]
            if parent is not None:
                delattr(parent, name.rpartition(".")[2])


@contextmanager
def _plain_docs(names: list[str]) -> Iterator[None]:
    docs: Any = None
    if any(name.startswith("scipy") for name in names):
        with suppress(ImportError):
            docs = import_module("scipy._lib._docscrape")
    if docs is None:
        yield
        return
    usual = docs.FunctionDoc
    docs.FunctionDoc = PlainDocs
    try:
        yield
    finally:
        docs.FunctionDoc = usual


@contextmanager
def _plain_dicts(names: list[str]) -> Iterator[None]:
    """Within this context, import `TYPED_ONLY` without the fields of its dictionaries."""
    if TYPED_ONLY not in names:
        yield
        return
    homes: list[Any] = [typing, import_module("typing_extensions")]
    usual = [home.TypedDict for home in homes]
    for home in homes:
        home.TypedDict = PlainDict
    try:
        yield
    finally:
        for home, kind in zip(homes, usual, strict=True):
            home.TypedDict = kind
