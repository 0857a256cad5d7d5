"""Test files: imports, and small tolerances; GPU tests, which skip absent packages."""

import ast
import re
from pathlib import Path

import pytest

from support.gpu_module import GpuModule


@pytest.fixture
def module(request, tmp_path):
    """Return a function that collects a test file with one import statement."""

    def collect(statement: str) -> object:
        path = tmp_path / "test_of_a_package.py"
        path.write_text(statement)
        return GpuModule.from_parent(request.session, path=path).collect()

    return collect


def test_absent_package_skips_its_test_file(module):
    with pytest.raises(pytest.skip.Exception, match="absent_package is not installed"):
        module("from absent_package.part import thing")


def test_absent_module_of_the_checkout_is_an_error(module):
    with pytest.raises(GpuModule.CollectError, match=r"phy124\.absent"):
        module("import phy124.absent")


def test_no_test_file_imports_another():
    """Code that several tests need is in tests/support."""
    imports = re.compile(r"^\s*(?:from|import) test_\w+", re.MULTILINE)
    paths = Path(__file__).parent.rglob("*.py")
    named = {path.name: imports.findall(path.read_text()) for path in paths}
    assert not {name: lines for name, lines in named.items() if lines}


def test_no_test_file_imports_gradio(imported_by_collecting):
    """Every test process would import it, which takes seconds: the fixture `gradio` does it."""
    assert "gradio" not in imported_by_collecting


CLOSE = ("allclose", "isclose", "assert_allclose")
"""Functions that add a relative tolerance of 1e-5 or 1e-7 to `atol`, unless `rtol` is given."""


def hidden(text: str) -> list[int]:
    """Return the lines of calls whose `atol` is below 1e-7 and whose relative tolerance is not
    given."""
    lines = []
    for call in (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)):
        options = {option.arg: option.value for option in call.keywords}
        if "atol" in options and "rtol" not in options and ast.unparse(call.func).endswith(CLOSE):
            parts = (part for part in ast.walk(options["atol"]) if isinstance(part, ast.Constant))
            if any(isinstance(part.value, float) and part.value < 1e-7 for part in parts):
                lines.append(call.lineno)
    return lines


def test_small_tolerance_needs_a_relative_one():
    assert hidden("np.allclose(a, b, atol=1e-12 * abs(b).max())") == [1]
    assert not hidden("np.allclose(a, b, rtol=0, atol=1e-12)")
    texts = {path: path.read_text("utf-8") for path in Path(__file__).parent.rglob("*.py")}
    results = {path.name: hidden(text) for path, text in texts.items() if "atol=" in text}
    assert not {name: lines for name, lines in results.items() if lines}
