"""Skips test files whose packages are missing when only the GPU tests are run."""

from collections.abc import Iterable

import pytest

OURS = {"phy124", "demo", "bridge", "reference", "support", "conftest"}
"""Packages of the checkout; it is an error if they are missing."""


class GpuModule(pytest.Module):
    """A test file that is skipped if a package that it imports is not installed."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        """Return the tests of the file."""
        try:
            return super().collect()
        except self.CollectError as error:
            absent = getattr(error.__cause__, "name", None)
            if not isinstance(error.__cause__, ModuleNotFoundError) or not absent:
                raise
            package = absent.partition(".")[0]
            if package in OURS or package.startswith("test_"):
                raise
            pytest.skip(f"{package} is not installed", allow_module_level=True)
