"""The arguments of all kernels come in the order that `phy124.kernels` describes."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import phy124.kernels

STATE = {"x", "v", "C", "F", "history", "total", "residue", "grid", "position", "deformation"}
"""Names of what changes in a run, wherever it appears."""
FOLDER = Path(phy124.kernels.__file__).parent


class Kernel(NamedTuple):
    where: str
    arguments: dict[str, str]
    """Name -> annotation in the signature, which may be empty."""
    node: ast.FunctionDef


def kernels(source: str, where: str) -> Iterator[Kernel]:
    """The kernels of a file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and is_kernel(node):
            types = {
                a.arg: ast.unparse(a.annotation) if a.annotation else "" for a in node.args.args
            }
            yield Kernel(f"{where} {node.name}", types, node)


def is_kernel(node: ast.FunctionDef) -> bool:
    makers = ("kernel(", "native_kernel(", "wp.kernel")
    return any(ast.unparse(d).startswith(makers) for d in node.decorator_list)


def written(node: ast.FunctionDef) -> set[str]:
    """Names of arrays that a kernel assigns to or changes atomically."""
    result = set()
    for item in ast.walk(node):
        targets = item.targets if isinstance(item, ast.Assign) else []
        targets = [item.target] if isinstance(item, ast.AugAssign) else targets
        result |= {ast.unparse(t.value) for t in targets if isinstance(t, ast.Subscript)}
        if isinstance(item, ast.Call) and ast.unparse(item.func).startswith("wp.atomic_"):
            result.add(ast.unparse(item.args[0]))
    return result


def rank(name: str, annotation: str) -> int | None:
    """0: a number of the model; 1: of the state; 2: written; None: an array of model or state."""
    if name.endswith("_out"):
        return 2
    if name in STATE:
        return 1
    return 0 if annotation in ("real", "int", "float", "wp.float64") else None


def problems(kernel: Kernel) -> list[str]:
    """Yield deviations from the order of arguments that `phy124.kernels` describes."""
    names = list(kernel.arguments)
    ranks = [rank(name, annotation) for name, annotation in kernel.arguments.items()]
    results = []
    for place, name in enumerate(names):
        before = max((r for r in ranks[:place] if r is not None), default=0)
        after = 1 if ranks[place] is None else ranks[place]
        if before > after:
            results.append(f"{name} is too late")
    arrays = {name for name, annotation in kernel.arguments.items() if "vec" not in annotation[:6]}
    results += [f"{n} is written" for n in written(kernel.node) & arrays if not n.endswith("_out")]
    return results


@pytest.mark.parametrize("path", sorted(FOLDER.rglob("*.py")), ids=lambda path: path.stem)
def test_arguments_come_in_one_order(path):
    results = {
        kernel.where: problems(kernel) for kernel in kernels(path.read_text("utf-8"), path.name)
    }
    assert not {where: reasons for where, reasons in results.items() if reasons}


def test_all_kernels_are_looked_at():
    paths = FOLDER.rglob("*.py")
    assert sum(len([*kernels(path.read_text("utf-8"), path.name)]) for path in paths) >= 38


GOOD = """
@kernel("good", wp.float32)
def good(dx: float, chosen, x, kept, v_out):
    v_out[0] += dx * x[0]
"""


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("dx: float, chosen, x,", "chosen, x, dx: float,", "dx is too late"),
        ("kept, v_out", "v_out, kept", "kept is too late"),
        ("x, kept, v_out", "kept, v_out, x", "x is too late"),
        ("v_out[0] +=", "x[0] =", "x is written"),
        ("v_out[0] +=", "wp.atomic_add(kept, 0, 1);", "kept is written"),
    ],
)
def test_arguments_out_of_order_are_noticed(old, new, reason):
    (kernel,) = kernels(GOOD, "here")
    assert not problems(kernel)
    (kernel,) = kernels(GOOD.replace(old, new), "here")
    assert any(reason in problem for problem in problems(kernel)), problems(kernel)
