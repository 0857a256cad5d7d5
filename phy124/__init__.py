"""phy124: one photograph in, a physically moving 3D object out."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phy124.camera import Camera
    from phy124.clip import Clip
    from phy124.errors import Cancelled, InputError
    from phy124.gaussians import Frame, Gaussians

__version__ = "0.1.0"
__all__ = ["Camera", "Cancelled", "Clip", "Frame", "Gaussians", "InputError"]
HOMES = {
    "Camera": "phy124.camera",
    "Cancelled": "phy124.errors",
    "Clip": "phy124.clip",
    "Frame": "phy124.gaussians",
    "Gaussians": "phy124.gaussians",
    "InputError": "phy124.errors",
}
"""Module of each public name."""


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first asked for: `phy124.isolated` starts with nothing."""
    if name not in HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(HOMES[name]), name)
