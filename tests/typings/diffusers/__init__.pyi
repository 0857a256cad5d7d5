"""Nothing of diffusers is known to pyright: to read it takes as long as to read all of phy124."""

from typing import Any

def __getattr__(name: str) -> Any: ...
