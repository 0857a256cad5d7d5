"""Contact of bodies on their lattices with each other (phy124/lattice), against analytic cases."""

import math

import numpy as np
import pytest

from phy124.boundaries import Ground, HalfSpace, Held
from phy124.forces import Gravity
from phy124.kernels.work import IMPULSE
from phy124.lattice.partners import Partners
from phy124.lattice.workers import Division
from phy124.monitor.lattice import LatticeTotals
from phy124.mpm import FreeBody, Pair
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import fill_solid, surface_of_ball
from support.lattices import DAMPED, DX, block, fork_at, lattice_scene, make_bodies

pytestmark = pytest.mark.usefixtures("coarse_solids")


def test_the_most_viscous_body_limits_substeps():
    solids = [block((0.3, 0.3, 0.3)), block((0.3, 0.3, 0.3), low=(1, 0, 0))]
    soft, stiff = (
        DAMPED.model_copy(update={"E": E, "damping": d}) for E, d in ((1e4, 5e3), (4e4, 1))
    )
    solvers = [
        make_bodies(solids[:1], soft),
        make_bodies(solids, soft, stiff),
        make_bodies(solids, stiff, soft),
    ]
    for solver in solvers:
        solver.limits.measure_if_due()
    alone, *both = (solver.clock.stable().dt for solver in solvers)
    assert both == pytest.approx([alone, alone], rel=0.1)


def momentum_of(solver, body):
    """Return the momentum of a body's nodes [3], kg m/s."""
    nodes = solver.nodes_state
    moves = (solver.lattice.body == body) & (nodes.inverse.numpy() > 0)
    v, inverse = (array.numpy()[moves].astype(float) for array in (nodes.v, nodes.inverse))
    return (v / inverse[:, None]).sum(axis=0)


def ball(x, y, z, radius=0.3):
    """Return a solid ball."""
    centre = np.array([x, y, z])
    low, high = centre - radius - 0.05, centre + radius + 0.05
    return fill_solid(lambda at: np.linalg.norm(at - centre, axis=-1) - radius, low, high, DX / 2)


def extent_of(solver, body, end):
    """Return the mean height of a body's lowest (0) or highest (-1) layer of points [m]."""
    span = solver.model.particles(body)
    rest, z = solver.model.rest[span, 2], solver.state.x.numpy()[span, 2]
    return z[rest == np.sort(rest)[end]].mean()


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_block_slides_on_a_block(friction):
    angle, g = math.radians(20), 0.5
    pull = Gravity(g=(g * math.sin(angle), 0, -g * math.cos(angle)))
    solids = [block((1.0, 0.5, 0.2)), block((0.375, 0.3, 0.3), low=(0.125, 0.125, 0.2), per=4)]
    solver = make_bodies(solids, held=[0], pairs=[Pair(0, 1, friction)], forces=[pull])
    solver.advance(0.7)
    before = momentum_of(solver, 1)[0]
    solver.advance(1.2)
    gained = (momentum_of(solver, 1)[0] - before) / 0.5 / 33.75 / g
    slides = friction < math.tan(angle)
    expected = math.sin(angle) - friction * math.cos(angle) if slides else 0.0
    assert gained == pytest.approx(expected, abs=2e-3)
    down = solver.model.rest[-1, 2] - solver.state.x.numpy()[-1, 2]
    assert abs(down) < 0.02 * DX


@pytest.mark.parametrize("held", [(), (1,)])
def test_bodies_that_overlap_at_the_start_stay_at_rest(held):
    solids = [block((0.4, 0.4, 0.4), low=(0, 0, z), per=10) for z in (0, 0.37)]
    solver = make_bodies(solids, held=held)
    solver.advance(0.1)
    assert solver.meetings.of_pairs[0].most
    assert np.abs(solver.state.v.numpy()).max() < 1e-12


def test_block_keeps_its_depth_while_it_slides_on_a_board():
    board = block((1.2, 0.8, 0.2), low=(-0.2, -0.2, -0.2), per=10)
    solids = [board, block((0.4, 0.4, 0.3), low=(0, 0, -0.03), per=10)]
    pull, pairs = Gravity(g=(0, 0, -2.0)), [Pair(0, 1, 0.0)]
    solver = make_bodies(solids, v=[(0, 0, 0), (1, 0, 0)], held=[0], pairs=pairs, forces=[pull])
    solver.advance(0.4)
    way = (solver.state.x.numpy() - solver.model.rest)[solver.model.particles(1)].mean(axis=0)
    assert way == pytest.approx([0.4, 0, 0], abs=0.02 * DX)


@pytest.mark.parametrize(("width", "shift"), [(0.4, 0.0), (0.4, 0.025), (0.3, 0.0), (0.2, 0.05)])
def test_block_slides_freely_on_a_board_as_wide_as_itself(width, shift):
    """The board's edges must not stop the edges of the block."""
    board = block((1.2, width, 0.2), low=(-0.2, shift, -0.2), per=4)
    solids, pull = [board, block((0.4, width, 0.3), low=(0, shift, 0), per=4)], (0, 0, -2.0)
    moving = {"v": [(0, 0, 0), (1, 0, 0)], "pairs": [Pair(0, 1, 0.0)]}
    solver = make_bodies(solids, held=[0], forces=[Gravity(g=pull)], **moving)
    before = momentum_of(solver, 1)[0]
    solver.advance(0.3)
    kept = momentum_of(solver, 1) / before
    assert kept == pytest.approx([1, 0, 0], abs=0.01)


def test_solid_box_leaves_a_block_at_rest_that_it_overlaps():
    box = FreeBody("box", "box", (0.2,) * 3, (0.2, 0.2, 0.55))
    solver = make_bodies([block((0.4, 0.4, 0.4))], free=[box])
    solver.advance(0.1)
    assert np.abs(solver.free.motions()).max() == 0 == np.abs(solver.state.v.numpy()).max()


@pytest.mark.parametrize("solid_moves", [True, False])
def test_a_block_and_a_solid_that_are_moved_together_stay_at_rest(solid_moves):
    box, still = FreeBody("box", "box", (0.2,) * 3, (0.2, 0.2, 0.6)), (0, 0, 0)
    solver = make_bodies([block((0.4, 0.4, 0.4))], free=[box])
    solver.advance(0.01)
    if solid_moves:
        solver.free.put(0, ((0.2, 0.2, 0.55), (1, 0, 0, 0), still, still))
        solver.clock.expire()
    else:
        solver.carry_nodes(lambda x, v: (x + [0, 0, 0.05], v))
    solver.advance(0.1)
    assert np.abs(solver.free.motions()).max() < 1e-12
    assert np.abs(solver.state.v.numpy()).max() < 1e-12


@pytest.mark.parametrize("gap", [0.0, 0.4, 0.7])
def test_block_hangs_from_a_sticky_block_near_which_it_starts(gap):
    low = block((0.4, 0.4, 0.4), per=10)
    board = block((0.6, 0.6, 0.2), low=(-0.1, -0.1, 0.4 + gap * DX), per=10)
    pairs, pull = [Pair(0, 1, sticky=True)], Gravity(g=(0, 0, -2.0))
    solver = make_bodies([low, board], held=[1], pairs=pairs, forces=[pull])
    saved = solver.snapshot()
    solver.advance(0.01)
    solver.restore(saved)  # As in a liquid, which tries each step first.
    solver.advance(0.5)
    solver.bind(forces=[pull])
    solver.advance(1.0)
    solver.pairs.begin()
    solver.advance(1.5)
    (force, _), *_ = solver.pairs.wrenches(0.5).values()
    assert force[2] == pytest.approx(-64 * 2.0, rel=0.01)
    sunk = (solver.model.rest - solver.state.x.numpy())[solver.model.particles(0), 2].mean()
    assert sunk == pytest.approx(1000 * 2.0 * 0.4**2 / 3 / DAMPED.E, abs=0.02 * DX)


def test_block_hangs_on_while_another_block_is_moved():
    ceiling = HalfSpace(point=(0, 0, 0.4 + 0.4 * DX), normal=(0, 0, -1), contact="sticky")
    blocks = [block((0.4, 0.4, 0.4), low=(x, 0, 0)) for x in (0, 1)]
    solver = make_bodies(blocks, forces=[Gravity(g=(0, 0, -2.0))], boundaries=[ceiling])
    solver.advance(0.5)
    solver.carry_nodes(lambda x, v: (x - [0, 0, 0.3], v), 1)
    solver.advance(1.0)
    fallen = (solver.model.rest - solver.state.x.numpy())[:, 2]
    assert fallen[solver.model.particles(1)].min() > 0.3
    assert fallen[solver.model.particles(0)].max() < 0.5 * DX


@pytest.mark.parametrize(("shape", "gap"), [("box", 0.4), ("sphere", 0.0), ("sphere", 0.5)])
def test_free_solid_hangs_from_a_sticky_block_near_which_it_starts(shape, gap):
    place = (0.2, 0.2, -0.15 - gap * DX)
    solid = FreeBody("solid", shape, (0.15,) * 3, place, density=500.0, sticky=True)
    clamp, pull = Held(lower=(-1, -1, 0.2), upper=(1, 1, 1)), Gravity(g=(0, 0, -2.0))
    solver = make_bodies([block((0.4, 0.4, 0.4))], free=[solid], forces=[pull], boundaries=[clamp])
    solver.advance(0.5)
    solver.free.begin()
    solver.advance(1.0)
    assert solver.free.wrenches(0.5)[0].force[2] == pytest.approx(2.0 * solid.mass, rel=0.02)
    assert solver.free.poses()[0, 2] == pytest.approx(place[2], abs=0.1 * DX)


def test_glued_blocks_turn_together():
    """Two blocks start 0.4 cells apart and turn about the middle between them."""
    solids = [block((0.4, 0.4, 0.4), low=(x, 0, 0), per=10) for x in (0, 0.44)]
    solver, middle = make_bodies(solids, pairs=[Pair(0, 1, sticky=True)]), np.array([0.42, 0.2, 0])
    for body in range(2):
        solver.carry_nodes(lambda x, v: (x, np.cross([0, 0, 2.0], x - middle)), body)
    totals = LatticeTotals(solver)
    before = totals.read(solver.clock)
    solver.advance(math.pi / 2)
    after = totals.read(solver.clock)
    assert after.angular == pytest.approx(before.angular, abs=1e-4 * before.angular[2])
    spans = [solver.model.particles(body) for body in range(2)]
    x, rest = solver.state.x.numpy(), solver.model.rest
    way, old = (np.subtract(*(points[span].mean(axis=0) for span in spans)) for points in (x, rest))
    assert way == pytest.approx(-old, abs=0.2 * DX)


@pytest.mark.parametrize("precision", ["float64", pytest.param("float32", marks=pytest.mark.slow)])
def test_balls_exchange_momentum_exactly(precision):
    balls = [ball(0, 0, 0), ball(0.72, 0.13, 0.05)]
    solver = make_bodies(balls, v=[(0.5, 0, 0), (-0.5, 0, 0)], precision=precision)
    totals = LatticeTotals(solver)
    before, left = totals.read(solver.clock), momentum_of(solver, 0)
    solver.advance(1.0)
    after = totals.read(solver.clock)
    rounding = 1e-14 if precision == "float64" else 3e-7
    scale = np.linalg.norm(left)
    assert np.allclose(after.momentum, before.momentum, atol=rounding * scale, rtol=0)
    assert np.allclose(after.angular, before.angular, atol=2e-3 * 0.3 * scale, rtol=0)
    assert momentum_of(solver, 0)[0] < -0.5 * left[0]
    (force, _), *_ = solver.pairs.wrenches(1.0).values()
    assert np.allclose(-force, momentum_of(solver, 0) - left, atol=1e-6 * scale, rtol=0)


def test_stack_of_three_stands():
    solids = [block((0.4, 0.4, 0.2), low=(0, 0, 0.2 * k)) for k in range(3)]
    pull = Gravity(g=(0, 0, -2.0))
    solver = make_bodies(solids, held=[0], forces=[pull])
    solver.advance(1.5)
    before = solver.meetings.snapshot()
    solver.bind(forces=[pull])
    after = solver.meetings.snapshot()
    before, after = (kept["of_pairs"]["0"]["force"] for kept in (before, after))
    assert np.array_equal(after, before)
    assert len(after)
    before = solver.state.x.numpy()
    solver.advance(2.0)
    assert np.abs(solver.state.x.numpy() - before).max() < 0.01 * DX
    for below in range(2):
        gap = extent_of(solver, below + 1, 0) - extent_of(solver, below, -1)
        assert gap == pytest.approx(2 * (0.5 - 0.5 / math.sqrt(3)) * DX, abs=0.05 * DX)


def test_pairs_resume_bit_for_bit_and_are_reported():
    """A soft ball falls on another one, and a solid on it."""
    data = lattice_scene(frames=8).data()
    data["object"] |= {"name": "base", "lift": 0.0}
    ball = {"name": "ball", "on": "base", "lift": 0.02, "material": data["material"]}
    solid = {"name": "solid", "shape": "sphere", "size": 0.5, "on": "ball", "lift": 0.01}
    solid |= {"motion": {"kind": "free"}}
    scene = Scene.from_data({**data, "objects": [ball, solid]})
    setup = prepare(surface_of_ball(100), scene, RunContext(threads=2))
    first = Simulation(setup)
    for _ in range(6):
        first.step()
    saved = first.snapshot()
    ahead = [first.step().gaussians.means for _ in range(2)]
    second = Simulation(setup)
    second.restore(saved)
    assert all(np.array_equal(second.step().gaussians.means, means) for means in ahead)
    report = first.report()
    assert report["pairs"]["base_on_ball"]["largest_force"] > 0
    assert report["pairs"]["ball_on_solid"]["largest_force"] > 0
    assert report["balance"]["momentum_gain"] < 1e-6
    assert any("contact between objects" in row for row in report["effects"]["ran"])


def test_solid_ball_exchanges_momentum_exactly():
    ball_of_steel = FreeBody("ball", "sphere", (0.2,) * 3, (0.65, 0.25, 0.2), velocity=(-1, 0, 0))
    solver = make_bodies([block((0.4, 0.4, 0.4))], free=[ball_of_steel])
    start = ball_of_steel.mass
    solver.advance(0.3)
    left = ball_of_steel.mass * solver.free.motions()[0, :3]
    assert left[0] > -0.5 * start
    assert np.allclose(momentum_of(solver, 0) + left, [-start, 0, 0], rtol=0, atol=1e-12 * start)
    assert np.allclose(
        solver.free.impulses()[:3], momentum_of(solver, 0), rtol=0, atol=1e-12 * start
    )


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_solid_box_slides_on_a_block(friction):
    angle, g = math.radians(20), 0.5
    pull = Gravity(g=(g * math.sin(angle), 0, -g * math.cos(angle)))
    box = FreeBody("box", "box", (0.15,) * 3, (0.3, 0.25, 0.35), friction=friction)
    floor = HalfSpace(contact="sticky")
    solver = make_bodies([block((1.0, 0.5, 0.2))], free=[box], forces=[pull], boundaries=[floor])
    solver.advance(0.7)
    before = solver.free.motions()[0, 0]
    solver.advance(1.2)
    gained = (solver.free.motions()[0, 0] - before) / 0.5 / g
    slides = friction < math.tan(angle)
    expected = math.sin(angle) - friction * math.cos(angle) if slides else 0.0
    assert gained == pytest.approx(expected, abs=5e-3)


def test_block_stands_on_a_solid_box_on_the_ground():
    box = FreeBody("box", "box", (0.3, 0.3, 0.1), (0.2, 0.2, 0.1), density=300.0)
    solid, ground = block((0.4, 0.4, 0.4), low=(0, 0, 0.2)), Ground()
    pull = Gravity(g=(0, 0, -2.0))
    solver = make_bodies([solid], free=[box], forces=[pull], boundaries=[ground], planes=[ground])
    solver.advance(1.0)
    solver.free.begin()
    solver.advance(1.5)
    assert np.allclose(solver.free.poses()[0, :3], box.place, atol=1e-6)
    assert solver.free.wrenches(0.5)[0].force[2] == pytest.approx(-128.0, rel=5e-3)
    assert extent_of(solver, 0, 0) == pytest.approx(solver.model.rest[:, 2].min(), abs=0.05 * DX)


def test_self_contact_next_to_a_clamp_keeps_its_momentum():
    """Two prongs of a fork, whose root a clamp holds, are slammed together."""
    fork = fill_solid(fork_at, (-0.1, -0.1, -0.1), (0.5, 0.3, 0.9), DX / 2)
    clamp = Held(lower=(-1, -1, -1), upper=(1, 1, 0.28))
    solver = make_bodies([fork], boundaries=[clamp])
    solver.carry_nodes(lambda x, v: (x, v - 6 * np.sign(x - [0.2, 0, 0]) * [1, 0, 0]))
    before = momentum_of(solver, 0)
    solver.advance(0.1)
    counted = solver.walls.sums.numpy()[0][IMPULSE : IMPULSE + 3]
    assert momentum_of(solver, 0) - before == pytest.approx(counted, abs=1e-8)
    assert solver.meetings.of_bodies[0].most > 0


def test_points_that_hardly_moved_are_not_compared_again(monkeypatch):
    solver = make_bodies([ball(0, 0, 0)])
    solver.advance(1e-3)
    meetings, compared = solver.meetings, []
    monkeypatch.setattr(meetings.of_bodies[0], "follow", compared.append)
    for way, times in ((0.5 * DX, 0), (0.7 * DX, 1)):
        meetings.way = way
        meetings.follow(0.0)
        assert len(compared) == times
    assert meetings.way == 0


def thin_sheets(**options):
    """Return a solver of two sheets, half a cell thick, a tenth of a cell from each other, and the
    search for their contact.
    """
    solid = block((0.4, 0.4, 0.5), per=4)
    solid.fraction[:, :, 2:-2] = 0
    solver = make_bodies([solid], **options)
    upper = solver.lattice.x[:, 2] > 0.25
    solver.nodes_state.u.assign(np.outer(upper, [0, 0, -0.39]))
    division = Division(solver.model, solver.runner.team)
    return solver, Partners(solver.surface, solver.model, solver.nodes_state, division)


def test_threads_divide_the_search_among_themselves():
    searches = []
    for threads in (1, 3):
        solver, partners = thin_sheets(threads=threads)
        sample = np.arange(0, solver.surface.count, 2)
        flagged = partners.flagger(sample, between=False)(solver.surface.x[sample])
        searches.append([flagged, *partners.find(sample, between=False).values()])
    assert len(searches[0][1]) > 50
    for alone, divided in zip(*searches, strict=True):
        assert np.array_equal(alone, divided)


@pytest.mark.parametrize("between", [False, True])
def test_simd_and_plain_flags_agree(between):
    flags = []
    for vectors in (True, False):
        solver, partners = thin_sheets(vectors=vectors, precision="float32")
        sample = np.arange(0, solver.surface.count, 3)
        x = solver.surface.x[sample]
        upper = x[:, 2] > 0.25
        solver.surface.body[sample[upper]] = int(between)
        moved = x - np.outer(upper * x[:, 0], [0, 0, 0.9])
        flags.append(partners.flagger(sample, between=between)(moved))
    assert 0 < flags[0].sum() < len(flags[0])
    assert np.array_equal(*flags)


def test_outer_sides_of_thin_parts_do_not_meet():
    solver, partners = thin_sheets()
    surface = solver.surface
    pairs = partners.find(np.arange(surface.count), between=False)
    x = surface.x - np.outer(surface.x[:, 2] > 0.25, [0, 0, 0.39])
    gaps = ((x[pairs["a"]] - x[pairs["b"]]) * pairs["normal"]).sum(axis=1)
    assert len(gaps) > 100
    assert gaps.min() > -0.05 * DX  # The outer sides are 1.1 cells behind each other.


def test_clamp_may_hold_two_bodies_that_touch():
    solids = [block((0.3, 0.3, 0.3)), block((0.3, 0.3, 0.3), low=(0, 0.3, 0))]
    clamp = Held(lower=(0.2, -1, -1), upper=(1, 1, 1))
    solver = make_bodies(
        solids, v=[(0, 0, 0), (0, -0.3, 0)], boundaries=[clamp], pairs=[Pair(0, 1, 0.3)]
    )
    solver.advance(0.02)
    assert solver.meetings.of_pairs[0].most
    assert np.abs(solver.state.v.numpy()).max() < 0.6
