"""Blocks of liquid, their solver, and measurements."""

from dataclasses import replace

import numpy as np

from phy124.boundaries import Container
from phy124.forces import Gravity
from phy124.liquid.solver import LiquidSolver
from phy124.materials import Fluid
from phy124.mpm import Model, State
from phy124.scene import Scene
from phy124.schema.region import Region

G, DENSITY, FPS = 9.81, 1000.0, 48
CELLS, LEVEL = 16, 6.5 / 16
DX = 1 / CELLS
TANK = Container(inside=Region(lower=(0, 0, 0), upper=(1, 1, 1e9)), contact="slip")


def block(low, high, cells: int, per_axis: int = 2) -> np.ndarray:
    """Return particles on a lattice between two corners [m]."""
    step = 1 / cells / per_axis
    axes = [
        np.arange(round((b - a) / step)) * step + a + step / 2
        for a, b in zip(low, high, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def liquid(
    x,
    cells: int,
    walls=(),
    *,
    gravity=(0, 0, -G),
    offset=0.0,
    threads=1,
    simd=True,
    viscosity=0.0,
    pushes=(),
    **solids,
) -> LiquidSolver:
    """Return the solver of a liquid between walls, with 8 particles per cell."""
    dx = 1 / cells
    volume = np.full(len(x), dx**3 / 8)
    origin = (-offset * dx,) * 3
    water = Fluid(density=DENSITY, viscosity=viscosity)
    model = Model.of(x, volume, [water], dx=dx, origin=origin)
    model = model if simd else replace(model, form="plain")
    named = [(f"wall_{index}", wall) for index, wall in enumerate(walls)]
    forces = [*pushes, *([Gravity(g=gravity)] if np.any(gravity) else [])]
    options = {"forces": forces, "boundaries": named, "threads": threads, **solids}
    return LiquidSolver(model, State.of(model), **options)


def run(solver: LiquidSolver, steps: int) -> LiquidSolver:
    start = solver.clock.time
    for step in range(steps):
        solver.advance(start + (step + 1) / FPS)
    return solver


def field(solver: LiquidSolver, name: str) -> np.ndarray:
    values = getattr(solver.cells, name).numpy()
    return values.reshape(*solver.cells.size, *values.shape[1:])


def heights(solver: LiquidSolver) -> np.ndarray:
    """Return the height of the surface in each column of cells that contains liquid [m]."""
    dx, wet, phi = solver.model.dx, field(solver, "liquid"), field(solver, "phi")
    results = []
    for i, j in np.argwhere(wet.any(axis=2)):
        k = np.flatnonzero(wet[i, j])[-1]
        if phi[i, j, k + 1] <= 0:  # a wall
            continue
        part = phi[i, j, k] / (phi[i, j, k] - phi[i, j, k + 1])
        results.append(solver.model.origin[2] + dx * (solver.cells.low[2] + k + 0.5 + part))
    return np.array(results)


def pool(**changes) -> Scene:
    """A ball that falls into a pool."""
    water = {"name": "pool", "shape": "box", "size": 1.5, "sides": (1.0, 1.0, 0.3)}
    container = {
        "kind": "container",
        "inside": {"lower": (-0.75, -0.75, 0), "upper": (0.75, 0.75, 9)},
    }
    data = {
        "accuracy": {"cells": 8, "liquid": "projection"},
        "object": {"lift": 0.5, "velocity": (0, 0, -2)},
        "material": {"law": "neo_hookean", "density": 400, "E": 1e5},
        "objects": [{**water, "material": {"law": "fluid"}}],
        "forces": [{"kind": "gravity"}],
        "boundaries": [{**container, "friction": 0.0}],
        "time": {"frames": 8, "fps": 24},
        **changes,
    }
    return Scene.from_data(data)
