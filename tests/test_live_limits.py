"""Inputs of live runs are bounded, and runs go on if a frame fails."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.live import Live, engine
from phy124.simulation import Stopped
from support.lives import GROUND, live, middle

pytestmark = pytest.mark.usefixtures("coarse_solids")


def test_a_frame_that_fails_drops_the_inputs_and_goes_on(monkeypatch):
    run = live()
    list(run.frames(14))
    run.push((0, 0, 100), seconds=10)
    run.step()
    sound, fails = type(run._run).step, iter([True, True, False])

    def step(self):
        if next(fails, False):
            raise Stopped("frame 15 is not valid.", ())
        return sound(self)

    monkeypatch.setattr(type(run._run), "step", step)
    frame = run.step()
    # It failed without the push, too, so it went back to the state kept after 12 frames.
    assert frame.index == 12 and "frame 15 is not valid" in run.notes[0]
    assert not [f for f in run.session().forces if f.kind == "wrench"]
    assert np.isfinite(frame.gaussians.means).all()


@pytest.mark.parametrize(("broken", "pushed"), [(1, False), (14, False), (14, True)])
def test_a_run_ends_if_it_fails_from_the_start(monkeypatch, broken, pushed):
    run = live()
    sound = type(run._run).step

    def step(self):
        if self.count == broken:
            raise Stopped(f"frame {broken} is not valid.")
        return sound(self)

    monkeypatch.setattr(type(run._run), "step", step)
    run.step()
    if pushed:
        run.push((1, 0, 0), seconds=0.01)
    with pytest.raises(Stopped, match=f"frame {broken} is not valid. .* without inputs"):
        list(run.frames(40))
    assert len(run.notes) < 6
    assert ("starts again" in " ".join(run.notes)) == pushed


def test_frames_that_need_too_many_substeps_drop_the_inputs(monkeypatch):
    monkeypatch.setattr(engine, "SLOWEST", 3)
    run = live()
    run.step()
    run.push(torque=(0, 1e9, 0), seconds=9)
    taken = []
    for _ in range(6):
        before = run._run.solver.clock.substeps
        run.step()
        taken.append(run._run.solver.clock.substeps - before)
    assert "needs more than" in " ".join(run.notes) and "too violent" in " ".join(run.notes)
    assert max(taken) <= run._run.most_substeps < 50
    run.push((1, 0, 0))
    run.soften(100)
    before = run._run.most_substeps
    run.step()
    assert run._run.most_substeps == pytest.approx(10 * before, rel=0.2), "it is ten times stiffer"


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda run: run.grab((np.nan, 0, 0)), "grab.point"),
        (lambda run: run.grab((50, 0, 0)), "grab.point"),
        (lambda run: run.grab((0, 0, 0.9), radius=0), "grab.radius"),
        (lambda run: run.move_to((0, 0, 0)), "move_to"),
        (lambda run: run.push("north"), "push.force"),
        (lambda run: run.push((1, 0, 0), seconds=-1), "push.seconds"),
        (lambda run: run.push((1, 0, 0), at=(0, 9, 0)), "push.at"),
        (lambda run: run.gravity((0, 0, np.inf)), "gravity"),
        (lambda run: run.move(7, (0, 0, 0)), "move.wall"),
        (lambda run: run.move(2, (0, 0, 0)), "move.wall"),
        (lambda run: run.move(True, (0, 0, 0)), "move.wall"),
    ],
)
def test_impossible_inputs_are_refused_and_the_run_continues(call, field):
    swings = {"kind": "sphere", "centre": [0, 0.8, 0.2], "motion": {"kind": "swing"}}
    run = live(boundaries=[*GROUND, swings])
    run.step()
    with pytest.raises(InputError) as refused:
        call(run)
    assert refused.value.field == field and refused.value.remedy
    assert np.isfinite(run.step().gaussians.means).all()


def test_excessive_inputs_are_reduced_and_reported():
    run = live()
    run.step()
    run.push((1e30, 0, 0), seconds=0.01)
    run.grab((0, 0, 0.9))
    run.move_to((0, 0, 2.3e11))
    for frame in run.frames(5):
        assert np.isfinite(frame.gaussians.means).all()
    assert len(run.notes) == 2 and "reduced to the limit" in run.notes[0]
    for _ in range(30):
        run.push((1, 0, 0), seconds=9)
    run.push((1, 0, 0), seconds=9)
    with pytest.raises(InputError, match="push"):
        run.push((1, 0, 0), seconds=9)
        run.push((1, 0, 0), seconds=9)


def test_torque_spins_a_rim_no_faster_than_force_pushes():
    limits = live().limits
    (force, _, _), said = limits.force("push.force", (1e30, 0, 0))
    (torque, _, _), also = limits.torque("push.torque", (1e30, 0, 0))
    inertia = 0.4 * limits.mass * (limits.size / 2) ** 2  # of a solid ball
    rim = torque / inertia * limits.size / 2
    assert rim == pytest.approx(force / limits.mass) and said and also


def test_run_restarts_if_the_object_flies_away():
    run = live(boundaries=[])
    run.step()
    run.gravity((1e9, 0, 0))
    frames = list(run.frames(30))
    ways = [middle(frame)[0] for frame in frames]
    assert 20 < max(ways) < 60 and frames[-1].index < 30
    assert "starts again" in run.notes[-1] and run.time < 1


@pytest.mark.parametrize("inputs", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_random_hands_never_break_it(inputs):
    rng, run = np.random.default_rng(7), live()
    extremes = [0.0, -1.0, 1e-30, 1e9, 1e30, -1e30, np.nan, np.inf]

    def value() -> float:
        return float(rng.choice(extremes) if rng.random() < 0.5 else rng.normal())

    def triple() -> tuple:
        return value(), value(), value()

    calls = [
        lambda: run.grab(triple()),
        lambda: run.move_to(triple()),
        run.release,
        lambda: run.push(triple(), torque=triple(), seconds=value()),
        lambda: run.push(triple(), at=triple()),
        lambda: run.gravity(triple()),
        lambda: run.move(int(rng.integers(-1, 3)), triple()),
        lambda: run.grab(middle(run.step()) + 0.4 * rng.normal(size=3), radius=0.5),
    ]
    for _ in range(inputs):
        try:
            calls[rng.integers(len(calls))]()
        except InputError as refused:
            assert refused.remedy
        if rng.random() < 0.5:
            assert np.isfinite(run.step().gaussians.means).all()


@pytest.mark.parametrize("liquid", ["projection", "compressible"])
def test_liquids_refuse_to_soften_and_the_run_continues(liquid):
    accuracy = {"cells": 8, "liquid": liquid}
    run = live(material={"law": "fluid"}, accuracy=accuracy, boundaries=GROUND[:1])
    run.step()
    with pytest.raises(InputError, match=r"^soften = 2: the stiffness of .* cannot be changed"):
        run.soften(2)
    run.step()
    with pytest.raises(InputError, match=r"Give the number of a boundary: 0 \(ground\)\."):
        run.move("ground", (0, 0, 1))


def swing(run: Live) -> None:
    """Hold the top and draw it to and fro by 0.3 m in each frame."""
    run.step()
    run.grab((0, 0, 1.0))
    for step in range(4):
        run.move_to((0, 0.3 if step % 2 else -0.3, 1.0))
        run.step()


def test_a_hand_pulls_soft_material_slower_than_sound():
    soft = live(**{"material.E": 2e4})
    swing(soft)
    assert not soft.notes and soft.holds, "with three weights it would drop the inputs"
    assert soft.session().forces[-1].strength < 2 * soft.limits.weight
    stiff = live(**{"material.E": 1e6})
    swing(stiff)
    assert stiff.session().forces[-1].strength == pytest.approx(3 * stiff.limits.weight)
