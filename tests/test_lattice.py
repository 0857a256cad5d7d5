"""Elastic bodies on their lattice at rest (phy124/lattice), against analytic cases."""

import math

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from phy124 import Live
from phy124.boundaries import Ground, HalfSpace, Held
from phy124.boundaries.motion import Path
from phy124.forces import Acceleration, Grab, Gravity, TotalForce, Wind
from phy124.forces.held import Part
from phy124.materials import Hencky, NeoHookean
from phy124.monitor.lattice import LatticeTotals
from phy124.mpm import FreeBody, Unstable
from phy124.mpm.tracks import Keyframes
from phy124.particles.solid import Solid
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball
from support.lattices import DX, SOFT, block, lattice_scene, make

pytestmark = pytest.mark.usefixtures("coarse_solids")


def test_damped_body_stays_sound_in_an_impact():
    """The rate of compression that shortens a substep also limits the next one."""
    damped = SOFT.model_copy(update={"damping": 50.0})
    solver = make(
        block((0.4, 0.4, 0.4), low=(0, 0, 0.05)),
        damped,
        v=(0, 0, -2 * damped.wave_speed()),
        boundaries=[HalfSpace(friction=0.3)],
        precision="float32",
    )
    solver.advance(0.03)
    assert np.linalg.det(solver.state.F.numpy()).min() > 0
    assert np.linalg.norm(solver.state.v.numpy(), axis=1).max() < 2 * damped.wave_speed()


def test_short_substeps_do_not_hide_an_impact():
    """A ball meets the floor at its speed of sound, while frames shorten all substeps."""
    line = (np.arange(16) - 7.5) ** 2
    round_mask = line[:, None, None] + line[:, None] + line <= 64
    ball = Solid(np.array([0, 0, 1]), DX / 4, round_mask.astype(np.float32))
    speed = SOFT.wave_speed()
    solver = make(ball, v=(0, 0, -speed), boundaries=[HalfSpace()])
    for frame in range(8):
        solver.advance(0.24 * DX / speed * (frame + 1))
    assert np.linalg.det(solver.state.F.numpy()).min() > 0.05


def test_damped_body_in_flight_is_measured_by_its_stress():
    damped = SOFT.model_copy(update={"damping": 50.0})
    solver = make(block((0.2, 0.2, 0.2)), damped, v=(0, 0, 4.0), precision="float32")
    solver.advance(0.1)
    name = f"stress {damped.device_law.name}"
    assert solver.clock.substeps > 10
    assert solver.timings[name][1] == solver.clock.substeps
    assert solver.timings["measure"][1] == 1


def test_free_swing_keeps_its_energy():
    solver = make(block((1.0, 0.2, 0.2)))
    lattice, nodes = solver.lattice, solver.nodes_state
    shape = np.cos(4.73 * lattice.x[:, 0]) + np.cosh(4.73 * lattice.x[:, 0] - 2.365) / 9
    nodes.v.assign(np.outer(shape - lattice.mass @ shape / lattice.mass.sum(), [0, 0, 0.5]))
    solver.follow()
    totals = LatticeTotals(solver)
    start = totals.read(solver.clock)
    solver.advance(3.0)
    end = totals.read(solver.clock)
    assert end.energy == pytest.approx(start.energy, rel=0.01)
    assert np.allclose(end.momentum, start.momentum, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("damping", "until"), [(1500.0, 3.0), pytest.param(300.0, 50.0, marks=pytest.mark.slow)]
)
def test_bar_stretched_four_times_comes_back(damping, until):
    """As the bar snaps back it buckles; its bending decays by a fifth to a half per second."""
    far = Held(
        lower=(0.85, -1, -1),
        upper=(2, 2, 2),
        end=0.8,
        motion=Path(times=(0.0, 0.8), points=((0, 0, 0), (3.0, 0, 0))),
    )
    near = Held(lower=(-1, -1, -1), upper=(0.15, 2, 2), end=1.0)
    damped = NeoHookean(E=1e5, nu=0.0, density=1000, damping=damping)
    solver = make(block((1.0, 0.2, 0.2)), damped, boundaries=[near, far])
    solver.advance(0.78)
    longer = np.ptp(solver.state.x.numpy()[:, 0]) - np.ptp(solver.model.rest[:, 0])
    assert longer == pytest.approx(3 * 0.78 / 0.8, abs=0.1)
    solver.advance(until)
    F = solver.state.F.numpy()
    stretch = np.linalg.svd(F, compute_uv=False)
    assert np.abs(stretch - 1).max() < 1e-3


def test_elastica_bends_right_at_two_cells():
    """Euler's elastica, with the shear of a thick beam: pushed in the middle and at the ends."""
    length, thick = 1.2, 0.2
    beam = NeoHookean(E=1e6, nu=0.0, density=1000)
    bending = 1e6 * 0.1 * thick**3 / 12
    load = bending / length**2
    omega = 3.516 * math.sqrt(bending / (1000 * 0.1 * thick)) / length**2
    slowly = Keyframes(times=(0.0, 6 / omega, 1e3), factors=(0.0, 1.0, 1.0))

    def push(at, force):
        region = Region(lower=(at - 0.051, -1, -1), upper=(at + 0.051, 1, 1))
        return TotalForce(f=(0, 0, force), region=region, profile=slowly)

    forces = [push(-1.2, -load), push(1.2, -load), push(0.0, 2 * load)]
    solid = block((2.5, 0.1, 0.2), low=(-1.25, 0, 0))
    solver = make(solid, beam, forces=forces)
    for k in range(60):
        solver.advance((k + 1) * 0.3 / omega)
        slower = math.exp(-2 * 0.3)
        solver.nodes_state.v.assign(solver.nodes_state.v.numpy() * slower)
    x, rest = solver.state.x.numpy(), solver.model.rest
    middle, tip = np.abs(rest[:, 0]) < 0.05, np.abs(np.abs(rest[:, 0]) - 1.2) < 0.05
    drop = (x[middle, 2].mean() - x[tip, 2].mean()) / length
    sheared = 0.3017 * (1 + 0.96 * (thick / length) ** 2)
    assert drop == pytest.approx(sheared, rel=0.01)


def test_forces_on_particles_give_their_momentum():
    region = Region(lower=(0.2, -1, -1), upper=(1, 1, 1))
    forces = [TotalForce(f=(0, 2.0, 0), region=region), Wind(v=(0, 0, 1), rate=0.5)]
    solver = make(block((0.4, 0.2, 0.2)), forces=forces)
    solver.advance(0.5)
    momentum = LatticeTotals(solver).read(solver.clock).momentum
    mass, late = 16.0, solver.clock.last_dt / 2
    assert momentum[2] == pytest.approx(mass * (1 - math.exp(-0.5 * (0.5 - late))), rel=1e-5)
    assert momentum[1] == pytest.approx(2.0 / 0.5 * (1 - math.exp(-0.5 * (0.5 - late))), rel=1e-2)


def test_a_hand_pulls_the_mass_of_the_nodes_that_follow_it():
    """A stiff damper gives the velocity of the hand to the part that it holds in one substep."""
    speed, options = (0.1, 0, 0), {"point": (0.4, 0.2, 0.2), "radius": 0.1}
    hand = Grab(times=(0, 1), targets=((0.4, 0.2, 0.2), (0.5, 0.2, 0.2)), **options)
    hand = hand.model_copy(update={"stiffness": 0.0, "damping": 1e8, "strength": 1e9})
    solver = make(block((0.4, 0.4, 0.4)), forces=[hand])
    mass = solver.model.mass.numpy()
    assert np.allclose(solver.lattice.respond(mass), 1)
    solver.step(1e-3, 0.0)
    solver.follow()
    part = Part.of(solver.model, options["point"], options["radius"], "point")
    chosen, share = part.chosen.numpy(), part.share.numpy()
    assert np.allclose(share @ solver.state.v.numpy()[chosen], speed, rtol=1e-3, atol=1e-6)


def test_a_uniform_push_deforms_nothing():
    """Light nodes have more mass than their points, and move like all others."""
    radius = np.linalg.norm(np.indices((10, 10, 10)) - 4.5, axis=0)
    solid = block((0.5, 0.5, 0.5))
    solid.fraction[radius > 4.7] = 0
    push = Acceleration(a=(4.0, 0, 0), region=Region(lower=(-9, -9, -9), upper=(9, 9, 9)))
    solver = make(solid, forces=[push])
    assert len(solver.lattice.tied)
    solver.advance(0.1)
    moved = solver.state.x.numpy() - solver.model.rest
    assert np.allclose(moved, [0.02, 0, 0], rtol=0, atol=1e-8)


def test_hencky_runs_on_its_lattice():
    solver = make(block((0.3, 0.2, 0.2)), Hencky(E=1e5, nu=0.3), v=(0, 0, -1), precision="float32")
    solver.bind(boundaries=[Ground()])
    solver.advance(0.05)
    assert np.linalg.det(solver.state.F.numpy()).min() > 0.5


def run(scene, threads=1):
    """Return a finished run of a ball."""
    setup = prepare(surface_of_ball(500), scene, RunContext(threads=threads))
    simulation = Simulation(setup)
    simulation.run()
    return simulation


def test_scene_runs_and_reports_its_solver():
    simulation = run(lattice_scene(frames=9))
    report = simulation.report()
    assert report["stopped"] is None
    assert report["balance"]["momentum_gain"] < 1e-6
    assert report["balance"]["energy_gain"] < 0.02
    assert any("rest lattice" in effect for effect in report["effects"]["ran"])
    assert any("self-contact" in row["effect"] for row in report["effects"]["left_out"])


@pytest.mark.parametrize("threads", [1, 2])
def test_lattice_resumes_bit_for_bit(threads):
    scene = lattice_scene(frames=9).replaced({"contacts": True})
    setup = prepare(surface_of_ball(500), scene, RunContext(threads=threads))
    first = Simulation(setup)
    for _ in range(6):
        first.step()
    saved = first.snapshot()
    ahead = [first.step() for _ in range(3)]
    second = Simulation(setup)
    second.restore(saved)
    for frame in ahead:
        again = second.step()
        assert np.array_equal(frame.gaussians.means, again.gaussians.means)
        assert np.array_equal(frame.contacts, again.contacts)
    assert ahead[-1].contacts.any()


def test_bind_in_mid_run_changes_no_bit():
    """A live run, whose forces are replaced by the same ones, equals a run that is left alone."""
    walls, forces = [Ground()], [Gravity()]
    place = {"place": (0.62, 0.1, 0.2), "velocity": (-0.5, 0, -1.5)}
    motions = []
    for live in (False, True):
        ball = FreeBody("ball", "sphere", (0.15,) * 3, **place)
        acting = {"forces": forces, "boundaries": walls, "planes": walls}
        solid = block((0.4, 0.3, 0.3), low=(0, 0, 0.05))
        solver = make(solid, v=(0.3, 0, -1), free=[ball], **acting)
        for frame in range(1, 11):
            solver.advance(0.02 * frame)
            if live:
                solver.bind(**acting)
        motions.append([solver.nodes_state.u.numpy(), *solver.free.poses()])
    for alone, bound in zip(*motions, strict=True):
        assert np.array_equal(alone, bound)


@pytest.mark.parametrize("speed", [45.0, 300.0])
def test_fast_free_solid_does_not_pass_through_a_body(speed):
    """Without the limit on the substep, the ball would move 1.1 or 7 cells in a substep."""
    plate = block((1, 1, 0.2), low=(-0.5, -0.5, 0))
    stiff = NeoHookean(E=5e5, nu=0.3, density=1000, damping=300.0)
    for gap in (0.1, 0.17):
        place = {"place": (0, 0, 0.35 + gap), "velocity": (0, 0, -speed)}
        ball = FreeBody("ball", "sphere", (0.15,) * 3, density=200, **place)
        solver = make(plate, stiff, free=[ball], precision="float32")
        inside = []

        def look(solver=solver, inside=inside):
            solver.follow()
            arm = solver.state.x.numpy() - solver.free.poses()[0, :3]
            inside.append(0.15 - np.linalg.norm(arm, axis=1).min())

        solver.advance(0.8 / speed, after=look)
        assert max(inside) < 0
        assert abs(solver.free.motions()[0, 2]) < speed / 3


def test_repetition_of_a_live_run_has_the_same_bounds():
    """Only the repetition knows from the start that a wall will move."""
    data = lattice_scene().data()
    data["boundaries"].append({"kind": "sphere", "centre": [0, -2, 0.5], "radius": 0.2})
    live = Live(surface_of_ball(), Scene.from_data(data), RunContext(threads=1))
    bounds, repeated = [], []
    for index in range(7):
        if index == 1:
            live.grab((0, 0, 1.2))
        elif index == 4:
            live.move(1, (0, 1, 0))
        live.step()
        bounds.append(live._run.solver.rejection.acceleration)
    again = Simulation(prepare(surface_of_ball(), live.session(), RunContext(threads=1)))
    for _ in bounds:
        again.step()
        repeated.append(again.solver.rejection.acceleration)
    assert repeated[2:] == bounds[2:]


def test_session_of_a_live_run_keeps_its_solver():
    """For the whole session, with its strong push, `auto` chooses MPM."""
    live = Live(surface_of_ball(), lattice_scene(solver="auto"), RunContext(threads=1))
    live.step()
    live.push((3e5, 0, 0), seconds=0.1)
    frames = list(live.frames(2))
    chosen = live.session()
    assert live._inputs.scene().solver == "mpm" and chosen.solver == "lattice"
    assert Scene.from_data(chosen.data()) == chosen
    clip = live.clip()
    assert np.array_equal(frames[-1].gaussians.means, clip.means[2])


def test_free_solid_set_in_fast_motion_does_not_pass_through():
    data = lattice_scene().data()
    data["object"]["lift"] = 0.0
    ball = {"shape": "sphere", "name": "ball", "on": "object", "size": 0.4, "lift": 0.1}
    data["objects"] = [{**ball, "motion": {"kind": "free"}}]
    live = Live(surface_of_ball(), Scene.from_data(data), RunContext(threads=1))
    list(live.frames(3))
    before = live.motions["ball"]
    live.set_motion("ball", before._replace(velocity=np.array([0, 0, -30.0])))
    list(live.frames(1))
    assert live.motions["ball"].place[2] > live.points["object"][:, 2].max() - DX / 4
    assert abs(live.motions["ball"].velocity[2]) < 3


def test_body_too_fast_for_any_substep_is_not_called_squeezed():
    solver = make(block((0.3, 0.3, 0.3)), v=(0, 0, 1e9))
    with pytest.raises(Unstable, match=r"^the motion is too fast: at 1e\+09 m/s, a substep would"):
        solver.advance(0.04)


def test_prongs_of_a_fork_do_not_pass_through_each_other():
    solid = block((0.9, 0.3, 0.9))
    solid.fraction[4:, :, 6:12] = 0  # A gap of three cells, between x = 0.2 and 0.9.
    damped = NeoHookean(E=1e5, nu=0.3, density=1000, damping=300.0)

    def push(low, force):
        region = Region(lower=(0.75, -1, low), upper=(2, 1, low + 0.35))
        return TotalForce(f=(0, 0, force), region=region)

    solver = make(solid, damped, forces=[push(-0.01, 120.0), push(0.59, -120.0)])
    surface = solver.surface
    along, height = surface.x[:, 0], surface.x[:, 2]
    lower, upper = ((along > 0.25) & (along < 0.89) & (abs(height - z) < 0.05) for z in (0.3, 0.6))
    gaps = []
    for k in range(6):
        solver.advance(0.1 * (k + 1))
        u = solver.nodes_state.u.numpy()[surface.nodes]
        x = surface.x + np.einsum("pk,pki->pi", surface.weights, u)
        above = LinearNDInterpolator(x[upper, :2], x[upper, 2])(x[lower, :2])
        gaps.append(np.nanmin(above - x[lower, 2]))
    assert gaps[0] > DX
    assert -0.3 * DX < min(gaps) < 0.1 * DX
    assert np.allclose(LatticeTotals(solver).read(solver.clock).momentum, 0, rtol=0, atol=1e-9)
