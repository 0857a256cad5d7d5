"""Runs that go wrong or take too long: tried again, stopped, and what the report says of it."""

import re

import numpy as np
import pytest

from phy124.io.clip import Clip
from phy124.mpm import Unstable
from phy124.mpm.timestep import CFL
from phy124.scene import Scene
from phy124.simulation import Simulation
from support.shapes import ball

QUICK = {"accuracy": {"cells": 8}, "time.frames": 5}


def run(**changes) -> Simulation:
    return Simulation(ball(300), Scene.named("push_right").replaced({**QUICK, **changes}))


def test_a_frame_that_fails_once_is_retried_from_its_start(monkeypatch):
    """Sabotage: the second frame fails until the substep is halved."""
    plain, s = run(), run()
    advance = s.solver.advance

    def fail_once(until, **options):
        advance(until, **options)
        if until > 0.05 and s.solver.clock.cfl > 0.5:
            raise Unstable("5 particles left the grid")

    monkeypatch.setattr(s.solver, "advance", fail_once)
    clip, usual = s.run(), plain.run()
    assert clip.report["complete"]
    assert clip.report["substep"]["retried"] == [2, 3, 4]
    assert s.solver.clock.cfl == CFL
    assert np.abs(clip.means - usual.means).max() < 1e-4


def test_a_frame_that_fails_twice_stops_and_keeps_the_good_ones(tmp_path, monkeypatch):
    """Sabotage: particles lose their numbers in the third frame."""
    s = run()
    advance = s.solver.advance

    def poison(until, **options):
        advance(until, **options)
        if until > 0.1:
            v = s.solver.state.v.numpy().copy()
            v[11] = np.inf
            s.solver.state.v.assign(v)

    monkeypatch.setattr(s.solver, "advance", poison)
    clip = s.run()
    assert len(clip) == 3
    assert not clip.report["complete"]
    stopped = clip.report["stopped"]
    assert "frame 3 is not sound" in stopped
    assert "number 11 of law neo_hookean" in stopped
    assert stopped.endswith("Use accuracy.cfl = 0.188.")
    assert clip.report["remedies"][0]["accuracy"]["cfl"] == pytest.approx(CFL / 4)
    clip.save(tmp_path / "c.safetensors")
    again = Clip.load(tmp_path / "c.safetensors")
    assert np.isfinite(again.means).all() and not again.report["complete"]


def test_first_non_finite_particle_is_named(monkeypatch):
    """Sabotage: the strain of one particle is lost within the third frame."""
    s = run()
    step = s.solver.step

    def poison(kick, drift):
        step(kick, drift)
        if s.solver.clock.time > 0.095:
            F = s.solver.state.F.numpy()
            F[150] = np.nan
            s.solver.state.F.assign(F)

    monkeypatch.setattr(s.solver, "step", poison)
    stopped = s.run().report["stopped"]
    assert "1 particles are NaN or infinite, first number 150 of law" in stopped


def test_graph_names_the_same_non_finite_particle(monkeypatch):
    """The graph loses its numbers at its next visit; the frame is repeated without it."""
    s = run()
    s.solver.on_device = True
    graph, step = s.solver._graph.run, s.solver.step
    visits = []

    def lost() -> None:
        if s.solver.clock.time > 0.095:
            F = s.solver.state.F.numpy()
            F[150] = np.nan
            s.solver.state.F.assign(F)

    def poisoned_graph(*given, **options):
        lost()
        visits.append(s.solver.clock.time)
        return graph(*given, **options)

    def poisoned_step(*given):
        step(*given)
        lost()

    monkeypatch.setattr(s.solver._graph, "run", poisoned_graph)
    monkeypatch.setattr(s.solver, "step", poisoned_step)
    stopped = s.run().report["stopped"]
    assert max(visits) > 0.095
    assert re.search(r"frame \d is not sound.* first number 150 of law", stopped)


def test_the_report_says_what_limited_the_substep():
    report = run(**{"time.substep": 1.0}).run().report
    assert report["substep"]["fractions"] == {"elastic": 1.0}
    assert report["substep"]["asked"] == 1.0 and report["substep"]["split"]
    assert set(report["balance"]) >= {"energy_gain", "momentum_gain", "min_J", "ballistic"}


def test_a_run_that_turns_out_endless_stops_by_itself(monkeypatch):
    s = run(**{"time.budget": 1e3})
    monkeypatch.setattr(
        "phy124.simulation.spent.time.thread_time", iter(range(0, 10**9, 500)).__next__
    )
    clip = s.run()
    stopped = clip.report["stopped"]
    assert re.search(r"time.budget: a substep is .+ s, limited by the stiffness of the", stopped)
    assert "fastest is number" in stopped
    assert len(clip) >= 1
