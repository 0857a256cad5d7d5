"""Elastic bodies on their lattice at rest (phy124/lattice), against analytic cases."""

import math

import numpy as np
import pytest
import warp as wp
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import KDTree

from phy124.boundaries import Ground, HalfSpace, Held
from phy124.boundaries.motion import Path
from phy124.forces import Acceleration, Grab, Gravity, TotalForce, Wind
from phy124.forces.held import Part
from phy124.kernels.lattice import points
from phy124.kernels.lattice.stress import CLOSING, GRADIENT, SPEED
from phy124.kernels.work import IMPULSE, WORK
from phy124.lattice import impulses, material, solids, workers
from phy124.lattice import walls as lattice_walls
from phy124.lattice.phases import MEASURE, TRIAL
from phy124.lattice.rest import RestLattice
from phy124.lattice.solver import LatticeSolver
from phy124.materials import Hencky, NeoHookean
from phy124.monitor.lattice import LatticeTotals
from phy124.mpm import FreeBody, Model, State
from phy124.mpm.tracks import Keyframes
from phy124.particles.lattice import integration_points, lattice_of, surface_points
from phy124.particles.solid import Solid
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import fill_solid, surface_of_ball
from phy124.studies.validation.experiments.pressed_block import stress

DX = 0.1
SOFT = NeoHookean(E=1e5, nu=0.3, density=1000)


def block(size, low=(0, 0, 0), per=2, dx=DX):
    """Return a solid box; all lengths are multiples of dx / per."""
    counts = [round(length * per / dx) for length in size]
    first = np.array([round(x * per / dx) for x in low])
    return Solid(first, dx / per, np.ones(counts, np.float32))


def make(solid, material=SOFT, *, v=None, C=None, precision="float64", **options):
    """Return a solver of a solid's lattice."""
    points = lattice_of(solid, density=material.density, dx=DX)
    x = points.x.astype(np.float64)
    model = Model.of(x, points.volume, [material], dx=DX, precision=precision)
    motion = None if v is None else np.tile(np.asarray(v, float), (len(x), 1))
    options = {"threads": 1, **options}
    return LatticeSolver(model, points.surface, State.of(model, motion, C), **options)


def test_full_cells_have_gauss_points():
    x, volume = integration_points(block((0.2, 0.1, 0.1)), DX)
    offset = np.abs(x[:8] - 0.05)
    assert np.allclose(offset, DX / (2 * math.sqrt(3)))
    assert np.allclose(volume, DX**3 / 8)


def test_points_of_full_cells_have_one_order():
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    x, volume = integration_points(solid, DX)
    full = np.isclose(volume.reshape(-1, 8).sum(axis=1), DX**3)
    cells = x.reshape(-1, 8, 3)[full]
    assert np.allclose(cells - cells[:, :1], (cells - cells[:, :1])[0])


def test_cut_cells_keep_volume_centre_and_moments():
    solid = block((0.25, 0.35, 0.075), low=(0.075, 0.05, 0.025), per=4)
    x, volume = integration_points(solid, DX)
    low, size = np.array([0.075, 0.05, 0.025]), np.array([0.25, 0.35, 0.075])
    assert np.isclose(volume.sum(), size.prod())
    centre = volume @ x / volume.sum()
    assert np.allclose(centre, low + size / 2)
    second = np.einsum("p,pi,pj->ij", volume, x - centre, x - centre) / volume.sum()
    assert np.allclose(second, np.diag(size**2 / 12), atol=1e-12)


def test_grids_of_which_one_is_twice_as_fine_share_their_voxels():
    rough = Solid(np.zeros(3, int), 0.051, np.linspace(0, 1, 64).reshape(4, 4, 4))
    assert rough.resample(0.1).voxels is rough.resample(0.05).voxels
    fresh = Solid(rough.first, rough.voxel, rough.fraction).resample(0.1)
    assert np.array_equal(fresh.voxels.spread, rough.resample(0.05).voxels.spread)


@pytest.mark.parametrize(("thick", "degrees"), [(0.5, 20), (0.5, 45), (1.0, 20), (1.0, 45)])
def test_turned_plates_keep_their_moments(thick, degrees):
    """Plates of 0.5 and 1 cells on voxels of half a cell, as the pipeline makes them."""
    half = np.array([0.6, 0.2, thick * DX / 2])
    angle, middle = math.radians(degrees), np.array([0.013, 0.02, 0.031])
    turn = np.array([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, 0]])
    turn[2, 2] = math.cos(angle)

    def distance(x):
        return (np.abs((x - middle) @ turn) - half).max(axis=-1)

    reach = np.abs(turn) @ half
    solid = fill_solid(distance, middle - reach, middle + reach, DX / 2)
    x, volume = integration_points(solid, DX)
    place = (x - middle) @ turn
    inner = np.abs(place[:, 0]) < 0.4
    second = volume[inner] @ place[inner, 2] ** 2 / volume[inner].sum()
    assert second == pytest.approx((thick * DX) ** 2 / 12, rel=0.08)


def test_surface_points_lie_on_a_box():
    rows = surface_points(block((0.4, 0.3, 0.3)), DX)
    out = np.maximum(-rows[:, :3], rows[:, :3] - (0.4, 0.3, 0.3))
    assert np.allclose(out.max(axis=1), 0)
    assert {tuple(x) for x in np.round(rows[:, :3], 9)} >= {(0.4, 0.3, 0.3)}


@pytest.mark.parametrize("side", [1.27, 1.52])
def test_voxels_larger_than_cells_keep_the_substep(side):
    """If voxels lay across cells, some nodes would have stiffness but hardly any mass."""
    steps = (np.arange(-5, 5) + 0.5) * side * DX
    distance = np.linalg.norm(np.stack(np.meshgrid(steps, steps, steps)), axis=0)
    filled = np.clip((0.42 - distance) / (side * DX) + 0.5, 0, 1).astype(np.float32)
    ball = Solid(np.full(3, -5), side * DX, filled).resample(DX / 2, per_cell=2)
    usual = make(block((0.8, 0.8, 0.8))).substep_at_rest
    assert make(ball).substep_at_rest > 0.9 * usual


@pytest.mark.parametrize("per", [1.3, 1.7, 2.3, 3.1])
def test_surface_points_cover_a_ball_of_resampled_voxels(per):
    radius, fine = 0.42, DX / per
    steps = (np.arange(-20, 20) + 0.5) * fine
    distance = np.linalg.norm(np.stack(np.meshgrid(steps, steps, steps)), axis=0)
    filled = np.clip((radius - distance) / fine + 0.5, 0, 1).astype(np.float32)
    ball = Solid(np.full(3, -20), fine, filled).resample(DX / 2)
    rows = surface_points(ball, DX)
    away = np.linalg.norm(rows[:, :3], axis=1) - radius
    assert np.abs(away).max() < 0.2 * DX
    rng = np.random.default_rng(1)
    around = rng.normal(size=(2000, 3))
    around *= radius / np.linalg.norm(around, axis=1, keepdims=True)
    gap, _ = KDTree(rows[:, :3]).query(around)
    assert gap.max() < 0.6 * DX


def test_frequency_without_a_trial_stays():
    solver = make(block((0.2, 0.2, 0.2)))
    square = solver.spectrum.square
    solver.spectrum._shape.zero_()
    solver.spectrum.follow()
    assert solver.spectrum.square == square


def test_needle_has_surface_points():
    """A needle fills 1 % of each of its cells."""
    solid = block((1.0, 0.01, 0.01), dx=0.02)
    assert len(surface_points(solid, DX)) > 10
    tip = block((1.0, 0.02, 0.01), dx=0.02)  # fills 2 % of each cell; haze fills less than 0.5 %
    assert len(surface_points(tip, DX)) >= len(surface_points(solid, DX))


def test_sharp_parts_touch_with_their_inner_points():
    for size, inner in (((0.4, 0.4, 0.4), False), ((0.4, 0.03, 0.03), True)):
        solver = make(block(size, low=(0.05, 0.05, 0.05), per=20))
        bare = ~solver.surface.normal.any(axis=1)
        assert bare.any() == inner
        rest = KDTree(solver.model.rest)
        assert not bare.any() or rest.query(solver.surface.x[bare])[0].max() < 1e-6


def test_ties_extrapolate_linear_motions():
    solid = block((0.35, 0.325, 0.325), low=(0.075, 0.075, 0.0875), per=8)
    x, volume = integration_points(solid, DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    assert len(lattice.tied) > 10
    assert np.allclose(lattice.ties @ lattice.x, lattice.x[lattice.tied])
    assert np.isclose(lattice.mass.sum(), volume.sum())
    assert np.allclose(lattice.mass @ lattice.x, volume @ x)


def test_light_nodes_get_mass_from_heavy_ones():
    solid = block((0.35, 0.325, 0.325), low=(0.075, 0.075, 0.0875), per=8)
    x, volume = integration_points(solid, DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    assert lattice.mass[lattice.mass > 0].min() > 0.0199 * DX**3


def test_ties_leave_no_node_without_mass():
    rng = np.random.default_rng(47)
    fraction = (rng.random((7, 7, 7)) < 0.35).astype(np.float32)
    fraction *= rng.random((7, 7, 7)).astype(np.float32)
    x, volume = integration_points(Solid(np.zeros(3, int), DX / 2, fraction), DX)
    lattice = RestLattice.of(x, volume, volume, DX)
    free = np.setdiff1d(np.arange(len(lattice)), lattice.tied)
    assert lattice.mass[free].min() > 0


def test_sliver_at_a_corner_joins_the_cell_behind_it():
    """By itself it would hang on one node, and its own nodes would have no mass and no ties."""
    fraction = np.zeros((6, 6, 6), np.float32)
    fraction[:4, :4, :4] = 1
    fraction[3, 3, 3], fraction[4, 4, 4] = 0.3, 0.003
    x, volume = integration_points(Solid(np.zeros(3, int), DX, fraction), DX)
    assert volume.reshape(-1, 8).sum(axis=1).min() > 0.3 * DX**3
    assert len(x) == 8 * 4**3
    lattice = RestLattice.of(x, volume, volume, DX)
    assert lattice.mass[lattice.mass > 0].min() > 1e-3 * DX**3


@pytest.mark.parametrize(
    ("damping", "speed", "shock"),
    [(0, 0.2, False), (0, 0.3, True), (300, 0.3, True), (400, 0.25, False)],
)
def test_slow_motion_of_flat_material_is_no_shock(damping, speed, shock):
    """The sides of a cell squeezed to a tenth approach at `speed` times the speed of sound."""
    solver = make(block((0.4, 0.3, 0.3)), SOFT.model_copy(update={"damping": damping}))
    flat = np.diag([1, 1, 0.1]) - np.eye(3)
    rate = speed * SOFT.wave_speed() / DX
    solver.nodes_state.u.assign(solver.lattice.x @ flat)
    solver.nodes_state.v.assign(solver.lattice.x * [0, 0, -rate])
    solver.measure_if_due()
    assert solver.clock.in_shock == shock


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


def test_frequency_follows_a_squeezed_body():
    solver = make(block((0.4, 0.3, 0.3)))
    squeezed = 0.5
    solver.nodes_state.u.assign((squeezed - 1) * solver.lattice.x)
    at_rest = solver.spectrum.square
    for _ in range(30):
        solver.workers[0].run(solver.workers[0].phases[0])
        solver._measure_frequency()
    # dP/ds of mu (s - 1/s) + lam log(J) / s along each axis, with J = s^3.
    lam, mu = 0.3 / (1.3 * 0.4), 1 / 2.6
    stiffer = mu * (1 + 1 / squeezed**2) + lam * (1 - math.log(squeezed**3)) / squeezed**2
    assert solver.spectrum.square / at_rest == pytest.approx(stiffer / (lam + 2 * mu), rel=0.15)


def test_measured_damping_covers_the_fastest_decay():
    solver = make(block((0.4, 0.3, 0.3)), SOFT.model_copy(update={"damping": 200.0}))
    spectrum = solver.spectrum
    assumed = 2 * spectrum._delay * spectrum._least
    start = np.random.default_rng(1).normal(size=(solver.nodes, 3))
    start[solver.lattice.tied] = 0
    spectrum._shape.assign(start)
    largest = spectrum._iterate(0.0, 150, velocities=solver.nodes_state.v)
    assert largest < assumed < 1.25 * largest


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
    assert np.allclose(end.momentum, start.momentum, atol=1e-12)


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


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_block_on_a_slope_obeys_friction(friction):
    angle = math.radians(20)
    g = 0.5
    pull = Gravity(g=(g * math.sin(angle), 0, -g * math.cos(angle)))
    damped = NeoHookean(E=1e5, nu=0.3, density=1000, damping=300.0)
    ground = Ground(friction=friction)
    solver = make(block((0.4, 0.3, 0.3)), damped, forces=[pull], boundaries=[ground])
    totals = LatticeTotals(solver)
    solver.advance(1.0)
    before = totals.read(solver.clock)
    solver.advance(2.0)
    gained = totals.read(solver.clock).momentum[0] - before.momentum[0]
    slides = math.sin(angle) - friction * math.cos(angle)
    expected = max(slides, 0.0) if friction < math.tan(angle) else 0.0
    assert gained / 36 / g == pytest.approx(expected, abs=2e-3)
    assert solver.state.x.numpy()[:, 2].min() > 0.015


@pytest.mark.parametrize("contact", ["separate", "sticky", "slip"])
def test_undamped_block_stands_still_at_a_wall(contact):
    """Gravity acts at once; a slip wall holds the block against it."""
    up = -1.0 if contact == "slip" else 1.0
    floor = HalfSpace(contact=contact)
    solver = make(block((0.6, 0.6, 0.6)), forces=[Gravity(g=(0, 0, -9.0 * up))], boundaries=[floor])
    solver.advance(2.0)
    bottom = solver.model.rest[:, 2] < DX
    moved = (solver.state.x.numpy() - solver.model.rest)[bottom].mean(axis=0)
    assert abs(moved[2]) < 0.2 * DX
    assert contact == "slip" or np.abs(moved[:2]).max() < 0.1 * DX
    assert np.abs(solver.state.v.numpy()).max() < 0.6


def test_pressed_block_has_the_exact_force():
    """A block between smooth walls on five sides is pressed by 1 % within 0.2 s."""
    walls = [HalfSpace(normal=tuple(np.eye(3)[axis]), contact="slip") for axis in range(3)]
    walls += [HalfSpace(point=(0.4, 0, 0), normal=(-1, 0, 0), friction=0)]
    walls += [HalfSpace(point=(0, 0.4, 0), normal=(0, -1, 0), friction=0)]
    path = Path(times=(0.0, 0.2), points=((0, 0, 0), (0, 0, -0.004)))
    plate = HalfSpace(point=(0, 0, 0.4), normal=(0, 0, -1), friction=0, motion=path)
    rubber = SOFT.model_copy(update={"damping": 200.0})
    solver = make(block((0.4, 0.4, 0.4)), rubber, boundaries=[plate, *walls])
    solver.advance(0.5)
    before = solver.walls.sums.numpy()[0].copy()
    solver.advance(0.6)
    pressure = (solver.walls.sums.numpy()[0] - before)[IMPULSE + 2] / 0.1 / 0.16
    exact, _ = stress(0.99, 1.0)
    assert -pressure == pytest.approx(-exact * SOFT.E, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "strain"), [(0.0, 0.7), (300.0, 0.05)])
def test_block_comes_back_from_a_fifth_of_its_height(damping, strain):
    path = Path(times=(0.0, 0.6, 1.6), points=((0, 0, 0), (0, 0, -0.8), (0, 0, 0.1)))
    plate = HalfSpace(point=(0, 0, 1), normal=(0, 0, -1), friction=0.3, motion=path)
    rubber = SOFT.model_copy(update={"damping": damping})
    walls = [plate, HalfSpace(friction=0.3)]
    solver = make(block((1, 1, 1)), rubber, boundaries=walls, precision="float32")
    solver.advance(0.6)
    heights = solver.state.x.numpy()[:, 2]  # the plates are 0.2 m apart, and a cell is 0.1 m
    assert heights.min() > -0.04 and heights.max() < 0.24
    solver.advance(2.1)
    stretch = np.linalg.svd(solver.state.F.numpy(), compute_uv=False)
    assert np.abs(stretch - 1).max() < strain


def test_very_short_substep_throws_no_point_off_a_wall():
    floor = HalfSpace(contact="sticky")
    solver = make(block((0.4, 0.4, 0.4)), forces=[Gravity(g=(0, 0, -9.0))], boundaries=[floor])
    solver.advance(0.05)
    solver.advance(0.05 + 1e-10)
    assert np.abs(solver.state.v.numpy()).max() < 1


def test_slip_wall_holds_a_clamped_beam():
    clamp = Held(lower=(-1, -1, -1), upper=(0.15, 1, 1))
    wall = HalfSpace(normal=(0, 1.0, 0), contact="slip")
    solver = make(
        block((1.0, 0.1, 0.2)), forces=[Gravity(g=(0, 1e-3, 1e-3))], boundaries=[clamp, wall]
    )
    solver.advance(1.0)
    assert np.abs(solver.state.v.numpy()[:, 1]).max() < 1e-4


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


def test_walls_impulse_and_work_close_the_balance():
    damped = NeoHookean(E=1e5, nu=0.3, density=1000)
    solid = block((0.35, 0.3, 0.3), low=(0, 0, 0.025), per=4)
    solver = make(solid, damped, v=(0.3, 0, -0.5), boundaries=[Ground()])
    totals = LatticeTotals(solver)
    start = totals.read(solver.clock)
    solver.advance(0.2)
    end = totals.read(solver.clock)
    sums = solver.walls.sums.numpy()[0]
    assert np.allclose(end.momentum - start.momentum, sums[IMPULSE : IMPULSE + 3], atol=1e-12)
    assert sums[WORK] < 0
    assert end.energy - start.energy - sums[WORK] == pytest.approx(0, abs=0.05 * start.energy)


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


def test_a_stiffer_body_takes_shorter_substeps_at_once():
    solver = make(block((0.3, 0.2, 0.2)))
    limits = []
    for factor in (1.0, 25.0, 0.1):
        solver.softened = factor
        solver.clock.expire()
        solver.measure_if_due()
        limits.append(solver.spectrum.substep_at_rest)
        assert solver.clock.stable().dt <= solver.clock.cfl * limits[-1] * (1 + 1e-9)
    assert limits == pytest.approx([limits[0], limits[0] / 5, limits[0]])


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
    assert np.allclose(moved, [0.02, 0, 0], atol=1e-8)


def test_hencky_runs_on_its_lattice():
    solver = make(block((0.3, 0.2, 0.2)), Hencky(E=1e5, nu=0.3), v=(0, 0, -1), precision="float32")
    solver.bind(boundaries=[Ground()])
    solver.advance(0.05)
    assert np.linalg.det(solver.state.F.numpy()).min() > 0.5


def lattice_scene(name="drop", frames=4, **accuracy):
    """Return a preset on the lattice at 8 cells."""
    data = Scene.named(name).data()
    data["accuracy"] = {"cells": 8, "solver": "lattice", **accuracy}
    data["time"]["frames"] = frames
    return Scene.from_data(data)


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


@pytest.mark.parametrize("damping", [0.0, 100.0])
def test_simd_and_plain_stress_agree(damping):
    material = NeoHookean(E=1e5, nu=0.3, density=1000, damping=damping)
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    forces, limits = [], []
    for vectors in (True, False):
        solver = make(solid, material, precision="float32", vectors=vectors)
        rng = np.random.default_rng(1)
        solver.nodes_state.u.assign(0.02 * rng.normal(size=(solver.nodes, 3)))
        solver.nodes_state.v.assign(0.5 * rng.normal(size=(solver.nodes, 3)))
        solver.crew.trial_u.assign(solver.nodes_state.u)
        solver.phases.run_task(TRIAL)
        solver.crew.accelerate(trial=True)
        forces.append(solver.crew.trial_a.numpy().copy())
        solver.phases.run_task(MEASURE)
        limits.append(solver.crew.take_maxima())
    assert np.abs(forces[0] - forces[1]).max() < 2e-6 * np.abs(forces[1]).max()
    for which in (GRADIENT, CLOSING):
        assert limits[0][which] == pytest.approx(limits[1][which], rel=1e-3)
    assert limits[0][SPEED] >= limits[1][SPEED]


def test_simd_and_plain_points_agree():
    solid = block((0.7, 0.5, 0.3), low=(0.025, 0.05, 0.025), per=4)
    region = Region(lower=(-1, -1, 0.2), upper=(2, 2, 2))
    states = []
    for vectors in (True, False):
        push = Acceleration(a=(1, 0, 0), region=region)
        solver = make(solid, forces=[push], precision="float32", vectors=vectors)
        rng = np.random.default_rng(1)
        solver.nodes_state.u.assign(0.02 * rng.normal(size=(solver.nodes, 3)))
        solver.nodes_state.v.assign(0.5 * rng.normal(size=(solver.nodes, 3)))
        for worker in solver.workers:
            worker.run(solver.crew.locate(worker))
        assert (solver.state.v.numpy() == solver.crew._kept.numpy()).all()
        located = solver.state.x.numpy().copy(), solver.state.v.numpy().copy()
        solver.follow()
        followed = (getattr(solver.state, name).numpy() for name in ("x", "v", "C", "F"))
        states.append((*located, *followed))
    for simd, plain in zip(*states, strict=True):
        assert np.abs(simd - plain).max() < 3e-6 * np.abs(plain).max()


def test_simd_and_plain_contact_agree():
    solid = block((0.425, 0.5, 0.325), low=(0.025, 0.05, 0.0), per=4)
    found = []
    for vectors in (True, False):
        walls = [Ground(friction=0.4), HalfSpace(point=(0, 0, 0.3), normal=(0, 0.2, -1))]
        v = (1.0, 0.5, -2.0)
        solver = make(solid, v=v, boundaries=walls, precision="float32", vectors=vectors)
        solver.walls.keep_impulses()
        solver.record()
        for _ in range(5):
            solver.step(5e-4, 5e-4)
        sums, kept = solver.walls.sums.numpy(), solver.walls.impulses.sums.numpy()
        assert np.allclose(kept.sum(axis=0), sums[:, :3].sum(axis=0), rtol=1e-12)
        found.append([array.copy() for array in (solver.nodes_state.v.numpy(), sums, kept)])
        snapshot = solver.snapshot()
        solver.step(5e-4, 5e-4)
        solver.restore(snapshot)
        assert np.array_equal(solver.walls.impulses.sums.numpy(), found[-1][2])
    for simd, plain in zip(*found, strict=True):
        assert np.abs(plain).max() > 0.1
        assert np.abs(simd - plain).max() < 1e-4 * np.abs(plain).max()


@pytest.mark.slow
@pytest.mark.parametrize("arch", [75, 80, 86, 90, 100])
def test_lattice_compiles_for_cuda(arch, tmp_path):
    walls = [Ground(), Held()]
    laws = [(SOFT.device_law, False), (Hencky(damping=1.0).device_law, True)]
    kind = wp.float32, "cuda"
    made = *workers.kernels(laws, *kind), *lattice_walls.kernels(walls, *kind, several=True)
    made += *solids.kernels_of(["box", "sphere"], *kind), *material.kernels_of(*kind)
    made += (
        *impulses.kernels(wp.float32),
        points.make_locate(wp.float32),
        points.make_push(wp.float32),
    )
    modules = {kernel.module.name: kernel.module for kernel in made}
    for name, module in modules.items():
        folder = tmp_path / name
        folder.mkdir()
        wp.compile_aot_module(module, arch=arch, module_dir=str(folder), use_ptx=True)
        assert list(folder.glob("*.ptx")), name


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
    assert np.allclose(LatticeTotals(solver).read(solver.clock).momentum, 0, atol=1e-9)
