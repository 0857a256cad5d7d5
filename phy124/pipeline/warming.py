"""Compiles the kernels of scenes ahead of time."""

from collections.abc import Sequence
from dataclasses import replace

from phy124.gaussians import Gaussians
from phy124.generators.shapes import ball
from phy124.kernels.implicit import HULL, INFLATED, push
from phy124.kernels.splat import discs, fields, shadow, stage
from phy124.kernels.splat.arrange import arrange
from phy124.rendering.render import Renderer
from phy124.runtime.compiling import compile_missing
from phy124.runtime.context import RunContext
from phy124.runtime.cores import cores
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.solver import kernels

STAGE = {
    "cpu": (shadow.cover_simd, arrange, stage.blend_staged_simd),
    "cuda": (shadow.cover, arrange, stage.draw_setting),
}
"""One kernel from each module that draws a stage; this compiles the whole module."""
HOST = (INFLATED.project, HULL.project, push, fields.fill, discs.find_surface)
"""One kernel from each module that always runs on the CPU."""
FEW = {"accuracy.cells": 8, "time.frames": 2, "time.fps": 240.0}
"""Changes that shorten the run of a scene, with the same kernels."""


def warm(scenes: Sequence[Scene], context: RunContext) -> int:
    """Compile all kernels of runs; return the number of modules that were compiled."""
    device, progress = context.device, context.progress
    drawn = STAGE["cpu" if device == "cpu" else "cuda"]
    listed = [kernel for scene in scenes for kernel in kernels(scene, device)]
    compiled = compile_missing(HOST, "cpu", progress)
    compiled += compile_missing([*listed, *drawn], device, progress)
    Renderer(device=device)
    # Forces and the second thread need small kernels that are not listed; trial runs compile them.
    threads = min(2, cores()) if device == "cpu" else None
    for done, scene in enumerate(scenes, 1):
        probe = replace(context.aside(), threads=threads)
        Simulation(prepare(object_of_points(), scene.replaced(FEW), probe)).run()
        progress("try", done, len(scenes))
    return compiled


def object_of_points() -> Gaussians:
    """Return a ball of Gaussians that are much smaller than the distances between them.

    The solid of such a ball has only an eighth of the usual number of voxels.
    """
    full = ball(1000)
    return replace(full, scales=0.01 * full.scales)
