"""Turns one photograph into a 3D object that moves by simulated physics.

    import phy124

    result = phy124.generate("duck.png", phy124.Scene.named("press"), "out")
    clip = phy124.Clip.load(result.folder / "clip.safetensors")

The names in `__all__` are the public interface, whose versioning is described in CONTRIBUTING.md.
Each name is imported when it is first used, so that `import phy124` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phy124.boundaries import Boundary
    from phy124.camera import Camera
    from phy124.errors import Cancelled, InputError
    from phy124.forces import Force
    from phy124.gaussians import Frame, Gaussians
    from phy124.generators import Generator
    from phy124.imaging.cutout import cut_out
    from phy124.io.clip import Clip
    from phy124.io.formats import read_gaussians, write_gaussians
    from phy124.io.html import write_html
    from phy124.io.ply import read_ply, write_ply
    from phy124.io.video import write_mp4
    from phy124.live import Live
    from phy124.materials import Material
    from phy124.metrics.comparison import compare
    from phy124.pipeline import Result, generate, simulate
    from phy124.rendering.film import film
    from phy124.rendering.frames import render_frames
    from phy124.rendering.render import Renderer, render
    from phy124.runtime.context import RunContext
    from phy124.scene import Scene, preset_names
    from phy124.simulation import Setup, Simulation, Stopped, prepare

__version__ = "0.3.0"
__all__ = [
    "Boundary",
    "Camera",
    "Cancelled",
    "Clip",
    "Force",
    "Frame",
    "Gaussians",
    "Generator",
    "InputError",
    "Live",
    "Material",
    "Renderer",
    "Result",
    "RunContext",
    "Scene",
    "Setup",
    "Simulation",
    "Stopped",
    "compare",
    "cut_out",
    "film",
    "generate",
    "prepare",
    "preset_names",
    "read_gaussians",
    "read_ply",
    "render",
    "render_frames",
    "simulate",
    "write_gaussians",
    "write_html",
    "write_mp4",
    "write_ply",
]
_MODULES = {
    "boundaries": ["Boundary"],
    "camera": ["Camera"],
    "io.clip": ["Clip"],
    "errors": ["Cancelled", "InputError"],
    "forces": ["Force"],
    "gaussians": ["Frame", "Gaussians"],
    "generators": ["Generator"],
    "imaging.cutout": ["cut_out"],
    "io.html": ["write_html"],
    "io.formats": ["read_gaussians", "write_gaussians"],
    "io.ply": ["read_ply", "write_ply"],
    "io.video": ["write_mp4"],
    "materials": ["Material"],
    "live": ["Live"],
    "metrics.comparison": ["compare"],
    "pipeline": ["Result", "generate", "simulate"],
    "rendering.film": ["film"],
    "rendering.frames": ["render_frames"],
    "rendering.render": ["Renderer", "render"],
    "scene": ["Scene", "preset_names"],
    "runtime.context": ["RunContext"],
    "simulation": ["Setup", "Simulation", "Stopped", "prepare"],
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # hidden from type checkers, which would otherwise accept any name

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
