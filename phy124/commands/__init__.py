"""Declares one class per command. The fields of a class are the command's options, and `run` does
the work. Modules are imported only when their command is run.
"""

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path

MODULES = {
    "generate": ("generate", "Generate"),
    "simulate": ("generate", "Simulate"),
    "cutout": ("cutout", "CutOut"),
    "orient": ("orient", "Orient"),
    "render": ("render", "Render"),
    "export": ("convert", "Export"),
    "convert": ("convert", "Convert"),
    "scenes": ("scenes", "Scenes"),
    "stress": ("validate", "Stress"),
    "effects": ("effects", "ShowEffects"),
    "accuracy": ("accuracy", "ShowAccuracy"),
    "validate": ("validate", "Validate"),
    "evaluate": ("evaluate", "Evaluate"),
    "compare": ("compare", "Compare"),
    "weights": ("weights", "Weights"),
    "sweep": ("sweep", "Sweep"),
    "fit": ("fit", "Fit"),
    "warm": ("effects", "Warm"),
    "doctor": ("doctor", "Doctor"),
}


class Commands(Mapping[str, type]):
    """Maps each command to its class, which is imported at the first access."""

    def __getitem__(self, name: str) -> type:
        module, kind = MODULES[name]
        return getattr(import_module(f"{__name__}.{module}"), kind)

    def __iter__(self) -> Iterator[str]:
        return iter(MODULES)

    def __len__(self) -> int:
        return len(MODULES)


COMMANDS = Commands()


def outline() -> dict[str, type]:
    """Return, for each command, a class that has only the command's docstring."""
    return {
        name: type(kind, (), {"__doc__": _docstrings(module)[kind]})
        for name, (module, kind) in MODULES.items()
    }


@cache
def _docstrings(module: str) -> dict[str, str | None]:
    """Read the docstrings without importing the module, because the import takes time."""
    code = Path(__file__).with_name(f"{module}.py").read_text("utf-8")
    classes = [node for node in ast.parse(code).body if isinstance(node, ast.ClassDef)]
    return {node.name: ast.get_docstring(node) for node in classes}
