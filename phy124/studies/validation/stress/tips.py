"""Cases 33 and 34: thin and pointed shapes on the floor and on another body."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.stress.bodies import Array, host
from phy124.studies.validation.stress.case import Check, Setting, at_most

DEEPEST = {
    ("lattice", "draft"): 0.3,
    ("lattice", "standard"): 0.3,
    ("lattice", "fine"): 0.3,
    ("mpm", "draft"): 0.4,
    ("mpm", "standard"): 0.5,
    ("mpm", "fine"): 0.5,
}
"""Maximum permitted depth below the floor for each solver and accuracy [cells]."""
PIERCED = 2.5
"""Maximum permitted depth inside another body [cells].

The method cannot keep Gaussians out of another body; see docs/lab/stability.md.
"""
CUSHION = (1.0, 1.0, 0.4)
"""Sides of the other body, a box [m]."""
COUNT, SIZE = 12_000, 0.008
"""Maximum number of Gaussians in a shape, and their standard deviation [m]."""
Inside = Callable[[Array], NDArray[np.bool_]]


def cone(x: Array) -> NDArray[np.bool_]:
    """Return whether points are in a cone that stands on its tip (half-angle 25 degrees)."""
    return np.hypot(x[:, 0], x[:, 1]) < x[:, 2] * np.tan(np.radians(25))


def needle(x: Array) -> NDArray[np.bool_]:
    """Return whether points are in a cone that stands on its tip (half-angle 10 degrees)."""
    return np.hypot(x[:, 0], x[:, 1]) < x[:, 2] * np.tan(np.radians(10))


def edge(x: Array) -> NDArray[np.bool_]:
    """Return whether points are in a wedge that stands on its edge (half-angle 45 degrees)."""
    return (np.abs(x[:, 0]) < x[:, 2]) & (x[:, 2] < 0.5) & (np.abs(x[:, 1]) < 0.4)


def table(x: Array) -> NDArray[np.bool_]:
    """Return whether points are in a table; each leg is as thick as 6 % of the table's size."""
    across = np.abs(x[:, :2])
    leg = (np.abs(across - 0.33).max(axis=1) < 0.03) & (x[:, 2] < 0.6)
    return leg | ((across.max(axis=1) < 0.4) & (np.abs(x[:, 2] - 0.57) < 0.07))


def hairs(x: Array) -> NDArray[np.bool_]:
    """Return whether points are in a ball with 61 hairs, each as thick as 4 % of the ball."""
    ways = np.random.default_rng(1).normal(size=(60, 3))
    ways = np.vstack([(0, 0, -1), ways / np.linalg.norm(ways, axis=1, keepdims=True)])
    from_middle = x - (0, 0, 0.5)
    inside: NDArray[np.bool_] = np.linalg.norm(from_middle, axis=1) < 0.35
    for way in ways:
        along = from_middle @ way
        apart = np.linalg.norm(from_middle - along[:, None] * way, axis=1)
        inside |= (apart < 0.02) & (along > 0) & (along < 0.5)
    return inside


SHAPES: tuple[Inside, ...] = (cone, needle, edge, table, hairs)


@cache
def cloud(inside: Inside) -> Gaussians:
    """Fill a shape of about 1 m with Gaussians."""
    x = np.random.default_rng(0).uniform((-0.6, -0.6, 0), (0.6, 0.6, 1.0), (100_000, 3))
    x = x[inside(x)][:COUNT]
    count, grey = len(x), np.full((len(x), 3), 0.5)
    quats, scales = np.tile((1.0, 0, 0, 0), (count, 1)), np.full((count, 3), SIZE)
    return Gaussians.from_rgb(x, quats, scales, np.full(count, 0.9), grey)


def solvers(setting: Setting) -> tuple[str, ...]:
    """Return the solvers for elastic objects in a setting."""
    fast = (setting.device, setting.precision) == ("cpu", "float32")
    return ("mpm", "lattice") if fast else ("mpm",)


def drop(inside: Inside, setting: Setting, solver: str, options: dict[str, Any]) -> Simulation:
    """Prepare twelve frames in which a shape falls.

    Args:
        inside: The shape.
        setting: Device and precision.
        solver: Solver for elastic objects.
        options: Changes to the preset `drop`, by field name.
    """
    scene = Scene.named("drop").replaced({"time.frames": 12, **options})
    changes = {"precision": setting.precision, "solver": solver}
    resolution = scene.resolution.model_copy(update=changes)
    scene = scene.model_copy(update={"accuracy": resolution})
    return Simulation(prepare(cloud(inside), scene, RunContext(device=setting.device)))


def check_depth(inside: Inside, lift: float, accuracy: str, setting: Setting, solver: str) -> Check:
    """Check the depth to which a shape's Gaussians sink below the floor [cells].

    Args:
        inside: The shape.
        lift: Initial height [m].
        accuracy: Name of the accuracy preset.
        setting: Device and precision.
        solver: Solver for elastic objects.
    """
    run = drop(inside, setting, solver, {"object.lift": lift, "accuracy": accuracy})
    depth = -float(run.run().means[:, :, 2].min()) / run.scene.dx
    what = f"depth of {inside.__name__} dropped from {lift:g} m ({accuracy}, {solver}) [cells]"
    return at_most(what, depth, DEEPEST[solver, accuracy])


def depth_in_body(inside: Inside, accuracy: str, setting: Setting, solver: str) -> float:
    """Return the depth to which a shape's Gaussians sink into a cushion of its material [cells].

    Depths are measured in the undeformed cushion, so that a dent is not counted as penetration.

    Args:
        inside: The shape.
        accuracy: Name of the accuracy preset.
        setting: Device and precision.
        solver: Solver for elastic objects.

    Raises:
        ValueError: The shape never touches the cushion.
    """
    material = Scene.named("drop").material
    cushion = {"name": "cushion", "shape": "box", "sides": CUSHION, "material": material}
    options = {"accuracy": accuracy, "object.on": "cushion", "objects": [cushion]}
    run = drop(inside, setting, solver, options)
    model, state = run.solver.model, run.solver.state
    body = model.particles(1)
    rest, depths = host(state.x)[body].copy(), []
    for frame in run:
        x, F = host(state.x)[body], host(state.F)[body]
        means = frame.gaussians.means[frame.gaussians.object_id == 0]
        distance, near = scipy.spatial.KDTree(x).query(means)
        offset = np.linalg.solve(F[near], (means - x[near])[:, :, None])[:, :, 0]
        place = rest[near] + offset
        within = np.abs(place[:, :2]).max(axis=1) < CUSHION[0] / 2
        touched = place[within & (distance < 1.5 * model.dx), 2]
        depths += (CUSHION[2] - touched).tolist()
    return float(np.max(depths)) / model.dx


def tips(setting: Setting) -> list[Check]:
    """Check that tips, edges, legs and hairs of a soft body do not penetrate the floor."""
    lifts = (0.0, 0.1, 0.3) if setting.long else (0.3,)
    return [
        check_depth(inside, lift, accuracy, setting, solver)
        for solver in solvers(setting)
        for accuracy in (("draft", "standard", "fine") if setting.long else ("draft",))
        for lift in lifts
        for inside in SHAPES
    ]


def tips_on_body(setting: Setting) -> list[Check]:
    """Check that tips, edges and hairs penetrate another body by at most a known depth."""
    return [
        at_most(
            f"depth of {inside.__name__} in a cushion ({accuracy}, {solver}) [cells]",
            depth_in_body(inside, accuracy, setting, solver),
            PIERCED,
        )
        for solver in solvers(setting)
        for accuracy in (("draft", "standard") if setting.long else ("draft",))
        for inside in ((cone, needle, edge, hairs) if setting.long else (needle, hairs))
    ]
