"""Docstrings of public functions name their arguments and the errors a user may meet."""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = sorted(
    path.relative_to(ROOT).as_posix()
    for package in ("phy124", "demo", "bridge")
    for path in (ROOT / package).glob("[!_]*")
    if path.suffix == ".py" or any(path.rglob("*.py"))
)
"""Folders and files right under the three packages."""
MANY = 4
"""Parameters from which each must be explained."""


class Function(NamedTuple):
    """One that others may call."""

    name: str
    node: ast.FunctionDef

    @property
    def docstring(self) -> str:
        return ast.get_docstring(self.node) or ""

    @property
    def parameters(self) -> list[str]:
        inputs = self.node.args
        named = [*inputs.posonlyargs, *inputs.args, *inputs.kwonlyargs]
        rest = [item for item in (inputs.vararg, inputs.kwarg) if item is not None]
        return [item.arg for item in [*named, *rest] if item.arg not in ("self", "cls")]

    def section(self, title: str) -> str:
        match = re.search(rf"^{title}:\n((?:    .*\n?|\n)+)", self.docstring, re.M)
        return match[1] if match else ""


@cache
def functions(room: str) -> list[Function]:
    """Public functions and methods of a folder or file, none of private classes."""
    results = []
    at = ROOT / room
    for path in sorted(at.rglob("*.py")) if at.is_dir() else [at]:
        module = ast.parse(path.read_text("utf-8"))
        for owner in [module, *(n for n in module.body if isinstance(n, ast.ClassDef))]:
            if isinstance(owner, ast.ClassDef) and owner.name.startswith("_"):
                continue
            for node in owner.body:
                if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                    if on_device(node):
                        continue
                    results.append(Function(f"{path.stem}.{node.name}", node))
    return results


def on_device(node: ast.FunctionDef) -> bool:
    """Whether it is device code: headings and kernels/transfer.py explain its parameters once."""
    return any(
        re.match(r"(wp\.|(native_)?kernel\()", ast.unparse(item)) for item in node.decorator_list
    )


def refuses(function: Function) -> bool:
    """Whether it raises InputError itself."""
    raised = [node.exc for node in ast.walk(function.node) if isinstance(node, ast.Raise)]
    return any(exc is not None and "InputError" in ast.dump(exc) for exc in raised)


@pytest.mark.parametrize("room", ROOMS)
def test_many_arguments_are_explained(room):
    for function in functions(room):
        explained = re.findall(r"^    \*{0,2}(\w+):", function.section("Args"), re.M)
        if explained or len(function.parameters) >= MANY:
            assert explained == function.parameters, function.name


@pytest.mark.parametrize("room", ROOMS)
def test_raised_errors_are_documented(room):
    for function in functions(room):
        if refuses(function):
            assert "InputError:" in function.section("Raises"), function.name
        assert "Raises InputError" not in function.docstring, f"{function.name}: a section of it"
