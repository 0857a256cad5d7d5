"""How deep plain data may be nested: what reads it calls itself for each level."""

from __future__ import annotations

from typing import Any

from phy124.errors import InputError

DEEPEST = 32
"""Largest number of tables and lists within each other; a scene has eight."""


def check_depth(data: Any, field: str) -> None:
    """Check how deep plain data is nested.

    Args:
        data: Tables, lists and values.
        field: What an error calls them.

    Raises:
        InputError: It is nested too deep.
    """
    level = _inside([data])
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in _inside(outer)]
        if not level:
            return
    limit = f"it is nested more than {DEEPEST} deep."
    raise InputError(field, "nested data", limit, "Leave out what is no scene.")


def _inside(section: Any) -> list[Any]:
    """The tables and lists in one of them."""
    parts = section.values() if isinstance(section, dict) else section
    return [part for part in parts if isinstance(part, dict | list | tuple)]
