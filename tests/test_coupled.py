"""Bodies on lattices together with bodies of the material point method (phy124/lattice/coupled)."""

import math
from dataclasses import replace

import numpy as np
import pytest

from phy124.boundaries import HalfSpace, Held
from phy124.forces import Gravity, Impulse, TotalForce
from phy124.lattice.clamps import acts_on
from phy124.lattice.coupled import CoupledSolver
from phy124.lattice.shock import STALLED
from phy124.lattice.surface import IN_EDGE, IN_TIP, ON_SURFACE, PROTRUSION
from phy124.materials import Fluid, NeoHookean
from phy124.mpm import Model, Pair, State
from phy124.particles.lattice import lattice_of
from phy124.pipeline.report_keys import Balance
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped, prepare
from phy124.studies.validation.bodies import lattice, surface_of_ball
from support.lattices import DX, block

pytestmark = pytest.mark.usefixtures("coarse_solids")

DAMPED = NeoHookean(E=1e5, nu=0.3, density=1000, damping=300.0)


def make(counts, low, solid, *, material=DAMPED, v=None, forces=(), boundaries=(), pairs=()):
    """Return a solver of a block of particles, body 0, and a solid on its lattice, body 1."""
    soft = np.asarray(low) + lattice(counts, DX / 2)
    points = lattice_of(solid, density=DAMPED.density, dx=DX)
    x = np.concatenate([soft, points.x]).astype(float)
    volume = np.concatenate([np.full(len(soft), (DX / 2) ** 3), points.volume])
    body = np.repeat([0, 1], [len(soft), len(points)])
    kind = {"body": body, "material": body, "wet": [1], "dx": DX, "precision": "float64"}
    kind["origin"] = (0, 0, -0.75 * DX)
    model = Model.of(x, volume, [material, DAMPED], **kind)
    motion = None if v is None else np.asarray(v, float)[body]
    surface = points.surface + [0, 0, 0, 0, 0, 0, 1, 0]
    state, acting = State.of(model, motion), {"forces": forces, "boundaries": boundaries}
    return CoupledSolver(
        model, surface, state, **acting, uniform=forces, walls=boundaries, pairs=pairs, threads=1
    )


def momenta(solver):
    """Return the momenta of the particles and of the nodes [2,3], kg m/s."""
    nodes, run = solver.lattice.nodes_state, solver.model.particles(0)
    moves = nodes.inverse.numpy() > 0
    of_nodes = (nodes.v.numpy()[moves] / nodes.inverse.numpy()[moves, None]).sum(axis=0)
    of_soft = solver.model.mass.numpy()[run] @ solver.state.v.numpy()[run]
    return np.array([of_soft, of_nodes])


def test_lattice_hits_particles_with_exact_momentum():
    moving = [(0, 0, 0), (-1, 0, 0)]
    solver = make((6, 6, 6), (0.2, 0.2, 0.2), block((0.3,) * 3, low=(0.6, 0.3, 0.3)), v=moving)
    before = momenta(solver)
    solver.pairs.begin()
    solver.advance(0.2)
    after = momenta(solver)
    assert np.allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-12 * 27, rtol=0)
    assert after[1, 0] > 0.7 * before[1, 0]
    (force, _), *_ = solver.pairs.wrenches(1.0).values()
    assert np.allclose(force, after[1] - before[1], rtol=0, atol=1e-9)


def test_points_in_edges_and_protrusions_do_not_touch_particles():
    """Points in edges lie inside the material, and protrusions are Gaussians outside it."""
    solid = block((0.3,) * 3, low=(0.6, 0.3, 0.3))
    solid = replace(solid, means=np.array([[0.75, 0.45, 0.3 - 0.5 * DX]], np.float32))
    solver = make((6, 6, 6), (0.2, 0.2, 0.2), solid)
    surface, (material,) = solver.lattice.surface, solver.lattice.guests
    assert {PROTRUSION, IN_EDGE} < set(surface.kind)
    assert set(surface.kind[material._mine]) <= {ON_SURFACE, IN_TIP}


def test_lattices_have_the_length_of_the_last_substep():
    """The strain rate of a squeezed point is divided by its shortening in the last substep."""
    moving, lengths = [(0, 0, 0), (-5, 0, 0)], []
    solver = make((6, 6, 6), (0.2, 0.2, 0.2), block((0.3,) * 3, low=(0.6, 0.3, 0.3)), v=moving)
    clocks = solver.clock, solver.lattice.clock
    solver.advance(0.05, after=lambda: lengths.append([clock.last_dt for clock in clocks]))
    of_particles, of_lattices = np.transpose(lengths)
    assert np.ptp(of_particles) > 0
    assert np.array_equal(of_particles, of_lattices)


def test_clamp_takes_the_push_of_particles_on_held_nodes():
    clamp = Held(lower=(0.7, -1, -1), upper=(2, 2, 2))
    solid = block((0.3,) * 3, low=(0.6, 0.3, 0.3))
    solver = make((6, 6, 6), (0.25, 0.3, 0.3), solid, v=[(1, 0, 0), (0, 0, 0)], boundaries=[clamp])
    solver.pairs.begin()
    solver.advance(0.1)
    (push, _), *_ = solver.pairs.wrenches(1.0).values()
    hold = solver.lattice.walls.sums.numpy()[0, :3]
    assert push[0] > 1
    assert np.allclose(push + hold, momenta(solver)[1], atol=1e-12 * push[0], rtol=0)


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_lattice_slides_on_particles(friction):
    angle, g = math.radians(20), 0.5
    pull = Gravity(g=(g * math.sin(angle), 0, -g * math.cos(angle)))
    floor = HalfSpace(contact="sticky")
    solid = block((0.375, 0.3, 0.3), low=(0.125, 0.1, 0.3), per=4)
    both = {"forces": [pull], "boundaries": [floor], "pairs": [Pair(0, 1, friction)]}
    solver = make((24, 10, 6), (0, 0, 0), solid, **both)
    solver.advance(0.8)
    before = momenta(solver)[1, 0]
    solver.advance(1.3)
    gained = (momenta(solver)[1, 0] - before) / 0.5 / 33.75 / g
    slides = friction < math.tan(angle)
    expected = math.sin(angle) - friction * math.cos(angle) if slides else 0.0
    assert gained == pytest.approx(expected, abs=1e-2)


def test_lattice_that_overlaps_particles_at_the_start_stays_at_rest():
    solver = make((10, 10, 8), (0.2, 0.2, 0), block((0.3,) * 3, low=(0.3, 0.3, 0.35)))
    solver.advance(0.1)
    assert solver.materials[0].most
    assert np.abs(momenta(solver)).max() < 1e-12


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_lattice_hangs_from_sticky_particles_near_which_it_starts(gap):
    """A clamp holds the upper half of the particles."""
    solid, clamp = block((0.3,) * 3, low=(0.3, 0.3, 0)), Held(lower=(-1, -1, 0.5), upper=(2, 2, 2))
    both = {"forces": [Gravity(g=(0, 0, -2.0))], "pairs": [Pair(0, 1, sticky=True)]}
    solver = make((10, 10, 8), (0.2, 0.2, 0.3 + gap * DX), solid, **both, boundaries=[clamp])
    solver.advance(0.4)
    solver.pairs.begin()
    solver.advance(0.8)
    (force, _), *_ = solver.pairs.wrenches(0.4).values()
    assert force[2] == pytest.approx(27 * 2.0, rel=0.03)
    x, rest = solver.lattice.state.x.numpy(), solver.lattice.model.rest
    assert np.abs(x - rest).max() < 0.1 * DX


@pytest.mark.parametrize("push", [TotalForce(f=(0, 30, 0)), Impulse(p=(0, 30, 0), duration=0.1)])
def test_total_accelerates_all_bodies_equally(push):
    solid = block((0.3,) * 3, low=(1.0, 0.3, 0.3))
    solver = make((6, 6, 6), (0.2, 0.2, 0.2), solid, forces=[push])
    solver.advance(0.2)
    soft, stiff = momenta(solver)[:, 1]
    share = solver.lattice.model.total_mass / solver.model.total_mass
    assert stiff == pytest.approx(share * (soft + stiff), rel=1e-9)


def test_viscosity_of_particles_limits_the_substep():
    honey = Fluid(viscosity=5000, density=1000)
    solid = block((0.3,) * 3, low=(1.0, 0.3, 0.3))
    solver = make((6, 6, 6), (0.2, 0.2, 0.2), solid, material=honey)
    limit = honey.viscous_limit(DX)
    assert 0.5 * limit < solver.clock.stable().dt <= limit


def test_short_substeps_of_stiff_particles_are_no_collapse():
    stiff = NeoHookean(E=1e12, density=1000)
    solver = make((4, 4, 4), (0.2, 0.2, 0.2), block((0.3,) * 3, low=(1, 0.3, 0.3)), material=stiff)
    solver.advance(0.9 * solver.lattice.limits.substep_at_rest)
    assert solver.clock.substeps > 2 * STALLED


def bury(**changes):
    """Return a scene in which sand falls on an elastic object on its lattice."""
    data = Scene.named("bury").data()
    data |= {"accuracy": {"cells": 6, "solver": "lattice"}, "wrenches": True, **changes}
    data["time"]["frames"] = 12
    return Scene.from_data(data)


def test_shapes_of_walls_depend_on_all_bodies():
    plates = [{"kind": "press"}, {"kind": "press", "object": "sand"}]
    scene = bury(boundaries=plates)
    solver = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1))).solver
    for plate in scene.boundaries:
        assert plate.geometry(solver.lattice.model) == plate.geometry(solver.model)
    assert not acts_on(plate, solver.lattice.model, solver.lattice.lattice.body).any()


def test_coupled_run_resumes_bit_for_bit_and_reports():
    setup = prepare(surface_of_ball(100), bury(), RunContext(threads=2))
    first = Simulation(setup)
    for _ in range(8):
        first.step()
    saved = first.snapshot()
    ahead = [first.step().gaussians.means for _ in range(2)]
    second = Simulation(setup)
    second.restore(saved)
    assert all(np.array_equal(second.step().gaussians.means, means) for means in ahead)
    report = first.report()
    assert report["balance"]["momentum_gain"] < 1e-5
    assert report["pairs"]["object_on_sand"]["largest_force"] > 0
    weight = 9.81 * setup.particles.mass.sum()
    assert report["walls"]["ground"]["largest_force"] > weight
    assert any("rest lattices" in row for row in report["effects"]["ran"])


def test_report_of_a_coupled_run_has_the_declared_keys():
    run = Simulation(prepare(surface_of_ball(100), bury(), RunContext(threads=1)))
    run.step()
    report = run.report()
    assert report["sleep"] is None
    assert report["balance"].keys() == Balance.__required_keys__


def test_held_lattice_pushes_another_lattice():
    shape = {"shape": "box", "sides": [1, 1, 0.4], "on": "floor", "material": DAMPED}
    table = {**shape, "name": "table", "size": 0.8, "place": [-2, 0], "held": True}
    plate = {**shape, "name": "plate", "size": 0.5, "place": [-2, 0], "on": "table"}
    sand = Scene.named("bury").data()["objects"][0] | {"on": "floor", "place": [3, 0], "size": 0.4}
    scene = bury(objects=[sand, table, plate])
    run = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1)))
    for _ in range(4):
        run.step()
    report = run.report()
    assert report["balance"]["momentum_gain"] < 1e-4
    weight = 9.81 * DAMPED.density * 0.5**3 * 0.4
    assert report["pairs"]["table_on_plate"]["largest_force"] > 0.5 * weight


def test_change_to_the_same_scene_keeps_the_balance():
    setup = prepare(surface_of_ball(100), bury(), RunContext(threads=1), changes=True)
    whole, changed = Simulation(setup), Simulation(setup)
    for index in range(10):
        whole.step()
        if index > 4:
            changed.change(setup.scene)
        changed.step()
    gains = [run.report()["balance"]["energy_gain"] for run in (whole, changed)]
    assert gains[0] == pytest.approx(gains[1], abs=1e-9)


def test_walls_of_one_kind_have_separate_wrenches():
    """A floor is listed before and after a wall of the same kind that nothing touches."""
    floor = {"kind": "half_space"}
    far = {**floor, "point": [0, 0, 50.0], "normal": [0, 0, -1]}
    for boundaries in ([floor, far], [far, floor]):
        scene = bury(boundaries=boundaries, wrenches=True)
        run = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1)))
        wrenches = [run.step().wrenches for _ in range(3)][-1]
        forces = [wrenches[name].force[2] for name in ("half_space", "half_space_2")]
        assert forces[boundaries.index(floor)] < 0 and forces[boundaries.index(far)] == 0


def test_rejected_substep_lists_the_surface_points_again():
    solid = block((0.3,) * 3, low=(0.6, 0.3, 0.3))
    solver = make((6, 6, 6), (0.2, 0.2, 0.2), solid, v=[(0, 0, 0), (-1, 0, 0)])
    solver.advance(0.02)
    (material,) = solver.materials
    material.due = True
    material._near = material._near[:0]
    before = solver._part.snapshot()
    for _ in range(2):
        solver._part.restore(before)
        assert material.due
        solver._scatter(0.0, solver.clock.last_dt)
        assert len(material._near) > 0


def test_retry_after_a_collapse_does_not_use_the_collapsed_substep(monkeypatch):
    run = Simulation(prepare(surface_of_ball(100), bury(), RunContext(threads=1)))
    solver, ceilings = run.solver, []

    def lose():
        if solver.clock.ceiling_name == "retry":
            ceilings.extend((solver.clock.ceiling, solver.lattice.clock.ceiling))
        solver.clock.last_dt = 1e-9
        return 3

    monkeypatch.setattr(solver.lattice.crew, "lost", lose)
    run.step()
    with pytest.raises(Stopped, match="turned inside out"):
        run.step()
    assert set(ceilings) == {solver.lattice.limits.substep_at_rest / 2}
