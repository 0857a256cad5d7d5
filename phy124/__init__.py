"""phy124: one photograph in, a physically moving 3D object out."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phy124.clip import Clip
    from phy124.errors import Cancelled, InputError
    from phy124.gaussians import Frame, Gaussians
    from phy124.rendering.camera import Camera

__version__ = "0.1.0"
__all__ = ["Camera", "Cancelled", "Clip", "Frame", "Gaussians", "InputError"]
_HOMES = {
    "Camera": "rendering.camera",
    "Clip": "clip",
    "Cancelled": "errors",
    "InputError": "errors",
    "Frame": "gaussians",
    "Gaussians": "gaussians",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for, so that the package itself is light."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
