"""The time of a substep, from the stages of a pilot run and of a probe at rest."""

import numpy as np
import pytest

from phy124.accuracy import Forecaster, probe
from phy124.accuracy.probe import Pilot, run_pilot
from phy124.accuracy.stages import LIQUID, OTHER, Growth, Stage, average_stages, predict_substep
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


def with_box(first: dict, second: dict, **changes) -> Simulation:
    """Return a ball under a box that falls on it."""
    box = {"name": "box", "shape": "box", "size": 0.5, "on": "object", "lift": 0.05}
    data = {
        "material": first,
        "objects": [{**box, "material": second}],
        "forces": [{"kind": "gravity"}],
        "boundaries": [{"kind": "ground"}],
        "time": {"frames": 4},
        "accuracy": {"cells": 12, "solver": "lattice"},
    }
    return Simulation(prepare(ball(300), Scene.from_data({**data, **changes})))


def test_stages_are_averages_over_substeps():
    made = average_stages({"stress": [6.0, 12], "near": [0.0, 0]}, 4, 6.4)
    assert made == {"stress": Stage(3.0, 0.5), OTHER: Stage(1.0, pytest.approx(0.1))}


def test_time_between_stages_stays():
    stages = {"stress": Stage(1.0, 2.0), OTHER: Stage(1.0, 0.5)}
    assert predict_substep(stages, stages, stages, Growth(1.0)) == pytest.approx(2.5)


def test_calls_are_those_of_the_pilot():
    pilot = {"stress": Stage(1.5, 0.1), "frequency": Stage(0.5, 0.2), "wait": Stage(4.0, 1.0)}
    probed = {"stress": Stage(1.0, 2.0), "frequency": Stage(0.05, 4.0), "wait": Stage(4.0, 0.1)}
    expected = 1.5 * 2.0 + 0.5 * 4.0 + 4.0 * 0.1
    assert predict_substep(pilot, pilot, probed, Growth(2.0)) == pytest.approx(expected)


def test_contact_takes_the_longer_of_both_durations():
    pilot = {"contact": Stage(3.0, 0.2), "meetings": Stage(0.1, 1.0)}
    probed = {"contact": Stage(3.0, 0.1)}
    assert predict_substep(pilot, pilot, probed, Growth(2.0)) == pytest.approx(3 * 0.4 + 0.1 * 2.0)


def test_a_call_takes_longer_in_motion_than_at_rest():
    moving, resting = {"gather": Stage(1.0, 0.3)}, {"gather": Stage(1.0, 0.2)}
    probed = {"gather": Stage(1.0, 0.8)}
    assert predict_substep(moving, resting, probed, Growth(1.5)) == pytest.approx(0.8 * 1.5)


def test_a_liquid_s_call_is_constant_plus_proportional_to_cells():
    name, at_rest = f"{LIQUID}spread", Stage(1.0, 0.1 + 0.2)
    moving, probed = {name: Stage(1.0, 0.1 + 0.5)}, {name: Stage(1.0, 0.1 + 8 * 0.2)}
    growth = Growth(2.0, substeps=3.0, steps=1.5)
    expected = 1.5 / 3.0 * (0.1 + 8 * 0.5)
    assert predict_substep(moving, {name: at_rest}, probed, growth) == pytest.approx(expected)


def test_a_liquid_takes_more_steps_on_finer_grids():
    """2 cells^1.2 steps per frame, rounded up, for a body with 8 substeps per frame."""
    counts = {"elastic": np.full(3, 8.0), "speed": np.zeros(3)}
    steps = {"wave": np.full(3, 0.4), "speed": np.full(3, 1.6)}
    growth = Pilot(16, counts, 8.0, 1.0, False, steps=steps).growth_to(32, 2.0)
    assert growth == Growth(2.0, substeps=2.0, steps=5 / 2)


def test_no_stage_of_a_liquid_takes_negative_time():
    scene = Scene.named("water").replaced({"accuracy": {"cells": 12}, "time.frames": 6})
    report = Simulation(prepare(ball(300), scene)).run().report
    assert all(stage["seconds"] >= 0 for stage in report["substep_stages"])


def test_pilot_on_a_lattice_counts_the_calls_of_its_motion():
    scene = Scene.named("press").replaced({"accuracy": {"cells": 8}, "time.frames": 3})
    pilot = run_pilot(ball(300), scene.replaced({"accuracy.solver": "lattice"}))
    assert pilot.stages["nodes"].calls == 2
    assert 0 < pilot.stages["meetings"].calls < 1


def test_forecast_of_a_wet_lattice_has_the_liquid_s_stages():
    tank = {"lower": [-0.6, -0.6, 0], "upper": [0.6, 0.6, 1e9]}
    changes = {"boundaries": [{"kind": "container", "inside": tank, "contact": "slip"}]}
    run = with_box({"law": "fluid"}, {"law": "neo_hookean"}, **changes)
    forecaster = Forecaster()
    forecaster.of(run, filming=False)
    assert not run.timings, "the times of the probe are not those of the run"
    pilot = forecaster._pilot(run)
    assert {
        "liquid, pressure",
        "contact",
        "liquid, p2g",
    } <= pilot.stages.keys() & pilot.resting.keys()
    stages = run.run().report["substep_stages"]
    assert all(stage["seconds"] >= 0 for stage in stages), stages


def test_substeps_of_stiff_lattices_among_particles(monkeypatch):
    monkeypatch.setattr(probe, "CELLS", 8)
    run = with_box({"law": "neo_hookean", "E": 5e6}, {"law": "plasticine"})
    made = Forecaster().of(run, filming=False)
    run.run()
    assert made.substeps == pytest.approx(run.solver.clock.substeps, rel=0.06)
