"""The parameters of all kernels come in the order that `phy124.kernels` describes."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import phy124.kernels

HEADINGS = ("model", "state in", "in place", "out")
WRITTEN = HEADINGS[2:]
STATE = {"x", "v", "C", "F", "history", "total", "residue", "grid", "position", "deformation"}
"""Names of what changes in a run, wherever it appears."""
FOLDER = Path(phy124.kernels.__file__).parent


class Parameter(NamedTuple):
    name: str
    heading: str
    array: bool


class Kernel(NamedTuple):
    where: str
    headings: list[str]
    parameters: list[Parameter]
    node: ast.FunctionDef


def kernels(source: str, where: str) -> Iterator[Kernel]:
    """The kernels of a file with the headings among their parameters."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef) or not is_kernel(node):
            continue
        headings = {
            number: lines[number - 1].strip("# ").partition(":")[0]
            for number in range(node.lineno, node.body[0].lineno)
            if lines[number - 1].strip().startswith("#")
        }
        parameters = [
            Parameter(
                one.arg,
                next((headings[n] for n in sorted(headings, reverse=True) if n < one.lineno), ""),
                "array" in ast.unparse(one.annotation),
            )
            for one in node.args.args
        ]
        yield Kernel(f"{where} {node.name}", [*headings.values()], parameters, node)


def is_kernel(node: ast.FunctionDef) -> bool:
    makers = ("kernel(", "native_kernel(", "wp.kernel")
    return any(ast.unparse(d).startswith(makers) for d in node.decorator_list)


def written(node: ast.FunctionDef) -> set[str]:
    """Names of arrays that a kernel assigns to or changes atomically."""
    found = set()
    for one in ast.walk(node):
        targets = one.targets if isinstance(one, ast.Assign) else []
        targets = [one.target] if isinstance(one, ast.AugAssign) else targets
        found |= {ast.unparse(t.value) for t in targets if isinstance(t, ast.Subscript)}
        if isinstance(one, ast.Call) and ast.unparse(one.func).startswith("wp.atomic_"):
            found.add(ast.unparse(one.args[0]))
    return found


def problems(kernel: Kernel) -> list[str]:
    """What is not as `phy124.kernels` says."""
    found, parameters = [], kernel.parameters
    if kernel.headings != [heading for heading in HEADINGS if heading in kernel.headings]:
        found.append(f"headings {kernel.headings}")
    for name, heading, array in parameters:
        if heading not in HEADINGS:
            found.append(f"{name} has no heading")
        if name.endswith("_out") != (heading in WRITTEN):
            found.append(f"{name} is under '{heading}'")
        if heading != "model" and not array:
            found.append(f"{name} is a number and not under 'model'")
        if heading == "model" and name in STATE:
            found.append(f"{name} is of the state and under 'model'")
    arrays = {p.name for p in parameters if p.array}
    found += [f"{n} is written" for n in written(kernel.node) & arrays if not n.endswith("_out")]
    return found


@pytest.mark.parametrize("path", sorted(FOLDER.rglob("*.py")), ids=lambda path: path.stem)
def test_parameters_come_in_one_order(path):
    found = {
        kernel.where: problems(kernel) for kernel in kernels(path.read_text("utf-8"), path.name)
    }
    assert not {where: said for where, said in found.items() if said}


def test_all_kernels_are_looked_at():
    paths = FOLDER.rglob("*.py")
    assert sum(len([*kernels(path.read_text("utf-8"), path.name)]) for path in paths) >= 38


GOOD = """
@kernel("good")
def good(
    # model
    dx: float,
    # state in
    x: wp.array(dtype=float),
    # in place: what was before becomes what is
    v_out: wp.array(dtype=float),
):
    v_out[0] += dx * x[0]
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("v_out", "v", "v is under 'in place'"),
        ("dx: float,\n", "dx: float, x_out: wp.array(dtype=float),\n", "x_out is under 'model'"),
        ("# state in", "# out", "headings"),
        ("    # model\n", "", "dx has no heading"),
        ("    # state in\n", "", "x is of the state and under 'model'"),
        ("x: wp", "dt: float, x: wp", "dt is a number and not under 'model'"),
        ("v_out[0] +=", "x[0] =", "x is written"),
    ],
)
def test_what_is_out_of_order_is_noticed(old, new, said):
    (kernel,) = kernels(GOOD, "here")
    assert not problems(kernel)
    (kernel,) = kernels(GOOD.replace(old, new), "here")
    assert any(said in problem for problem in problems(kernel)), problems(kernel)
