"""Imports packages without the parts that only their documentation and their tests need.

SciPy formats the docstrings of its functions while it is imported, and its copy of NumPy's names
imports NumPy's test helpers and Fortran wrapper. typeguard, which tyro uses, imports `unittest` for
one class, and thereby the event loop and TLS. Without them the imports take two thirds of the time.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Lock
from types import ModuleType
from typing import Any

UNUSED = {"numpy.f2py": (), "numpy.testing": (), "unittest.mock": ("Mock", "patch")}
"""Modules that are not imported, with the classes that their importers need."""
SCIPY = ("scipy.ndimage", "scipy.sparse.linalg", "scipy.spatial", "scipy.fft")
"""Modules of SciPy that a run uses."""
_lock = Lock()


class PlainDocs(defaultdict[str, list[Any]]):
    """Sections of a docstring, without parsing; changes to them are ignored."""

    def __init__(self, function: object) -> None:
        super().__init__(list)
        self._text = getattr(function, "__doc__", None) or ""

    def __str__(self) -> str:
        return f"\n{self._text}"  # callers drop the first line, which is the signature


def import_lightly(*names: str) -> None:
    """Import modules, with empty modules in place of those that they do not need."""
    with _lock:
        missing = [name for name in names if name not in sys.modules]
        if missing:
            with _stand_ins(), _plain_docs(missing):
                for name in missing:
                    import_module(name)


@contextmanager
def _stand_ins() -> Iterator[None]:
    """Within this context, modules that are not imported yet are empty if nothing needs them."""
    added: list[tuple[str, ModuleType | None]] = []
    for name, classes in UNUSED.items():
        package, _, last = name.rpartition(".")
        if name in sys.modules:
            continue
        module = sys.modules[name] = ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (), {}))
        parent = sys.modules.get(package)
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
    """Within this context, SciPy leaves docstrings as they are."""
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
