"""Pyright is told nothing of diffusers, whose source takes it long to read."""

from typing import Any

def __getattr__(name: str) -> Any: ...
