"""The programs in tests/benchmarks run as `python tests/benchmarks/NAME.py`."""

import ast

import pytest

from support.pages import ROOT

PROGRAMS = sorted((ROOT / "tests/benchmarks").rglob("*.py"))
OURS = ("support", "reference")
"""Folders of tests/ that no installation has."""
PATHS = {depth: f"sys.path.insert(0, str(Path(__file__).parents[{depth}]))" for depth in (1, 2)}
"""Levels up to tests/ -> expression that names the folder."""


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.stem)
def test_a_program_finds_what_the_tests_share(program):
    body = ast.parse(program.read_text("utf-8")).body
    imports = [n for n in body if isinstance(n, ast.ImportFrom) and n.module]
    ours = [n.lineno for n in imports if n.module.partition(".")[0] in OURS]
    path = PATHS[len(program.relative_to(ROOT / "tests").parts) - 1]
    result = [n.lineno for n in body if ast.unparse(n) == path]
    assert not ours or (result and result[0] < ours[0]), f"before the import: {path}"
