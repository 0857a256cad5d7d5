"""Live runs: inputs act from the next frame on, and become a scene."""

import json
import runpy

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.forces import WrenchForce
from phy124.lattice.solver import LatticeSolver
from phy124.live import Live
from phy124.live import inputs as live_inputs
from phy124.live.inputs import GrabRecord, Inputs
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from support.lives import GROUND, live, middle, scene, thing
from support.pages import ROOT

pytestmark = pytest.mark.usefixtures("coarse_solids")


def play(run: Live) -> list:
    """Half a second of everything a hand can do, and its frames."""
    frames = [run.step(), run.step()]
    run.grab((0, 0, 0.9))
    for step in range(4):
        run.move_to((0, 0.05 * step, 1.1))
        frames.append(run.step())
    run.release()
    run.push((200, 0, 0), torque=(0, 0, 50), seconds=0.1)
    run.move(1, (0, -0.4, 0))
    frames += run.frames(2)
    run.gravity((0, 0, -3))
    run.push((0, 50, 0), at=middle(frames[-1]) + (0, 0, 0.3), seconds=0.05)
    frames += run.frames(3)
    return frames


def test_session_replays_as_a_scene_bit_for_bit():
    run = live()
    frames = play(run)
    read = Scene.from_data(run.session().data())
    assert read == run.session() and read.time.frames == len(frames)
    clip = run.clip()
    for index, frame in enumerate(frames):
        assert np.array_equal(frame.gaussians.means, clip.means[index]), index
        assert np.array_equal(frame.gaussians.quats, clip.quats[index]), index
    assert clip.report["complete"] and not run.notes


def test_new_target_of_the_hand_replaces_only_a_track(monkeypatch):
    """The motion is that of a run that binds all forces and walls again."""

    def hold(run):
        bind, bound = run._run.solver.bind, []
        monkeypatch.setattr(run._run.solver, "bind", lambda **acting: bound.append(bind(**acting)))
        list(run.frames(2))
        run.grab((0, 0, 0.9))
        frames = []
        for step in range(20):
            run.move_to((0, 0.02 * step, 1.0))
            frames.append(run.step())
        run.release()
        return [*frames, run.step()], len(bound)

    frames, bound = hold(live())
    monkeypatch.setattr(LatticeSolver, "retarget", lambda *_: False)
    others, times = hold(live())
    assert bound <= 4 and times == 21
    for frame, other in zip(frames, others, strict=True):
        assert np.array_equal(frame.gaussians.means, other.gaussians.means)


def test_new_place_of_a_wall_replaces_only_its_tracks(monkeypatch):
    """A container with a free ball in it is moved; the run equals its repetition bit for bit."""
    box = {"kind": "container", "inside": {"lower": [-0.6, -0.6, 0], "upper": [0.6, 0.6, 2]}}
    ball = {"shape": "sphere", "name": "ball", "on": "object", "size": 0.5, "lift": 0.05}
    data = {"boundaries": [{"kind": "ground"}, box], "forces": [{"kind": "gravity"}]}
    data |= {"material": {"law": "neo_hookean"}, "objects": [{**ball, "motion": {"kind": "free"}}]}
    data["accuracy"] = {"cells": 6, "solver": "lattice"}
    bind, bound = LatticeSolver.bind, []
    run = Live(thing(), Scene.from_data(data), RunContext(threads=1))
    monkeypatch.setattr(LatticeSolver, "bind", lambda *a, **b: bound.append(bind(*a, **b)))
    frames = [run.step()]
    for step in range(12):
        run.move(1, (0, 0.04 * step, 0))
        frames.append(run.step())
    assert len(bound) <= 2
    clip = run.clip()
    assert all(np.array_equal(f.gaussians.means, clip.means[f.index]) for f in frames)
    assert run.centres["ball"][1] > 0.05


def test_live_run_keeps_only_acting_forces():
    inputs = Inputs(scene())
    for start in range(50):
        times = [0.0, *(np.arange(1, 24) / 24)]
        targets = [(0.0, np.sin(start + t), 1.0) for t in times]
        inputs.grabs.append(GrabRecord(start, {}, times, targets, start + 1.0))
        inputs.weigh((0, 0, -1 - start), start)
        inputs.soften(1 + start, start, start - 1 / 24)
    whole, now = inputs.scene(), inputs.scene(49.5)
    assert len(whole.forces) == 100 and len(whole.stiffness_profile.times) > 50
    assert [force.kind for force in now.forces] == ["gravity", "grab"]
    assert len(now.forces[-1].times) < 14 and len(now.stiffness_profile.times) == 2
    later = np.linspace(49.5, 51, 40)
    held, same = (some.forces[-1].target().values(later) for some in (whole, now))
    assert np.array_equal(held, same)


def test_work_of_a_push_does_not_grow_with_the_session(monkeypatch):
    """A controller sends a push in every frame; those that ended are stored and not looked at."""
    run, work = live(forces=[], boundaries=[]), []
    run.step()
    acts_after, count = live_inputs._acts_after, WrenchForce.model_copy
    monkeypatch.setattr(live_inputs, "_acts_after", lambda *of: work.append(1) or acts_after(*of))
    monkeypatch.setattr(WrenchForce, "__eq__", lambda *of: pytest.fail("pushes are compared"))
    monkeypatch.setattr(
        WrenchForce, "model_copy", lambda *of, **to: work.append(1) or count(*of, **to)
    )
    sizes = []
    for _ in range(30):
        work.clear()
        run.push((1, 0, 0), name="tool")
        run.push((1, 0, 0))
        run.step()
        sizes.append(len(work))
    assert len(run.session().forces) == 60 and max(sizes) <= 30


def test_grab_before_the_first_frame_acts_from_the_second():
    run = live()
    run.grab((0, 0, 0.9))
    run.move_to((0, 0, 1.2))
    assert not run.session().forces[len(run.scene.forces) :]
    start = middle(run.step())
    assert middle(run.step())[2] > start[2]
    assert run.session().forces[-1].kind == "grab"


def test_grabbed_object_follows_the_hand_and_falls_on_release():
    run = live(boundaries=[], **{"material.E": 1e6})  # stiff enough for a pull of three weights
    run.step()
    run.grab((0, 0, 1.0))
    frames = []
    for frame in run.frames(64):
        run.move_to((0.2, 0.3, 1.6))
        frames.append(frame)
    # It swings below the hand, with a period of 36 frames. The point held is below the hand by the
    # weight over the spring's stiffness.
    sag = run.limits.weight / run.limits.stiffness
    swing = np.mean([middle(each) for each in frames[-36:]], axis=0)
    assert np.allclose(swing[:2], (0.2, 0.3), atol=0.02)
    assert swing[2] == pytest.approx(1.6 - sag - 0.5, abs=0.1)
    run.release()
    assert run.session().forces[-1].end == pytest.approx(run.time, abs=1e-9)
    start = middle(run.step())
    fallen = list(run.frames(6))[-1]
    assert middle(fallen)[2] < start[2] - 0.2


def test_a_push_gives_the_momentum_of_its_force_and_time():
    run = live(forces=[], boundaries=[])
    run.step()
    run.push((60, 0, 0), seconds=0.1)
    frames = list(run.frames(5))
    speed = np.linalg.norm(middle(frames[-1]) - middle(frames[-2])) * 24
    assert speed == pytest.approx(60 * 0.1 / run.limits.mass, rel=1e-3)


def test_a_push_takes_the_place_of_the_one_before_it_of_its_name():
    run = live(forces=[], boundaries=[])
    run.step()
    for _ in range(4):
        run.push((60, 0, 0), seconds=10, name="tool")
        run.step()
    run.push((0, 0, 0), name="tool")
    frames = [run.step()]
    start = run.centre
    frames += [run.step() for _ in range(3)]
    # It has acted for four frames, once at a time.
    speed = (run.centre - start)[0] / 3 * 24
    assert speed == pytest.approx(60 * 4 / 24 / run.limits.mass, rel=1e-3)
    assert len(run.session().forces) == 5
    assert np.array_equal(run.clip().means[-1], frames[-1].gaussians.means)


def test_gravity_changes_at_once_and_a_wall_moves_at_hand_speed():
    run = live(boundaries=GROUND, **{"object.lift": 0.5})
    falls = [middle(frame)[2] for frame in run.frames(4)]
    run.gravity((0, 0, -4))
    floats = [middle(frame)[2] for frame in run.frames(3)]
    run.gravity((0, 0, 9.81))
    rises = [middle(frame)[2] for frame in run.frames(3)]
    # The second difference of places is the acceleration times the square of the time.
    for places, expected in ((falls, -9.81), (floats, -4), (rises, 9.81)):
        assert np.diff(places, 2)[-1] * 24**2 == pytest.approx(expected, abs=0.05)
    run.move(1, (0, 0, 4))
    run.step()
    path = run.session().boundaries[1].motion
    assert path.points[-1][2] == pytest.approx(5 / 24)


def test_the_wrench_on_the_ground_is_the_weight_of_what_rests():
    run = live(**{"object.lift": 0.0, "material.damping": 30.0})
    down = [run.step() and run.contacts()["ground"].force[2] for _ in range(40)]
    swings = np.average(down[10:], weights=np.hanning(32)[1:-1])  # whole swings or not
    assert swings == pytest.approx(-run.limits.weight, rel=0.02)


def test_contacts_before_the_first_frame_are_empty():
    run = live(**{"object.lift": 0.0})
    assert run.contacts() == {}
    run.step()
    assert run.contacts()
    run.reset()
    assert run.contacts() == {}


def test_live_run_keeps_only_the_poses_that_it_draws():
    run = live()
    list(run.frames(5))
    assert len(run._run.poses) <= 2


def test_liquid_flows_while_inputs_are_possible():
    accuracy = {"cells": 8, "liquid": "projection"}
    run = live(material={"law": "fluid"}, accuracy=accuracy, boundaries=[{"kind": "ground"}])
    heights = [run.centre[2] for _ in run.frames(4)]
    assert heights[0] - heights[-1] == pytest.approx(9.81 * (3 / 24) ** 2 / 2, rel=0.02)
    frames = list(run.frames(36))  # It spreads to a layer of one cell.
    assert not run.notes and frames[-1].index == 39


def test_external_binding_gets_motion_without_shapes():
    shaped, bare = live(), Live(thing(), scene(), RunContext(threads=1), shapes=False)
    for run in (shaped, bare):
        run.step()
        run.grab((0, 0, 0.9))
        run.move_to((0, 0.3, 1.2))
    frames = [(shaped.step(), bare.step()) for _ in range(3)]
    # Not even a snapshot binds Gaussians to particles, which takes longer than some frames.
    assert not bare._run.snapshot()["deformer"] and "deformer" not in vars(bare._run)
    for single, other in zip(shaped.particles, bare.particles, strict=True):
        assert np.array_equal(single, other)
    felt = [run.contacts()["ground"].force for run in (shaped, bare)]
    assert np.array_equal(*felt)
    first, last = frames[0][1].gaussians, frames[-1][1].gaussians
    assert np.array_equal(first.means, last.means) and not np.array_equal(
        first.means, frames[-1][0].gaussians.means
    )


@pytest.mark.slow
def test_session_of_the_example_is_read(tmp_path, monkeypatch, capsys):
    (tmp_path / "demo").symlink_to(ROOT / "demo")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(ROOT / "docs/examples/12_live.py"))
    assert "real time" in capsys.readouterr().out
    session = Scene.named("out/live/session.toml")
    assert session.time.frames == 49 and {f.kind for f in session.forces} >= {"grab", "wrench"}


@pytest.mark.slow
def test_the_notebook_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    cells = json.loads((ROOT / "docs/guide/live.ipynb").read_text("utf-8"))["cells"]
    names: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert "37 frames" in capsys.readouterr().out
    ways = [middle(frame)[1] for frame in names["frames"]]
    assert max(ways) > ways[0] + 0.1
    assert names["strip"].size == (192 * 7, 192)


def test_softness_changes_next_frame_and_replays():
    run = live(**{"object.lift": 0.0})
    run.step()
    run.grab((0, 0, 1.0))
    frames = []
    for index in range(8):
        if index in (2, 3, 5):
            run.soften({2: 0.2, 3: 0.1, 5: 30.0}[index])
        run.move_to((0, 0, 1.25))
        frames.append(run.step())
    stretched = [np.ptp(frame.gaussians.means[:, 2]) for frame in frames]
    assert stretched[4] > stretched[1] + 0.03 > stretched[7], "softer, then stiffer"
    session = Scene.from_data(run.session().data())
    assert [session.softness(index / 24) for index in range(9)] == [
        1,
        1,
        0.2,
        0.1,
        0.1,
        30.0,
        30.0,
        30.0,
        30.0,
    ]
    clip = run.clip()
    for index, frame in enumerate(frames):
        assert np.array_equal(frame.gaussians.means, clip.means[index + 1]), index
    assert clip.report["complete"] and not run.notes
    assert clip.report["balance"]["energy_gain"] < 0, "stiffening a bent thing is work"
    for wrong in (0, 1e30, float("nan"), None):
        with pytest.raises(InputError, match=r"from 0\.01 to 100"):
            run.soften(wrong)
