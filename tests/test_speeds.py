"""Notes about materials that moved too fast for their law or for their simulated stiffness."""

import numpy as np
import pytest

from phy124 import Scene, Simulation, prepare
from phy124.gaussians import Frame
from phy124.materials import FixedCorotated, Material, NeoHookean, Plasticine, Snow
from phy124.monitor.speeds import Speeds
from phy124.mpm import Solver
from phy124.studies.validation.bodies import block, make_solver
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

FLAT = "may stay squeezed flat without any other sign"


def thrown(material: Material, speed: float) -> tuple[Solver, Speeds]:
    """A block that moves upwards at a speed [m/s], and the observer of its speeds."""
    x = block(middle=(0, 0, 0.24))
    v, volume = np.tile([0, 0, speed], (len(x), 1)), np.full(len(x), 0.375**3 / len(x))
    solver = make_solver(x, volume, [material], dx=0.125, v=v)
    speeds = Speeds([material], np.zeros(len(x), int))
    speeds.bind(solver)
    return solver, speeds


@pytest.mark.parametrize("law", [FixedCorotated, Plasticine])
def test_laws_that_may_stay_flat_say_so(law):
    """At 0.9 times their speed of sound, not at 0.7, though the speed is over before the frame."""
    for mach, said in ((0.9, True), (0.7, False)):
        material = law(E=1e3, nu=0.3, damping=1.0) if law is FixedCorotated else law(E=1e3, nu=0.3)
        solver, speeds = thrown(material, mach * material.sound_speed())
        speeds.before_attempt()
        solver.advance(0.01, after=speeds.after_substep)
        solver.state.v.zero_()
        speeds.after_frame(Frame(1, 0.01, ball(3)))
        assert (FLAT in " ".join(speeds.notes())) == said
        assert not said or f"of the law {material.law} moved" in speeds.notes()[0]
    for material in (Snow(E=1e3), NeoHookean(E=1e3)):
        assert not thrown(material, 1e3)[1].notes()


def test_speed_of_a_failed_attempt_is_not_noted():
    material = FixedCorotated(E=1e3, nu=0.3)
    solver, speeds = thrown(material, 0.9 * material.sound_speed())
    speeds.before_attempt()
    solver.advance(0.01, after=speeds.after_substep)
    assert FLAT in " ".join(speeds.notes())
    speeds.before_attempt(closely=True)
    assert not speeds.notes()


@pytest.mark.parametrize("solver", ["mpm", "lattice"])
@pytest.mark.parametrize("fast", [True, False])
def test_a_slow_material_is_not_blamed_for_the_speed_of_another(solver, fast):
    other = {
        "name": "other",
        "shape": "sphere",
        "place": [3, 0],
        "velocity": [0, 0, 0 if fast else 8],
        "material": {"law": "neo_hookean"},
    }
    changes = {
        "material": {"law": "rigid", "E": 1e12},
        "object.velocity": [0, 0, 8 if fast else 0],
        "objects": [other],
        "accuracy": {"cells": 8, "solver": solver},
        "time.frames": 3,
        "time.fps": 100,
    }
    clip = Simulation(prepare(ball(200), Scene.named("drop").replaced(changes))).run()
    blamed = [note for note in clip.report["notes"] if "rigid body moved at" in note]
    assert len(blamed) == fast and all("moved at 8 m/s" in note for note in blamed)


def test_materials_from_a_file_are_noted_once(tmp_path):
    moduli = np.geomspace(1e10, 1e11, 200)
    np.savez(tmp_path / "rigid.npz", E=moduli, law=np.full(200, "rigid"))
    changes = {
        "properties": {"file": str(tmp_path / "rigid.npz")},
        "object.velocity": [0, 0, 8],
        "accuracy": {"cells": 8},
        "time.frames": 2,
        "time.fps": 100,
    }
    run = Simulation(prepare(ball(200), Scene.named("drop").replaced(changes)))
    notes = run.run().report["notes"]
    assert len(run.setup.materials) > 100
    assert sum("rigid body moved at" in note for note in notes) == 1
    assert sum("is simulated with" in note for note in notes) == 1
