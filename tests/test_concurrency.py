"""Kernels as a GPU runs them: no two threads of a launch race, and their order does not matter.

The slow tests compile every kernel a second time, with notes of what it reads and writes
(tests/races), and take some minutes.
"""

import ast
import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from races.conflicts import conflicts
from races.parts import by_parts
from races.record import ATOMIC, ENTRY, READ, WRITE, unusable
from support.pages import ROOT
from support.processes import run_program

GROUPS = (*("laws", "walls", "forces", "monitors", "pictures", "presets"), *("lattices", "liquids"))
KERNELS = ROOT / "phy124/kernels"
EXTREMES = ("maxima_out", "fastest_out", "range_out", "low_out", "high_out")
HARMLESS = {f"read-atomic {array}" for array in EXTREMES}
"""Allowed races: a value is compared with a maximum before the maximum is raised atomically."""
MASSES = {
    *(f"phy124_pair_float32/pair: read-write {nodes}" for nodes in ("first_out", "second_out")),
    *(
        f"phy124_contact_half_space_{response}_float32/contact: read-write grid_out"
        for response in ("held", "separate", "slip", "sticky")
    ),
}
"""So may this: of the nodes around it a thread reads the masses alone, and those that write the
velocities of these nodes leave their masses as they are, to the last bit."""
ALONE = {
    "phy124_deform_simd/deform_shapes_simd": "rows for the vector units of a CPU",
    "phy124_project_simd/project_simd": "likewise",
    "phy124_lattice_flag_simd/flag_simd": "likewise",
}
"""Kernels that are not looked at, and why they need not be."""
TOLERANCE = 5e-4
"""Largest distance between clips of a body of 1 m whose threads came in different orders [m]. Most
differ by 1e-7; by 2.7e-4 where sand reaches the floor and rounding decides in which substep: of
twelve orders seven give the one clip, five the other."""

needs_memory = pytest.mark.skipif(unusable() is not None, reason=str(unusable()))


def asked(what: str, group: str, cache: Path) -> dict[str, Any]:
    """Return the results of a separate process, whose kernels differ from those of this process."""
    command = [sys.executable, "-m", "races", what, group, str(cache)]
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    environment = {**os.environ, "PYTHONPATH": paths}
    done = run_program(command, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("kernels with notes")


@pytest.fixture(scope="module")
def races(cache):
    """Return the results of a group of runs; each group runs once."""
    known: dict[str, dict[str, Any]] = {}

    def of(group: str) -> dict[str, Any]:
        if group not in known:
            known[group] = asked("races", group, cache)
        return known[group]

    return of


@pytest.mark.slow
@needs_memory
def test_races_that_are_there_are_found(races):
    raced = {name.partition("/")[2]: what for name, what in races("controls")["raced"].items()}
    assert {name: list(what) for name, what in raced.items()} == {
        "write_write": ["write-write values_out"],
        "read_write": ["read-write values_out"],
        "write_atomic": ["write-atomic values_out"],
        "read_atomic": ["read-atomic values_out"],
        "mass_and_momentum": ["read-atomic nodes_out"],
    }
    assert raced["write_write"]["write-write values_out"] == {"write_write": 32}
    assert raced["read_write"]["read-write values_out"] == {"read_write": 64}


@pytest.mark.slow
@needs_memory
@pytest.mark.parametrize("group", GROUPS)
def test_no_two_threads_of_a_launch_race(group, races):
    raced = {
        f"{kernel}: {what}": runs
        for kernel, result in races(group)["raced"].items()
        for what, runs in result.items()
        if what not in HARMLESS
    }
    assert raced.keys() <= MASSES, raced


@pytest.mark.slow
@needs_memory
def test_every_kernel_was_looked_at(races):
    seen = {name for group in GROUPS for name in races(group)["seen"]}
    assert {k for k in kernels() if not any(re.fullmatch(k, name) for name in seen)} == set(ALONE)


@pytest.mark.slow
@needs_memory
@pytest.mark.parametrize("group", ["presets", "laws", "solids", "lattices", "liquids"])
def test_the_order_of_threads_does_not_matter(group, cache):
    apart = asked("order", group, cache)
    assert max(map(max, apart.values())) > 0, "other orders round differently"
    assert {name: results for name, results in apart.items() if max(results) > TOLERANCE} == {}


def kernels() -> list[str]:
    """Patterns of the names of all kernels of several threads, such as "phy124_carry_.*/carry",
    from the source. The other kernels do not ask which thread runs them."""
    return [
        f"{_pattern(decorator.args[0])}/{node.name}"
        for path in KERNELS.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef) and "wp.tid()" in ast.unparse(node)
        for decorator in node.decorator_list
        if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "kernel"
    ]


def _pattern(module: ast.expr) -> str:
    """A regular expression for the name of a module."""
    parts = module.values if isinstance(module, ast.JoinedStr) else [module]
    return "".join(part.value if isinstance(part, ast.Constant) else ".*" for part in parts)


def noted(*accesses: tuple[int, int, int, int]) -> np.ndarray:
    """Accesses: address, thread, bytes and kind."""
    return np.array(list(accesses), ENTRY)


@pytest.mark.parametrize(
    ("first", "other", "result"),
    [
        ((0, 1, 4, WRITE), (0, 2, 4, WRITE), {"write-write a": 1}),
        ((0, 1, 16, WRITE), (8, 2, 8, READ), {"read-write a": 2}),
        ((0, 1, 4, WRITE), (0, 2, 4, ATOMIC), {"write-atomic a": 1}),
        ((0, 1, 4, READ), (0, 2, 4, ATOMIC), {"read-atomic a": 1}),
        ((0, 1, 4, READ), (0, 2, 4, READ), {}),
        ((0, 1, 4, ATOMIC), (0, 2, 4, ATOMIC), {}),
        ((0, 1, 4, WRITE), (0, 1, 4, READ), {}),
        ((0, 1, 4, WRITE), (4, 2, 4, WRITE), {}),
        ((0, 1, 1, WRITE), (1, 2, 1, WRITE), {}),
        ((64, 1, 4, WRITE), (64, 2, 4, WRITE), {}),  # in no array: memory of one thread
    ],
)
def test_which_accesses_of_two_threads_race(first, other, result):
    assert conflicts(noted(first, other), {"a": (0, 32)}) == result
    assert conflicts(noted(other, first), {"a": (0, 32)}) == result


TEXT = """
static bool f(wp::vec_t<4, wp::float32>* var_1)
{
    wp::vec_t<4, wp::float32> var_2;
    wp::vec_t<4, wp::float32> var_3;
    const wp::int32 var_4 = 3;
    var_3 = wp::load(var_1);
    var_2 = wp::copy(var_3);
    var_5 = wp::extract(var_2, var_4);
}
"""


def test_only_components_that_are_used_count_as_read():
    assert "var_3 = wp::load_parts(var_1, 8u);" in by_parts(TEXT)
    whole = TEXT.replace("}\n", "    var_6 = wp::add(var_2, var_2);\n}\n")
    assert by_parts(whole) == whole
    unknown = TEXT.replace("const wp::int32 var_4 = 3;", "wp::int32 var_4;")
    assert by_parts(unknown) == unknown
