"""phy124: one photograph in, a physically moving 3D object out."""

from phy124.camera import Camera
from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.gaussians import Frame, Gaussians

__version__ = "0.1.0"
__all__ = ["Camera", "Cancelled", "Clip", "Frame", "Gaussians", "InputError"]
