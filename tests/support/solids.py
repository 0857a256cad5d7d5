"""Solids of large voxels, which are found quickly."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from phy124.particles import solid

COARSE: dict[bytes, Any] = {}
"""The solids of `coarse`, as phy124.particles.solid keeps its own."""


@contextmanager
def coarse() -> Iterator[None]:
    """Find solids of an eighth of the voxels, which takes an eighth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solid, "ACROSS", solid.ACROSS // 2)
        patch.setattr(solid, "_kept", COARSE)
        yield
