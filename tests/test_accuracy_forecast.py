"""Forecasts: what is counted must be right; seconds are measured by benchmarks, not here."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.accuracy import Forecaster, companion
from phy124.accuracy import forecast as module
from phy124.accuracy.forecast import Forecast, pixels_per_size, speed_up
from phy124.accuracy.load import QUIET
from phy124.accuracy.probe import CELLS, Pilot, SubstepCost, coarsen, run_pilot
from phy124.accuracy.promises import Promise, promise
from phy124.errors import InputError
from phy124.rendering.nearest import ROOM
from phy124.runtime.context import RunContext
from phy124.scene import PRESETS, Scene
from phy124.scene.lattices import choose_solver
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
OBJECT = ball(300)
QUICK = [
    *("--accuracy", "draft", "--gaussians", "2000", "--frames", "3", "--size", "64"),
    *("--views", "front", "--device", "cpu"),
]


def scene(name: str, cells: int = 16, **changes) -> Scene:
    accuracy = {"cells": cells, "solver": "mpm"}
    quick = {"accuracy": accuracy, "time.frames": 5, "view.size": 64}
    return Scene.named(name).replaced({**quick, "view.views": ["front"], **changes})


def test_the_probe_leaves_the_simulation_as_it_was():
    plain, probed = (Simulation(prepare(OBJECT, scene("press"))) for _ in range(2))
    made = Forecaster().of(probed)
    assert probed.solver.clock.substeps == 0
    assert probed.solver.clock.time == 0
    assert not probed.solver.timings
    a, b = plain.run(), probed.run()
    assert np.array_equal(a.means, b.means)
    assert np.array_equal(a.scales, b.scales)
    assert made.rates.particle > 0


@pytest.mark.parametrize(
    "name",
    ["press", *(pytest.param(name, marks=pytest.mark.slow) for name in ("push_right", "drop"))],
)
def test_substeps_are_predicted(name):
    """Within what the promise of ten per cent leaves them."""
    chosen = scene(name)
    simulation = Simulation(prepare(OBJECT, chosen))
    predicted = Forecaster().of(simulation, filming=False)
    simulation.run()
    assert predicted.substeps == pytest.approx(simulation.solver.clock.substeps, rel=0.06)
    assert predicted.limiters == {"elastic": pytest.approx(1.0)}
    assert predicted.caveat is None


@pytest.mark.parametrize("name", ["press", pytest.param("sway", marks=pytest.mark.slow)])
def test_substeps_on_a_lattice_follow_from_its_own_rest(name):
    chosen = scene(name, 20, **{"accuracy.solver": "lattice"})
    simulation = Simulation(prepare(OBJECT, chosen))
    made = Forecaster().of(simulation, filming=False)
    assert simulation.solver.clock.substeps == 0 and not simulation.solver.timings
    simulation.run()
    assert made.substeps == pytest.approx(simulation.solver.clock.substeps, rel=0.08)


def test_companion_on_a_lattice_takes_as_long_as_its_pilot(monkeypatch):
    simulation = Simulation(prepare(OBJECT, scene("press", 16, **{"accuracy.solver": "lattice"})))
    monkeypatch.setattr(companion, "AFFORDABLE", 1e6)
    forecaster = Forecaster()
    made = forecaster.of(simulation, filming=False, load=QUIET)
    pilot = forecaster._pilot(simulation)
    assert made.stages["companion"] == pytest.approx(pilot.seconds / 2**2.5)


def test_forecast_of_shapes_binds_gaussians_once(monkeypatch):
    monkeypatch.setattr(module, "time_shapes", lambda simulation: (7.0, 0.5))
    simulation = Simulation(prepare(OBJECT, scene("press", **{"time.frames": 4})))
    made = Forecaster(error=False).of(simulation, filming=False, load=QUIET)
    assert made.stages["deform"] == 7.0 + 4 * 0.5


def test_forecast_has_the_companion_of_runs_that_afford_it(monkeypatch):
    simulation, forecaster = Simulation(prepare(OBJECT, scene("press"))), Forecaster()
    options = {"filming": False, "load": QUIET}
    assert "companion" not in forecaster.of(simulation, **options).stages  # too expensive
    monkeypatch.setattr(companion, "AFFORDABLE", 1e6)
    made = forecaster.of(simulation, **options)
    cost = made.stages["companion"] / made.stages["simulate"]
    assert cost == pytest.approx(companion.forecast(simulation, made.substeps)) and cost > 0.2
    assert "companion" not in forecaster.of(simulation, error=False, **options).stages


def test_substeps_are_proportional_to_cells():
    pilot = run_pilot(OBJECT, scene("push_right"))
    counts = {cells: pilot.substeps(cells)[0] for cells in (12, 24, 48)}
    each = counts[48] / 4
    assert each == np.ceil(pilot.rest * 48 / pilot.cells)
    assert counts[24] <= counts[48] / 2 + 4


def test_excess_substeps_grow_faster_than_the_cells():
    nothing, frames = np.zeros(3), np.ones(3)
    counts = {"elastic": 10 * frames, "speed": 4 * frames, "gradient": frames, "user": nothing}
    substeps, fractions = Pilot(12, counts, 8.0, 1.0, False).substeps(24)
    elastic = 8 * 2 + 2 * 2**1.8
    assert substeps == 3 * np.ceil(elastic + 4 * 2 + 1)
    assert fractions["speed"] == pytest.approx(8 / (elastic + 9))
    assert "user" not in fractions


def test_friction_asks_for_the_square_of_the_cells():
    counts = {"elastic": np.array([10.0, 100.0]), "speed": np.zeros(2)}
    substeps, fractions = Pilot(12, counts, 10.0, 1.0, False, viscous=15.0).substeps(24)
    second = 2 * 10 + 90 * 2**1.8
    assert substeps == 60 + np.ceil(second), "friction rules the first frame only"
    assert fractions["viscous"] == pytest.approx(60 / (60 + second))


def test_substeps_of_a_body_with_friction_are_predicted():
    rubbing = scene("press", **{"material.damping": 400.0})
    simulation = Simulation(prepare(OBJECT, rubbing))
    made = Forecaster().of(simulation, filming=False)
    simulation.run()
    assert made.substeps == pytest.approx(simulation.solver.clock.substeps, rel=0.06)
    assert made.limiters.get("viscous", 0) > 0.5


@pytest.mark.slow
def test_substeps_of_a_body_that_stiffens_are_predicted():
    profile = {"kind": "ramp", "duration": 0.15, "first": 1.0, "last": 9.0}
    stiffens = scene("push_right", stiffness_profile=profile)
    simulation = Simulation(prepare(OBJECT, stiffens))
    made = Forecaster().of(simulation, filming=False)
    simulation.run()
    assert made.substeps == pytest.approx(simulation.solver.clock.substeps, rel=0.06)


def test_no_promise_where_speed_rules():
    """A jelly thrown faster than its own sound: the seconds are only a guess, and it says so."""
    fast = scene(
        "drop",
        **{"material.E": 200.0, "material.damping": 0.0, "object.lift": 2.0},
        **{"object.velocity": [0.0, 0.0, -6.0]},
    )
    simulation = Simulation(prepare(OBJECT, fast))
    made = Forecaster().of(simulation, filming=False)
    assert made.limiters.get("speed", 0) > 0.1
    assert made.caveat is not None
    assert "only a rough estimate" in made.caveat
    simulation.run()
    limited = simulation.solver.clock.limiters
    assert limited.get("speed", 0) > 0.1 * sum(limited.values())


def test_compared_counts_only_what_was_predicted():
    made = Forecast(
        {"simulate": 2.0, "render": 1.0}, (), 10, 20, 30, {"elastic": 1.0}, SubstepCost(1.0, 1.0)
    ).with_measured("generate", 5.0)
    assert made.seconds == 8.0
    report = made.compare({"generate": 50.0, "simulate": 3.0, "render": 1.0, "image": 9.0})
    assert report["predicted"] == 3.0
    assert report["spent"] == 4.0
    assert report["ratio"] == pytest.approx(4 / 3)
    assert report["stages"]["simulate"]["ratio"] == 1.5


def test_gpu_forecast_names_the_stages_of_the_cpu():
    stages = {"generate": 3.0, "simulate": 0.2, "render": 0.1, "encode": 1.7}
    made = Forecast(stages, (), 10, 20, 30, {"elastic": 1.0}, SubstepCost(1.0, 1.0))
    note = (
        "94% of this time is spent on the CPU, most of it on generate (3.0 s) and encode (1.7 s)."
    )
    assert note in replace(made, device="cuda:0").lines()[-1]
    assert "spent on the CPU" not in "".join(made.lines())
    busy = replace(made, device="cuda:0", stages={**stages, "simulate": 60.0})
    assert "spent on the CPU" not in "".join(busy.lines())


def test_a_second_look_at_the_stops_runs_nothing(monkeypatch):
    for name, cells in (("draft", 8), ("standard", 12), ("fine", 16)):
        monkeypatch.setitem(PRESETS, name, PRESETS[name].model_copy(update={"cells": cells}))
    known = {8: 0.07, 12: None, 16: 0.01}
    monkeypatch.setattr(module, "promise", lambda at, _: Promise(known[at.resolution.cells], ""))
    forecaster = Forecaster()
    stops = forecaster.stops(OBJECT, scene("push_right"))
    assert list(stops) == ["draft", "standard", "fine"]
    assert [stop.error for stop in stops.values()] == [0.07, None, 0.01]
    assert stops["standard"].pixels is None
    substeps = [stop.forecast.substeps for stop in stops.values()]
    assert substeps == sorted(substeps)
    assert stops["draft"].pixels == pytest.approx(0.07 * 64 / ROOM)
    monkeypatch.setattr(module, "Simulation", None)
    assert forecaster.stops(OBJECT, scene("push_right")) == stops


@pytest.mark.parametrize(("name", "times"), [("metal", 2), ("drop", 1)])
def test_times_of_videos_depend_on_glossy_materials_only(monkeypatch, name, times):
    timed, forecaster = [], Forecaster()
    monkeypatch.setattr(module, "time_film", lambda setup, context: timed.append(setup) or {})
    for density in (900.0, 1100.0):
        changes = {"accuracy": {"cells": 8}, "time.frames": 2, "material.density": density}
        forecaster._filming(prepare(OBJECT, Scene.named(name).replaced(changes)))
    assert len(timed) == times


def test_stops_for_a_gpu_have_the_promises_of_its_solver(monkeypatch):
    press, made = Scene.named("press"), SimpleNamespace(seconds=1.0, proportions=None, caveat=None)
    forecaster = Forecaster(RunContext(device="cuda:0"))
    monkeypatch.setattr(forecaster, "forecast", lambda gaussians, scene: made)
    for name, stop in forecaster.stops(OBJECT, press).items():
        chosen = choose_solver(press.replaced({"accuracy": name}), "cuda:0")
        assert chosen.solver == "mpm" and stop.promise == promise(chosen, None)


def test_pixels_per_size_is_what_the_camera_sees():
    assert pixels_per_size(scene("press", **{"view.size": 512})) == 512 / ROOM
    chosen = scene("press", **{"view.size": 512, "view.distance": 2.5})
    half = 0.5 * chosen.view.distance * np.tan(np.radians(chosen.view.fov / 2)) * 2
    assert pixels_per_size(chosen) == pytest.approx(512 / (2 * half))


@pytest.mark.slow
def test_the_report_compares_what_was_predicted(tmp_path, capsys):
    arguments = ["generate", str(DUCK), *QUICK, "--json", "--out", str(tmp_path)]
    assert main([*arguments, "--forecast"]) == 0
    output = json.loads(capsys.readouterr().out)["forecast"]
    assert set(output["stages"]) == {"simulate", "deform", "render", "encode", "save"}
    assert output["ratio"] == pytest.approx(output["spent"] / output["predicted"])
    assert output["caveat"] is None
    assert main(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    assert "forecast" not in report
    assert "forecast" not in {stage["name"] for stage in report["stages"]}


def test_dry_run_says_how_long_and_makes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["generate", str(DUCK), *QUICK, "--dry-run", "--json"]
    assert main(arguments) == 0
    output = json.loads(capsys.readouterr().out)
    assert set(output["stages"]) == {
        "image",
        "generate",
        "particles",
        "simulate",
        "deform",
        "render",
        "encode",
        "save",
    }
    assert output["measured"] == ["particles", "generate", "image"]
    assert output["seconds"] == pytest.approx(sum(output["stages"].values()))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("radius", "cells"), [(0.2, CELLS), (0.04, 25), (0.03, 32)])
def test_the_pilot_s_grid_resolves_what_the_scene_s_does(radius, cells):
    """A solid of 0.03 m is too thin for both, and is refused as such."""
    wall = {"kind": "sphere", "radius": radius}
    small = {"name": "small", "shape": "box", "size": 2 * radius, "motion": {"kind": "free"}}
    changes = {"boundaries": [{"kind": "ground"}, wall]}, {"objects": [small]}
    for change in changes:
        declared = Scene.named("drop").replaced(
            {"accuracy": "standard", "object.size": 1.0, **change}
        )
        assert coarsen(declared).resolution.cells == cells


def test_pilot_has_the_scene_s_grid_if_a_coarser_grid_is_refused():
    """At 16 cells, the region contains no particle."""
    within = {"lower": [-0.014, -0.014, 0.3], "upper": [0.014, 0.014, 0.7]}
    push = {"kind": "acceleration", "a": [0.0, 1.0, 0.0], "region": within}
    grasped = scene("drop", 20, **{"forces": [push], "object.lift": 0.0})
    assert run_pilot(OBJECT, grasped).cells == 20
    with pytest.raises(InputError, match="it holds no particle"):
        run_pilot(OBJECT, grasped.replaced({"accuracy.cells": 16}))


def test_speed_up_is_that_of_the_benchmarks():
    assert speed_up(1) == 1 and speed_up(16) == pytest.approx(11.8, rel=0.01)
