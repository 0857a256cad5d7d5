"""Pyright knows nothing of transformers: reading it takes as long as reading all of phy124."""

from typing import Any

def __getattr__(name: str) -> Any: ...
