"""A GPU moves everything as the CPU does: every law, solid, force and binding."""

import numpy as np
import pytest

from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.scenes import FORCES, LAWS, OTHER_SOLIDS, SOLIDS
from support.shapes import ball

pytestmark = pytest.mark.gpu
TOLERANCE = 1e-3
"""Largest distance of a Gaussian of a body of 1 m after a few frames [m]; sums round otherwise."""
FALLING = {"object.lift": 0.02, "object.velocity": [0.5, 0.2, -2.0], "time.substep": 1e-3}
"""The substep is short enough that most laws take it: one substep more or less moves what touches a
wall of so few cells by more than the tolerance.
"""
GRAVITY = {"kind": "gravity"}
SCENES = {
    **{f"law {name}": {"material": material} for name, material in LAWS.items()},
    **{f"wall {name}": {"boundaries": [wall]} for name, wall in (SOLIDS | OTHER_SOLIDS).items()},
    **{f"force {name}": {"forces": [GRAVITY, force]} for name, force in FORCES.items()},
    "wall press": {
        "boundaries": [{"kind": "ground"}, {"kind": "press", "top": 1.05, "down": 0.2}],
        "time.frames": 3,  # Later, the CPU alone magnifies rounding to the tolerance.
    },
    "one particle for each Gaussian": {"binding": "particles"},
    "float64": {"accuracy": {"cells": 8, "precision": "float64"}},
    "contacts and velocities": {"contacts": True, "velocities": True},
    "two materials": {"parts": [{"region": {"upper": [1, 1, 0.5]}, "material": {"law": "fluid"}}]},
    "stiffness that varies": {"stiffness": {"kind": "gradient", "first": 1.0, "last": 0.3}},
}


@pytest.mark.parametrize("name", SCENES)
def test_a_gpu_moves_it_as_the_cpu_does(name, gpu):
    changes = {
        "accuracy": {"cells": 8, "solver": "mpm"},
        "time.frames": 6,
        **FALLING,
        **SCENES[name],
    }
    scene = Scene.named("drop").replaced(changes)
    here, there = (
        Simulation(prepare(ball(500), scene, RunContext(device=device, threads=1)))
        for device in ("cpu", gpu)
    )
    ours, theirs = here.run(), there.run()
    assert theirs.report["complete"], theirs.report["stopped"]
    assert "graph" in there.solver.timings or there.solver.rejection.sudden(there.solver.clock)
    np.testing.assert_allclose(theirs.means, ours.means, atol=TOLERANCE)
    # Rounding may swap two axes of a Gaussian, but does not change its shape.
    shapes, expected = (
        np.stack([frame.gaussians.covariances() for frame in clip.frames()])
        for clip in (theirs, ours)
    )
    widest = 2 * float(ours.scales.max())
    np.testing.assert_allclose(shapes, expected, atol=TOLERANCE * widest)
    if ours.contacts is not None:
        assert np.abs(theirs.contacts).max() == pytest.approx(np.abs(ours.contacts).max(), rel=0.05)
