"""Goals: an error or a time in, the cheapest or finest setting out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.accuracy import choose, runs
from phy124.accuracy.choose import Goal, run_for_goal
from phy124.accuracy.convergence import distances
from phy124.accuracy.forecast import Forecaster
from phy124.accuracy.goal import UNIT, describe_goal
from phy124.accuracy.promises import promise
from phy124.errors import InputError, TooFine
from phy124.monitor.tearing import Tearing
from phy124.particles.thickness import Proportions
from phy124.pipeline import disk_space, simulate
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.fixture
def quick(monkeypatch) -> Scene:
    monkeypatch.setattr(choose, "FIRST", (6, 8, 12))
    monkeypatch.setattr(choose, "CELLS", (8, 10, 12, 14, 16, 20, 24))
    return Scene.named("drop").replaced(
        {
            "accuracy": {"cells": 32, "solver": "mpm"},  # on a lattice, material cannot tear
            "time.frames": 6,
            "time.fps": 20.0,
            "object.lift": 0.05,
            "binding": "lattice",
            "view.size": 64,
        }
    )


def test_an_error_goal_is_met_against_a_finer_run(quick):
    """The setting chosen is the cheapest that should do, and it does."""
    reached = run_for_goal(Goal.error("1%"), ball(300), quick)
    about = reached.about
    assert about["met"] is True
    assert about["error"] <= 0.01
    finer = quick.replaced({"accuracy.cells": 2 * about["cells"]})
    truth = Simulation(prepare(ball(300), finer)).run()
    assert distances([reached.clip.means, truth.means])[0, 1] <= 0.01
    assert reached.clip.report["grid"]["dx"] == pytest.approx(1 / about["cells"])


@pytest.mark.parametrize("goal", ["2%", "3px", "2cm"])
def test_the_promise_of_a_run_with_a_goal_is_its_own(quick, goal):
    """One error, however it is asked for: not that of other objects."""
    reached = run_for_goal(Goal.error(goal), ball(300), quick)
    about = reached.about
    said = promise(
        reached.simulation.scene, Proportions(0.5, 0.3), {"goal": about, "complete": True}
    )
    assert said.of_scene and said.about == about["fraction"] < said.error
    assert about["fraction"] == pytest.approx(about["error"] / UNIT[about["unit"]](quick))
    assert said.sentence.startswith("This run is off by about ")
    unknown = about | {"error": None, "fraction": None, "why_not": "no convergence"}
    assert promise(reached.simulation.scene, Proportions(0.5, 0.3), {"goal": unknown}).error is None


def test_a_guessed_order_takes_a_small_step(quick, monkeypatch):
    """An order outside those that are trusted asks for a grid twice too fine."""
    plain = choose.richardson

    def rough(spacings, apart, **options):
        result = plain(spacings, apart, **options)
        if len(spacings) > 3:
            return result
        return replace(result, note="errors are rough", errors=(0.4, 0.3, 0.018), order=0.5)

    monkeypatch.setattr(choose, "richardson", rough)
    about = run_for_goal(Goal.error("1%"), ball(300), quick).about
    assert about["levels"][:4] == [6, 8, 12, 16] and about["met"]


def test_lax_goal_takes_a_cheap_level(quick):
    about = run_for_goal(Goal.error("50%"), ball(300), quick).about
    assert about["cells"] == 6
    assert about["levels"] == [6, 8, 12]
    assert 0 < about["error"] < 0.5
    assert about["met"] is True
    assert about["refined"] is False


def soft(E: float) -> Scene:
    """A ball that spins itself to several times its width."""
    quick = {"time.frames": 8, "time.fps": 20.0, "binding": "lattice", "view.size": 64}
    particles = {"accuracy": {"cells": 32, "solver": "mpm"}}
    return Scene.named("spin").replaced({"material.E": E, **particles, **quick})


@pytest.mark.slow
def test_an_object_that_tears_is_given_more_particles(quick):
    about = run_for_goal(Goal.error("50%"), ball(300), soft(1000)).about
    assert about["particles_per_axis"] == 3
    assert about["met"] is True
    assert not about["torn"]


@pytest.mark.slow
def test_too_many_particles_return_the_last_level(quick, monkeypatch):
    """The second try is refused: nothing that was run is lost for it."""
    monkeypatch.setattr(Tearing, "likely", property(lambda self: self._model.dx < 1 / 13))
    plain = choose.Simulation

    def refusing(setup):
        if setup.scene.particles_per_axis > 2:
            raise InputError("time.budget", "1 s", "it takes too long.", "Wait.")
        return plain(setup)

    monkeypatch.setattr(runs, "Simulation", refusing)
    reached = run_for_goal(Goal.error("0.2%"), ball(300), quick)
    assert reached.about["cells"] == 12
    assert reached.about["particles_per_axis"] == 2
    assert reached.about["met"] is False


@pytest.mark.slow
def test_the_densest_object_is_not_tried_again(quick, monkeypatch):
    monkeypatch.setattr(Tearing, "likely", property(lambda self: self._model.dx < 1 / 13))
    most = quick.replaced({"accuracy.particles_per_axis": 4.0, "time.frames": 4})
    assert run_for_goal(Goal.error("0.2%"), ball(300), most).about["particles_per_axis"] == 4


@pytest.mark.slow
def test_torn_object_meets_no_goal(quick):
    """However close two grids are: what both tear is not what the material does."""
    with pytest.raises(InputError, match=r"on D/\d+ the material is stretched \d.* may tear it"):
        run_for_goal(Goal.error("0.2%"), ball(300), soft(50))


def test_a_grid_that_tears_the_object_is_not_taken(quick, monkeypatch):
    """Return the finest level without tears, and why there is no finer one."""
    likely = property(lambda self: self._model.dx < 1 / 13)
    monkeypatch.setattr(Tearing, "likely", likely)
    about = run_for_goal(Goal.error("0.2%"), ball(300), quick).about
    assert about["cells"] == 12
    assert about["levels"] == [6, 8, 12]
    assert about["torn"]
    assert about["met"] is False
    assert f"on D/{about['torn'][0]}" in about["why_not"]


def test_a_grid_on_which_the_run_stops_is_not_taken(quick, monkeypatch):
    advance = Simulation._take_frame

    def stop_on_fine_grids(run):
        if run.scene.resolution.cells > 12 and run.count == 3:
            raise Stopped("frame 3 took too long.")
        return advance(run)

    monkeypatch.setattr(Simulation, "_take_frame", stop_on_fine_grids)
    about = run_for_goal(Goal.error("0.2%"), ball(300), quick).about
    assert about["levels"] == [6, 8, 12] and about["cells"] == 12 and not about["met"]
    assert about["why_not"] == "on D/16 the simulation stops early: frame 3 took too long"


@pytest.mark.parametrize(("runs_on", "levels"), [(7, [8, 12, 16]), (13, [16, 24]), (99, [])])
def test_coarse_grids_on_which_the_run_stops_are_left_out(quick, monkeypatch, runs_on, levels):
    advance = Simulation._take_frame

    def stop_on_coarse_grids(run):
        if run.scene.resolution.cells < runs_on and run.count == 3:
            raise Stopped("frame 3 took too long.")
        return advance(run)

    monkeypatch.setattr(Simulation, "_take_frame", stop_on_coarse_grids)
    goal = Goal.error("50%")
    if len(levels) < 3:
        with pytest.raises(InputError, match=r"no grid meets this target: on D/\d+ the simul"):
            run_for_goal(goal, ball(300), quick)
        return
    about = run_for_goal(goal, ball(300), quick).about
    assert (about["met"], about["levels"], about["stopped"]) == (True, levels, [6])
    assert "; D/6 left out, because the simulation stops early" in describe_goal(about, 1.0)


@pytest.mark.parametrize(
    ("wall", "region", "cells"), [(0.2, 0.5, 10), (0.4, 0.04, 20), (0.4, 0.5, 6)]
)
def test_first_grids_resolve_thin_walls_and_regions(quick, wall, region, cells):
    """A solid must be two cells thick, and a region must contain a particle."""
    box = {"kind": "box", "lower": [-1.0, -1.0, 0.0], "upper": [1.0, 1.0, wall]}
    centre = np.array([0.0, 0.0, 0.5 + wall])
    within = {"lower": (centre - region).tolist(), "upper": (centre + region).tolist()}
    push = {"kind": "acceleration", "a": [0.0, 1.0, 0.0], "region": within}
    changes = {"boundaries": [box], "forces": [push], "object.lift": wall}
    changes |= {"accuracy.cells": 20, "time.frames": 2}
    about = run_for_goal(Goal.error("50%"), ball(300), quick.replaced(changes)).about
    assert about["cells"] == about["levels"][0] == cells


def test_a_goal_out_of_reach_is_refused_with_what_is_in_reach(quick):
    with pytest.raises(
        InputError,
        match=r"no grid meets this target: even the grid D/24, which takes about .*, would ",
    ):
        run_for_goal(Goal.error("0.0001px"), ball(300), quick)


@pytest.mark.parametrize("goal", ["1.5%", "0.8%", "0.55%", "0.42%"])
def test_chosen_grid_has_few_more_cells_than_needed(quick, monkeypatch, goal):
    """The error is 0.1 / cells, so a goal needs 0.1 / goal cells."""

    def estimate(goal, runs):
        return choose.Convergence(1.0, tuple(0.1 / cells for cells in sorted(runs.done)))

    monkeypatch.setattr(choose, "_estimate", estimate)
    about = run_for_goal(Goal.error(goal), ball(300), quick.replaced({"time.frames": 2})).about
    needed = 0.1 / Goal.error(goal).value
    assert about["met"] and needed <= about["cells"] <= 1.5 * needed


def test_levels_are_refined_by_at_most_half(quick, monkeypatch):
    """Estimates that never fall end the search at the finest grid, not at a distant one."""
    monkeypatch.setattr(
        choose, "_estimate", lambda goal, runs: choose.Convergence(1.0, (0.02,) * len(runs.done))
    )
    scene = quick.replaced({"time.frames": 2})
    about = run_for_goal(Goal.error("1.4%"), ball(300), scene).about
    assert about["levels"] == [6, 8, 12, 16, 24]
    assert about["refined"] and not about["met"] and "even the grid D/24" in about["why_not"]


class Oracle:
    """Foretells seconds by formula."""

    def of(self, simulation) -> SimpleNamespace:
        cells = simulation.scene.resolution.cells
        seconds = 10 * (cells / 16) ** 2.5
        made = SimpleNamespace(seconds=seconds + 1, stages={"simulate": seconds}, caveat=None)
        made.with_measured = lambda name, seconds: made
        return made


def set_up(gaussians, scene, context, **options) -> SimpleNamespace:
    return SimpleNamespace(scene=scene, placed=None)


@pytest.mark.parametrize(
    ("preparing", "kept", "chosen"), [(0.0, 0.0, 64), (1.0, 3.0, 40), (8.0, 3.0, 0)]
)
def test_trial_of_a_finer_grid_leaves_time_for_the_best_one(preparing, kept, chosen):
    """Grids take long to prepare on lattices, where a simulation at 16 cells takes no time."""
    forecast = SimpleNamespace(seconds=1.1, stages={"simulate": 0.1})
    finer = [n for n in choose.CELLS if 16 < n <= 64]
    assert choose._choose_next(16, finer, preparing, forecast, 14.0, kept) == chosen


@pytest.mark.parametrize(("seconds", "cells"), [(8.0, 12), (13.0, 16), (36.0, 24), (80.0, 32)])
def test_a_time_goal_takes_the_finest_grid_that_fits(monkeypatch, seconds, cells):
    built = []

    class Run:
        def __init__(self, setup):
            self.scene = setup.scene
            built.append(setup.scene.resolution.cells)

        def run(self, each, *, record):
            return None

    monkeypatch.setattr(runs, "prepare", set_up)
    monkeypatch.setattr(runs, "Simulation", Run)
    reached = run_for_goal(Goal.time(seconds), ball(10), Scene(), forecaster=Oracle())
    assert reached.about["cells"] == cells
    assert reached.about["predicted"] <= seconds
    assert len(built) <= 6


@pytest.mark.parametrize(("limits", "cells"), [((8, 40), 40), ((8, 14), 14), ((20, 40), 40)])
def test_a_time_goal_avoids_grids_that_are_refused(monkeypatch, limits, cells):
    """The search begins at 16 cells, and would take 128 cells."""

    def prepare(gaussians, scene, context, **options):
        n = scene.resolution.cells
        if not limits[0] <= n <= limits[1]:
            refusal = InputError if n < limits[0] else TooFine
            raise refusal("accuracy.cells", n, "it is refused.", "Choose another grid.")
        return set_up(gaussians, scene, context)

    monkeypatch.setattr(runs, "prepare", prepare)
    monkeypatch.setattr(runs, "Simulation", lambda setup: SimpleNamespace(scene=setup.scene))
    assert reach_in(Goal.time(3600)) == cells
    with pytest.raises(InputError, match="it is refused"):
        limits = (200, 300)
        reach_in(Goal.time(3600))


@pytest.mark.parametrize(
    "goal", [Goal.error("50%"), pytest.param(Goal.time(1000), marks=pytest.mark.slow)]
)
def test_a_run_with_a_goal_is_watched_like_others(quick, goal, tmp_path, monkeypatch):
    monkeypatch.setattr(disk_space.shutil, "disk_usage", lambda path: SimpleNamespace(free=9))
    seen = []
    by_time = {"forecaster": Forecaster()} if goal.kind == "seconds" else {}
    with pytest.warns(UserWarning, match="of free space"):
        report = simulate(
            ball(300),
            quick,
            tmp_path,
            films=False,
            goal=goal,
            each=lambda run, frame: seen.append((run.scene.resolution.cells, frame.index)),
            **by_time,
        ).report
    assert seen == [(report["goal"]["cells"], index) for index in range(6)]
    assert ("forecast" in report) == bool(by_time)


def test_a_time_too_short_is_refused(monkeypatch):
    monkeypatch.setattr(runs, "prepare", set_up)
    monkeypatch.setattr(runs, "Simulation", lambda setup: SimpleNamespace(scene=setup.scene))
    with pytest.raises(InputError) as refusal:
        run_for_goal(Goal.time(0.5), ball(10), Scene(), forecaster=Oracle())
    # 10 s times 2^-2.5, 1 s that does not depend on the grid, and what is left free.
    assert str(refusal.value) == (
        "max_seconds = 0.5 s: the coarsest grid, D/8, takes about 3 s, most of it (2 s) for the "
        "simulation. Use --max-seconds 3; time.frames = 7 takes less."
    )
    assert reach_in(Goal.time(3)) == 8
    assert refusal.value.remedies[0].changes == {"time.frames": 7}


def reach_in(goal: Goal) -> int:
    scene, _ = choose.in_time(goal, ball(10), Scene(), forecaster=Oracle())
    return scene.resolution.cells


def test_advised_time_is_without_compilation(monkeypatch):
    """The advised command finds the kernels compiled."""

    def compile_first(setup) -> SimpleNamespace:
        if "compile" not in context.watch.seconds:
            context.watch.add({"compile": 50.0}, 50.0)
        return SimpleNamespace(scene=setup.scene)

    context = RunContext()
    monkeypatch.setattr(runs, "prepare", set_up)
    monkeypatch.setattr(runs, "Simulation", compile_first)
    with pytest.raises(InputError) as refusal:
        run_for_goal(Goal.time(0.5), ball(10), Scene(), context, forecaster=Oracle())
    assert "--max-seconds 3;" in refusal.value.remedy


def test_two_wishes_are_one_too_many(capsys):
    arguments = ["generate", "x.png", "--max-error", "2px", "--max-seconds", "3"]
    assert main(arguments) == 2
    assert "Give one of the two" in capsys.readouterr().err


def test_gaps_are_in_the_unit_of_the_goal(quick):
    a = Simulation(prepare(ball(300), quick.replaced({"accuracy": {"cells": 8}}))).run()
    means = a.means + np.float32(0.01) * np.array([0, 1, 0], np.float32)
    b = type(a)(means, a.quats, a.scales, a.opacities, a.sh, a.times, scene=a.scene)
    assert choose._distance(Goal.error("1%"), b, a, quick) == pytest.approx(0.01, rel=1e-3)
    assert choose._distance(Goal.error("1m"), b, a, quick) == pytest.approx(0.01, rel=1e-3)
    quick = quick.replaced({"view.fit": False})
    seen = choose._distance(Goal.error("1px"), b, a, quick)
    assert seen == pytest.approx(0.01 * 64 / (2 * np.tan(np.radians(24.55)) * 1.9), rel=0.1)
