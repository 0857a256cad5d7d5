"""The benchmark that measures errors for the expected errors: tests/benchmarks/zoo.py."""

import sys

from support.pages import ROOT
from support.shapes import ball

sys.path.append(str(ROOT / "tests/benchmarks"))  # last, since a program there is called bridge

import zoo


def test_zoo_has_distances_of_all_complete_runs(monkeypatch):
    complete, simulate = iter([True, False, True]), zoo.Simulation.run

    def stop_some(run):
        clip = simulate(run)
        return clip.with_report({**clip.report, "complete": next(complete)})

    monkeypatch.setattr(zoo.Simulation, "run", stop_some)
    scene = zoo.scene_of("spin").replaced({"time.frames": 3})
    row = zoo.measured(ball(200), scene, (4, 5, 6))
    assert [run["complete"] for run in row["runs"]] == [True, False, True]
    assert row["levels"] == [4, 6] and len(row["apart"]) == 1
    assert row["apart"][0][0] == 0 and 0 < row["apart"][0][-1] < 0.1
    particles = [run["particles"] for run in row["runs"]]
    assert particles == sorted(particles) and particles[0] < particles[-1]
