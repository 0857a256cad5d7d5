"""Test files: none imports another; a run of the GPU tests skips those that lack a package."""

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
