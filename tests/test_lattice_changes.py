"""Runs on lattices whose walls are replaced."""

import numpy as np
import pytest

from phy124.boundaries import HalfSpace
from phy124.forces import Gravity
from phy124.kernels.work import IMPULSE
from phy124.mpm import FreeBody
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball
from support.lattices import DAMPED, DX, block, make

FAR = HalfSpace(point=(0, 0, 50.0), normal=(0, 0, -1))


@pytest.mark.parametrize("contact", ["separate", "sticky"])
def test_walls_keep_their_contact_when_other_walls_change(contact):
    """A block and a free ball land on a floor, whose place in the list changes."""
    floor, pull = HalfSpace(contact=contact), [Gravity(g=(0, 0, -9.81))]
    lists = [([FAR, floor], [floor]), ([floor], [FAR, floor]), ([FAR, floor], [floor, FAR])]
    for first, last in lists:
        motions = []
        for changed in (False, True):
            ball = FreeBody("ball", "box", (0.15,) * 3, place=(0.8, 0.1, 0.16))
            acting = {"boundaries": first, "planes": first}
            solid = block((0.4, 0.4, 0.4), (0, 0, 0.02))
            solver = make(solid, DAMPED, v=(0.3, 0, -1), forces=pull, free=[ball], **acting)
            solver.advance(0.2)
            if changed:
                solver.bind(forces=pull, boundaries=last, planes=last)
            solver.advance(0.3)
            motions.append([solver.nodes_state.u.numpy(), solver.free.poses()])
        for alone, other in zip(*motions, strict=True):
            assert np.array_equal(alone, other)


def test_new_wall_holds_points_that_are_near_it_at_that_time():
    """A block falls by three cells past a ceiling that appears later, above its present top."""
    pull, top = [Gravity(g=(0, 0, -2.0))], 0.4 - 3 * DX
    solver = make(block((0.4, 0.4, 0.4)), DAMPED, forces=pull)
    solver.advance((2 * 3 * DX / 2.0) ** 0.5)
    held = {"normal": (0, 0, -1), "contact": "sticky"}
    solver.bind(forces=pull, boundaries=[HalfSpace(point=(0, 0, top + 0.4 * DX), **held)])
    for time in (2.5, 3.0):
        before = solver.walls.sums.numpy()[0].copy()
        solver.advance(time)
    force = (solver.walls.sums.numpy()[0] - before)[IMPULSE + 2] / 0.5
    assert force == pytest.approx(64 * 2.0, rel=0.01)
    fallen = (solver.model.rest - solver.state.x.numpy())[:, 2].mean()
    assert fallen == pytest.approx(3 * DX, abs=0.5 * DX)
    solver.bind(forces=pull, boundaries=[HalfSpace(point=(0, 0, 0.4 + 0.4 * DX), **held)])
    solver.advance(3.5)
    assert solver.walls.sums.numpy()[0][IMPULSE + 2] == 0


def test_report_and_clip_contain_walls_that_come_and_go(tmp_path):
    """A ball falls on a floor that is later the first in the list, then the second again."""
    floor = {"kind": "half_space"}
    far = {**floor, "point": [0, 0, 50.0], "normal": [0, 0, -1]}
    data = {"material": {"law": "neo_hookean", "E": 3e4, "damping": 50.0}, "wrenches": True}
    data |= {"accuracy": {"cells": 8, "solver": "lattice"}, "forces": [{"kind": "gravity"}]}
    data |= {"time": {"frames": 9, "sleep": False}, "checks": {"energy": True}}
    both, alone, ground = (
        Scene.from_data({**data, "boundaries": walls})
        for walls in ([far, floor], [floor], [{"kind": "ground"}])
    )
    setup = prepare(surface_of_ball(100), both, RunContext(threads=1), changes=True)
    run = Simulation(setup)
    for _, scene in zip(range(6), (both, both, alone, alone, ground, ground), strict=True):
        if scene is not run.scene:
            run.change(scene)
        run.step()
    path = tmp_path / "pause.safetensors"
    resume.save(run, path)
    for each in (run, resume.load(path)):
        each.step()
        clip = each.clip()
        assert clip.walls == ("half_space", "half_space_2", "ground")
        pressed = clip.wrenches[1:, :, 0, 2] < 0
        assert pressed.argmax(axis=1).tolist() == [1, 0, 0, 2, 2, 2] and pressed.sum() == 6
        walls = clip.report["walls"]
        assert all(row["largest_force"] > 0 for row in walls.values()) and len(walls) == 3
        energy, balance = clip.report["energy"], clip.report["balance"]
        assert abs(energy["unexplained"]) < 1e-5 * energy["turnover"]
        assert balance["momentum_gain"] < 1e-5
