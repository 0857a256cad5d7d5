"""The programs in tests/benchmarks run as `python tests/benchmarks/NAME.py`."""

import ast
import sys

import pytest

import phy124
from support.pages import ROOT
from support.processes import run_program

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


IMPORT = """
import runpy, sys
sys.path.insert(0, sys.argv[1])
for program in sys.argv[2:]:
    try:
        runpy.run_path(program, run_name="imported")
    except ImportError as error:
        print(f"{program}: {error}")
"""


def names_in(module: str) -> set[str]:
    """Return the names that a module of ours has after its import, read from its source."""
    paths = [root / module.replace(".", "/") for root in (ROOT, ROOT / "tests")]
    (path,) = (
        p for p in [*paths, *(p / "__init__" for p in paths)] if p.with_suffix(".py").is_file()
    )
    nodes = list(ast.walk(ast.parse(path.with_suffix(".py").read_text("utf-8"))))
    names = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    names |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    names |= {n.asname or n.name for n in nodes if isinstance(n, ast.alias)}
    files = path.parent.iterdir() if path.stem == "__init__" else ()
    return names | {file.stem for file in files}


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.stem)
def test_names_of_ours_that_a_program_imports_exist(program):
    """Without the imports, which take long."""
    for node in ast.walk(ast.parse(program.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            first, _, rest = node.module.partition(".")
            names = {alias.name for alias in node.names}
            if first == "phy124" and not rest:
                names -= set(phy124.__all__)
            if first in (*OURS, "phy124", "demo", "bridge"):
                assert names <= names_in(node.module), node.module


@pytest.mark.slow
@pytest.mark.parametrize("folder", sorted({path.parent for path in PROGRAMS}), ids=lambda f: f.name)
def test_every_name_that_a_program_imports_exists(folder):
    """Programs that nobody runs for a while break by renamings."""
    programs = map(str, sorted(folder.glob("*.py")))
    command = [sys.executable, "-W", "ignore", "-c", IMPORT, str(folder), *programs]
    done = run_program(command, cwd=ROOT)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
