"""Groups of small scenes that together run every kernel.

The forms of a GPU are chosen before this module is imported (gpu_forms.py).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from phy124.camera import Camera
from phy124.generators.relief.hull import Hull
from phy124.generators.relief.surface import Surface, settle
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import compute_energies
from phy124.rendering.compose.colours import Adjoint
from phy124.rendering.liquid import Liquid
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import make_stage
from phy124.runtime.context import RunContext
from phy124.scene import Scene, View
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.accuracy import problems
from phy124.studies.validation.bodies import make_solver
from phy124.studies.validation.stress.case import Setting
from phy124.studies.validation.stress.laws import every_deformation
from support.runs import TORN
from support.scenes import FORCES, LAWS, OTHER_SOLIDS, SOLIDS, SWING
from support.shapes import ball, splats

SMALL = {"accuracy": {"cells": 8, "solver": "mpm"}, "time.frames": 3, "time.fps": 400.0}
FALLING = {"object.lift": 0.0, "object.velocity": [0.3, 0.1, -1.5]}
Runs = dict[str, Callable[[], object]]


def simulate(
    preset: str = "drop", count: int = 300, *, threads: int = 1, **changes: Any
) -> Simulation:
    """Simulate a few frames of a small falling ball."""
    scene = Scene.named(preset).replaced({**SMALL, **changes})
    run = Simulation(prepare(ball(count), scene, RunContext(threads=threads)))
    run.run()
    return run


def laws() -> Runs:
    """Return runs of every law, the first law in both precisions and with both gradients."""
    fall = {law: {"material": material, **FALLING} for law, material in LAWS.items()}
    fall["float64"] = {**FALLING, "accuracy": {"cells": 8, "precision": "float64"}}
    fall["spline"] = {**FALLING, "accuracy": {"cells": 8, "gradient": "spline"}}
    return {
        name: lambda material=material: looked_at(**material) for name, material in fall.items()
    }


def looked_at(**changes: Any) -> None:
    """Run a scene, and compute the energy of each particle at the end, as a failing run does."""
    solver = simulate(**changes).solver
    compute_energies(solver.model, solver.state)


def walls() -> Runs:
    """Return runs of every boundary, at rest and moving, with every contact, some of them with a
    law that flows."""
    results: Runs = {}
    for name, wall in SOLIDS.items():
        for contact in ("separate", "slip", "sticky"):
            motion = {"motion": SWING} if contact == "separate" else {}
            met = {**wall, "contact": contact, **motion}
            results[f"{name}, {contact}"] = lambda met=met: simulate(boundaries=[met], **FALLING)
        results[f"{name}, still"] = lambda wall=wall: simulate(boundaries=[wall], **FALLING)
    for name, wall in OTHER_SOLIDS.items():
        results[name] = lambda wall=wall: simulate(boundaries=[wall], **FALLING)
    sand = {"material": {"law": "sand"}, **FALLING}
    for name in ("sphere", "capsule", "box"):
        results[f"sand on a {name}"] = lambda wall=SOLIDS[name]: simulate(boundaries=[wall], **sand)
    for shape in ("sphere", "capsule", "box"):
        results[f"a free {shape}"] = lambda shape=shape: under_a_free(shape)
    return results


def under_a_free(shape: str) -> None:
    """Let a rigid solid fall from the top of a ball to the ground."""
    sides = [0.7, 0.7, 1] if shape == "capsule" else [1, 1, 1]
    solid = {
        "name": "solid",
        "shape": shape,
        "sides": sides,
        "size": 0.6,
        "lift": 0.01,
        "place": [0.2, 0],
        "turn": [20, 60, 0],
        "on": "object",
        "motion": {"kind": "free", "density": 400},
    }
    simulate(objects=[solid], **{**FALLING, "time.frames": 10, "time.fps": 24.0})


def forces() -> Runs:
    """Return runs of every force, in addition to gravity."""
    gravity = {"kind": "gravity"}
    return {
        name: lambda force=force: simulate(forces=[gravity, force], **FALLING)
        for name, force in FORCES.items()
    }


def monitors() -> Runs:
    """Return runs with measurements and repairs: contacts, repair, distant particles, rejected
    substeps."""
    return {
        "contacts": lambda: simulate(contacts=True, wrenches=True, **FALLING),
        "one particle for each Gaussian": lambda: simulate(binding="particles", **FALLING),
        "sleep": lambda: simulate(**{"time.frames": 12, "time.fps": 24.0}),
        "a violent blow": lambda: simulate(**{**FALLING, "object.velocity": [0, 0, -60.0]}),
        "tearing sand": lambda: simulate("sand"),
        "torn rubber": lambda: simulate("drop", **{**TORN, "time.fps": 24.0}),
        "particles far away": far_away,
        "stress at a point": probed,
        "a vortex": lambda: problems.vortex(6, time=0.01),
        "two workers": in_two_parts,
        "no balance": lambda: simulate(**{**FALLING, "checks.balance": False}),
        "energy": lambda: simulate(**{**FALLING, "checks.energy": True}),
        "aflip": lambda: simulate(**{**FALLING, "accuracy.transfer": "aflip"}),
        "rpic": lambda: simulate(**{**FALLING, "accuracy.rpic_damping": 30.0}),
        "xpic2": lambda: simulate(**{**FALLING, "accuracy.transfer": "xpic2"}),
    }


def far_away() -> None:
    """Simulate particles in a cube, and two particles a thousand cubes away."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.3, 0.3, (200, 3))
    x[-2:] = [[1000.0] * 3, [999.0] * 3]
    solver = make_solver(x, np.full(len(x), 1e-3), [NeoHookean(E=1e4)], dx=0.1)
    solver.advance(0.01)


def probed() -> None:
    """Evaluate laws for any deformation, without a run."""
    every_deformation(Setting("cpu", "float32"))


def in_two_parts() -> None:
    """Run two workers in turn, each with separate nodes."""
    x = np.sort(np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3)), axis=0)
    solver = make_solver(x, np.full(len(x), 1e-3), [NeoHookean(E=1e4)], dx=0.1, threads=2)
    for _ in range(3):
        solver.step(1e-4, 1e-4)


def pictures() -> Runs:
    """Render Gaussians, alone and on a stage with glass walls, with colours that rotate with the
    material."""
    renderer = Renderer(device="cpu")
    return {
        "points of relief": spread,
        "square": lambda: renderer(ball(800), Camera.orbit(30, 20, 1.4, 64)),
        "wide": lambda: renderer(ball(800), Camera.orbit(80, 5, 1.4, (75, 37))),
        "bytes": lambda: renderer.picture(ball(800), Camera.orbit(80, 5, 1.4, (75, 37))),
        "by tiles": lambda: Renderer(blend="plain")(ball(800), Camera.orbit(30, 20, 1.4, 64)),
        "backwards": backwards,
        "on a stage": on_a_stage,
        "a liquid": lambda: Liquid(ball(300).means, 0.1, visibility=0.2).shape(ball(300)),
        "colours": lambda: Simulation(
            prepare(splats(np.random.default_rng(0), 200, degree=1), few(), RunContext(threads=1))
        ).run(),
    }


def spread() -> None:
    """Distribute points on a ball seen from one side, and on a ball seen from two sides."""
    y, x = np.mgrid[:31, :31] - 15.0
    ball = 100 - x**2 - y**2
    points = np.random.default_rng(0).normal(size=(500, 3)) * 6
    hull = Hull.of(ball, ball, y[:, 0], (True, False))
    for surface, middle in ((Surface.of(ball), (15, 15, 0)), (hull, (0, 0, 0))):
        settle(surface, points + middle, lambda normals: np.full(len(normals), 1.5))
        surface.inset(points + middle, 1.0)


def backwards() -> None:
    """Sum pixel values over the Gaussians that are visible in the pixels."""
    camera = Camera.orbit(30, 20, 1.4, (48, 32))
    Adjoint(device="cpu").sums(ball(300), camera, np.ones((32, 48, 3)))


def few(name: str = "spin") -> Scene:
    """A preset with few frames and cells, whose objects move as particles."""
    particles = {"accuracy": {"cells": 8, "solver": "mpm"}}
    return Scene.named(name).replaced({**particles, "time.frames": 3})


def on_a_stage() -> None:
    """A plate above a floor, and a ball of glass among the Gaussians."""
    glass = {"kind": "sphere", "centre": [0.3, 0.1, 0.6], "radius": 0.2}
    scene = few("press")
    walls = [*scene.data()["boundaries"], glass]
    clip = Simulation(
        prepare(ball(300), scene.replaced({"boundaries": walls}), RunContext(threads=1))
    ).run()
    frame, view = next(clip.frames()), View(stage="studio")
    stage = make_stage(clip, view)
    assert stage is not None
    Renderer()(frame.gaussians, Camera.orbit(30, 20, 3.0, (64, 48)), stage=stage.at(frame))


def presets() -> Runs:
    """Return runs of every preset, unchanged."""
    return {
        name: lambda name=name: Simulation(
            prepare(ball(300), few(name), RunContext(threads=1))
        ).run()
        for name in preset_names()
    }


GROUPS: dict[str, Callable[[], Runs]] = {
    "laws": laws,
    "walls": walls,
    "forces": forces,
    "monitors": monitors,
    "pictures": pictures,
    "presets": presets,
}
