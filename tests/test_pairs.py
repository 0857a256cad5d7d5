"""Several bodies: each has a grid of its own, and where two meet they touch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phy124.boundaries import Container, Ground, HalfSpace
from phy124.forces import Gravity, ZoneForce
from phy124.materials import Fluid, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import ExternalWork
from phy124.mpm import Model, Pair
from phy124.mpm.pairs import STAGE
from phy124.schema.region import Region
from phy124.studies.validation.bodies import lattice, make_solver
from support.balls import collision, elements, pressed
from support.shapes import trimmed_ball, watch_run

pytestmark = pytest.mark.usefixtures("coarse_solids")

CELL = 0.1
BOX = lattice((8,) * 3, 1 / 20)
"""A cube of 0.4 m."""


def two(apart: float, *, v: float = 0.5, precision: str = "float64", **options):
    """Two cubes, so far apart along x [m], each of which approaches the other at v / 2 [m/s]."""
    x = np.vstack([BOX, BOX * 1.1 + [0.4 + apart, 0.03, -0.02]])
    body = np.repeat([0, 1], len(BOX))
    options.setdefault("threads", 1)
    return make_solver(
        x,
        np.repeat([1, 1.1**3], len(BOX)) / 20**3,
        [NeoHookean(E=1e5)],
        dx=CELL,
        body=body,
        v=np.where(body == 0, v / 2, -v / 2)[:, None] * [1.0, 0.3, 0.1],
        precision=precision,
        **options,
    )


def momentum(solver, body):
    run = solver.model.particles(body)
    return solver.model.mass.numpy()[run] @ solver.state.v.numpy()[run]


@pytest.mark.parametrize(("threads", "sticky"), [(1, False), (2, False), (1, True)])
def test_bodies_exchange_opposite_impulses(threads, sticky):
    s = two(0.01, threads=threads, pairs=[Pair(1, 0, friction=0.3, sticky=sticky)])
    before, whole = [momentum(s, body) for body in (0, 1)], diagnose(s)
    s.advance(0.1)
    gained = [momentum(s, body) - p for body, p in enumerate(before)]
    force, torque = s.pairs.wrenches(0.1)[(1, 0)]
    assert np.abs(gained[1]).max() > 10
    np.testing.assert_allclose(gained[0], 0.1 * force, rtol=1e-11)
    np.testing.assert_allclose(gained[0], -gained[1], rtol=1e-11)
    after = diagnose(s)
    np.testing.assert_allclose(after.angular, whole.angular, rtol=0, atol=1e-11)
    assert after.energy < whole.energy and np.linalg.norm(torque) > 1


def test_bodies_apart_launch_nothing_and_move_as_if_alone():
    apart, alone = two(1.2), two(1.2, pairs=[])
    apart.advance(0.05)
    names = [name for phase in apart.workers[0].phases for name, _ in phase]
    assert STAGE not in names and names.count("grid") == 2
    assert alone.nodes == 0 and apart.nodes == sum(grid.count for grid in apart.grids)
    assert np.allclose(apart.state.F.numpy(), np.eye(3), rtol=0, atol=1e-12)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_body_that_is_held_takes_what_it_is_given(threads):
    external, walls = ExternalWork(), [Ground(height=0.0)]
    forces = external.wrap_forces([Gravity(g=(1.0, 0, -1.0)), ZoneForce()])
    s = two(
        0.01,
        held=[1],
        threads=threads,
        forces=forces,
        boundaries=external.wrap_walls(walls, walls),
        accumulators=[external],
    )
    dog, start = watch_run(s, external), momentum(s, 0)
    for frame in (1, 2):
        dog.before_attempt()
        s.advance(0.05 * frame, after=dog.after_substep)
        assert dog.after_attempt() is None
    assert dog.balance.momentum_gain < 1e-12 and dog.balance.energy_gain < 1e-9
    assert start[0] - momentum(s, 0)[0] > 10, "it has been stopped"
    assert not s.state.v.numpy()[s.model.particles(1)].any()
    assert np.array_equal(s.state.x.numpy()[len(BOX) :], s.model.rest[len(BOX) :])


def test_bodies_must_come_in_their_order():
    x, volume = np.zeros((3, 3)), np.ones(3)
    for body in ([0, 1, 0], [1, 1, 2], [0, 2, 2]):
        with pytest.raises(ValueError, match="sorted by body"):
            Model.of(x, volume, [NeoHookean()], dx=1, body=np.array(body))
    with pytest.raises(ValueError, match="different pairs of 2 bodies"):
        two(1.0, pairs=[Pair(0, 2)])


def test_a_pause_in_the_middle_of_contact_changes_nothing():
    kept, other = two(0.01), two(0.01)
    kept.advance(0.05)
    snapshot = kept.snapshot()
    kept.advance(0.08)
    other.restore(snapshot)
    other.advance(0.08)
    for name, array in kept.state.arrays().items():
        assert np.array_equal(array.numpy(), other.state.arrays()[name].numpy()), name
    assert np.array_equal(*(s.pairs.wrenches(1)[(0, 1)] for s in (kept, other)))


DX = 0.05
H = DX / 2


def box(low, high, h=H):
    """Particles in a box [P,3], m."""
    return lattice(np.round((np.array(high) - low) / h).astype(int), h, low)


def ball(middle, radius, h):
    x = box((-radius - h,) * 3, (radius + h,) * 3, h)
    return x[np.linalg.norm(x, axis=1) < radius] + middle


def solver(bodies, materials, *, h=H, volume=None, **options):
    """Bodies of particles [P,3] on one lattice; each is made of the material of its number."""
    body = np.repeat(range(len(bodies)), [len(x) for x in bodies])
    material = np.minimum(body, len(materials) - 1)
    volume = np.full(len(body), h**3) if volume is None else volume
    options = {"dx": DX, "threads": 1, **options}
    x = np.vstack(bodies)
    return make_solver(x, volume, materials, material=material, body=body, **options)


def middle(s, body, values):
    """Mean over the mass of a body."""
    run = s.model.particles(body)
    mass = s.model.mass.numpy()[run].astype(float)
    return mass @ values.numpy()[run].astype(float) / mass.sum()


def slid(degrees, *, held=True, stiff=2e5, **contact):
    """Acceleration of a block on a slope, and its speed at the end [m/s^2, m/s]."""
    angle = np.radians(degrees)
    bodies = [box((-0.4, -0.2, 0), (0.6, 0.2, 0.2)), box((-0.3, -0.15, 0.2), (0, 0.15, 0.4))]
    s = solver(
        bodies,
        [NeoHookean(E=stiff, damping=60.0)],
        held=[0] if held else [],
        pairs=[Pair(0, 1, **contact)],
        boundaries=[] if held else [Ground(contact="sticky")],
        forces=[Gravity(g=(9.81 * np.sin(angle), 0, -9.81 * np.cos(angle)))],
    )
    times, speeds = np.linspace(0.2, 0.4, 9), []
    for time in times:
        s.advance(float(time))
        speeds.append(middle(s, 1, s.state.v)[0])
    return np.polyfit(times, speeds, 1)[0], speeds[-1]


def test_a_block_slides_down_a_slope_as_coulomb_says():
    wanted = 9.81 * (np.sin(np.radians(30)) - 0.3 * np.cos(np.radians(30)))
    assert slid(30, friction=0.3)[0] == pytest.approx(wanted, rel=0.01)
    assert abs(slid(16, friction=0.3)[1]) < 0.001, "tan 16 degrees is 0.287, less than 0.3"
    assert slid(17, friction=0.3)[1] > 0.05, "tan 17 degrees is 0.306"
    assert slid(30, friction=0.25)[0] > 1.1 * wanted, "the measure sees other friction"
    assert abs(slid(30, sticky=True)[0]) < 0.1 * wanted, "and sticky contact"


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [25, 30])
def test_a_block_slides_down_a_soft_slope(degrees):
    angle = np.radians(degrees)
    wanted = 9.81 * (np.sin(angle) - 0.3 * np.cos(angle))
    result, _ = slid(degrees, held=False, stiff=1e6, friction=0.3)
    assert result == pytest.approx(wanted, rel=0.03)
    assert abs(slid(15, held=False, stiff=1e6, friction=0.3)[1]) < 0.02
    assert slid(degrees, held=False, stiff=1e6, friction=0.2)[0] > 1.1 * wanted


V = 0.6
"""Speed at which two balls approach each other, m/s."""
LASTS = 0.45
"""About how long they touch, s."""


@cache
def struck(cells, *, sticky=False, offset=(0.0, 0.0, 0.0), precision="float32", spoil=None):
    """Force over time [T,2] of two balls of 1 m that meet head-on, and the solver."""
    dx, force = 1 / cells, []
    x, volume = trimmed_ball(0.5, dx / 2)
    bodies = [x + [side * (0.5 + dx / 8), 0, 0] + np.array(offset) * dx for side in (-1, 1)]
    s = solver(
        bodies,
        [NeoHookean(E=1e5, nu=0.3)],
        volume=np.tile(volume, 2),
        dx=dx,
        v=np.repeat([[V / 2, 0, 0], [-V / 2, 0, 0]], len(x), axis=0),
        pairs=[Pair(0, 1, 0.0, sticky)],
        precision=precision,
    )
    if spoil:
        spoil(s)
    for _ in range(60):
        s.pairs.begin()
        s.advance(s.clock.time + LASTS / 40)
        force.append((s.clock.time, s.pairs.wrenches(LASTS / 40)[(0, 1)].force[0]))
    return np.array(force), s


@pytest.mark.slow
def test_balls_that_collide_press_as_finite_elements_say():
    result, s = struck(14)
    force, lasts = collision(0.5, V, E=1e5, nu=0.3, density=1000.0)
    whole = result[:, 1] > 0.02 * force
    assert result[:, 1].max() == pytest.approx(force, rel=0.05)
    assert whole.sum() * LASTS / 40 == pytest.approx(lasts, rel=0.1)
    assert result[:, 1].min() > -1e-3 * force, "nothing pulls"
    speeds = [middle(s, body, s.state.v)[0] for body in (0, 1)]
    assert sum(speeds) == pytest.approx(0, abs=1e-5)
    assert 0.9 < -speeds[0] / V * 2 < 1
    stuck, _ = struck(12, sticky=True)
    assert stuck[:, 1].min() < -0.1 * force, "sticky balls pull at each other"


@pytest.mark.slow
def test_finer_grids_come_closer_to_finite_elements():
    force, _ = collision(0.5, V, E=1e5, nu=0.3, density=1000.0)
    errors = [abs(struck(n)[0][:, 1].max() / force - 1) for n in (8, 12, 24)]
    assert errors[0] > errors[1] > errors[2] and errors[2] < 0.03
    shifted = struck(16, offset=(0.3, 0.2, 0.1))[0][:, 1].max()
    assert shifted == pytest.approx(struck(16)[0][:, 1].max(), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0.0, 0.25])
def test_balls_that_are_pressed_push_as_finite_elements_say(phase):
    """Wherever the contact is between two nodes; without the curvature of the gap they do not."""
    for depth in (0.02, 0.05):
        assert pressed(16, depth, phase) == pytest.approx(elements(depth), rel=0.05)


def unanswered(s, body):
    """Control: contact changes the velocities of all bodies but this one."""
    s.pairs._model = replace(s.pairs._model, held=frozenset({body}))


def skew(s):
    """Return the distance of a body from the mirror image of the other body [m]."""
    first, second = (s.state.x.numpy()[s.model.particles(body)] for body in (0, 1))
    first = first * [-1, 1, 1]
    order = [np.lexsort(np.round(x, 9).T) for x in (first, second)]
    return np.abs(first[order[0]] - second[order[1]]).max()


def test_a_collision_is_its_own_mirror_image():
    _, s = struck(8, precision="float64")
    assert skew(s) < 1e-9
    _, broken = struck(8, precision="float64", spoil=lambda s: unanswered(s, 1))
    assert skew(broken) > 0.01, "without a reaction it is none"


@pytest.mark.slow
def test_two_balls_bounce_as_one_does_from_a_mirror():
    """Restitution of two balls, and of one on a smooth wall in the middle between them."""
    _, pair = struck(12)
    run = pair.model.particles(0)
    x, count = pair.model.rest[run], run.stop - run.start
    alone = make_solver(
        x,
        np.full(count, np.pi / 6 / count),
        [NeoHookean(E=1e5, nu=0.3)],
        dx=1 / 12,
        v=np.tile([0.3, 0, 0], (count, 1)),
        threads=1,
        boundaries=[HalfSpace(normal=(-1.0, 0, 0), friction=0.0)],
    )
    alone.advance(pair.clock.time)
    both, first = (-middle(s, 0, s.state.v)[0] / 0.3 for s in (pair, alone))
    assert both == pytest.approx(first, abs=0.03)
    _, stuck = struck(12, sticky=True)
    assert abs(-middle(stuck, 0, stuck.state.v)[0] / 0.3 - first) > 0.1, "those that stick do not"


def afloat(density, seconds, **contact):
    """A cube in water: where its bottom is below the water's surface, in heights of the cube."""
    water = box((-0.3, -0.3, 0), (0.3, 0.3, 0.5))
    cube = box((-0.1, -0.1, 0.4), (0.1, 0.1, 0.6))
    inside = np.all(np.abs(water - [0, 0, 0.5]) < 0.1, axis=1)
    tray = Container(inside=Region(lower=(-0.3, -0.3, 0), upper=(0.3, 0.3, 9)), contact="slip")
    s = solver(
        [water[~inside], cube],
        [Fluid(density=1000, bulk_modulus=1e5), NeoHookean(E=1e5, density=density, damping=20.0)],
        forces=[Gravity()],
        boundaries=[tray],
        pairs=[Pair(0, 1, **contact)],
    )
    s.advance(seconds - 0.1)
    s.pairs.begin()
    s.advance(seconds)
    lift = s.pairs.wrenches(0.1)[(0, 1)].force[2] / (9.81 * density * 0.2**3)
    top = np.percentile(s.state.x.numpy()[s.model.particles(0), 2], 98)
    return (top - middle(s, 1, s.state.x)[2] + 0.1) / 0.2, lift


@pytest.mark.slow
def test_light_floats_and_heavy_sinks():
    depth, lift = afloat(500, 1.5, friction=0.0)
    assert depth == pytest.approx(0.5, abs=0.05) and lift == pytest.approx(1, abs=0.03)
    assert afloat(2000, 0.6, friction=0.0)[0] > 1.7
    assert afloat(2000, 0.6, sticky=True)[0] < 1.5, "what sticks to the water sinks late"


CUBE = 4 * DX
"""Side of each cube of a tower, m."""


def tower(E, **contact):
    """Five cubes on each other, every other one 1e-3 of its size beside the one below.

    In double precision, in which stiff cubes feel strains as small as those of a tower that leans.
    """
    cubes = [
        box((-CUBE / 2, -CUBE / 2, i * CUBE), (CUBE / 2, CUBE / 2, (i + 1) * CUBE))
        + [1e-3 * CUBE * (i % 2), 0, 0]
        for i in range(5)
    ]
    return solver(
        cubes,
        [NeoHookean(E=E, damping=80.0)],
        forces=[Gravity()],
        boundaries=[Ground()],
        pairs=[Pair(i, i + 1, **contact) for i in range(4)],
        precision="float64",
    )


def seen(s, until):
    """Return the final centres of the cubes, in sizes [5,3], and the total energy, J."""
    s.advance(until)
    now = diagnose(s)
    lifted = 9.81 * now.middle[2]
    return (
        np.array([middle(s, cube, s.state.x) / CUBE for cube in range(5)]),
        now.kinetic + now.elastic + lifted,
    )


@pytest.mark.slow
def test_five_cubes_rest_on_each_other_for_ten_seconds():
    s = tower(1e7)
    early, before = seen(s, 1.0)
    s.pairs.begin()
    late, after = seen(s, 10.0)
    assert np.abs(late - early).max() < 3e-4
    assert after < before
    force = [s.pairs.wrenches(9.0)[(i, i + 1)].force[2] for i in range(4)]
    weight = 9.81 * 1000 * CUBE**3
    np.testing.assert_allclose(force, weight * np.arange(4, 0, -1), rtol=0.002)
    assert diagnose(s).kinetic < 1e-9 * weight * CUBE


@pytest.mark.slow
@pytest.mark.parametrize("contact", [{"friction": 0.0}, {"sticky": True}])
def test_with_the_wrong_contact_the_tower_does_not_rest(contact):
    s = tower(2e6, **contact)
    early, _ = seen(s, 0.5)
    assert np.abs(seen(s, 4.0)[0] - early).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_random_bodies_keep_their_momentum(part):
    rng = np.random.default_rng(part)
    for _ in range(50):
        lost, turned, gained = scene_of(rng)
        assert lost < 1e-11 and turned < 1e-10 and gained < 0.001


@pytest.mark.slow
def test_random_bodies_without_a_reaction_lose_their_momentum():
    rng = np.random.default_rng(0)
    lost = [scene_of(rng, spoil=lambda s: unanswered(s, 0))[0] for _ in range(10)]
    assert np.median(lost) > 1e-4


def scene_of(rng, spoil=None):
    """A few bodies thrown at each other: change of momentum and of angular momentum over what all
    would have in one direction, and gain of energy over what there was.
    """
    count = int(rng.integers(2, 7))
    places = rng.permutation(27)[:count]
    bodies, v = [], []
    for place in places:
        where = np.array([place // 9, place // 3 % 3, place % 3]) * 0.45
        radius = rng.uniform(0.11, 0.2)
        x = ball(where, radius, H) if rng.random() < 0.5 else box(where - radius, where + radius)
        bodies.append(x + rng.uniform(-0.02, 0.02, 3))
        v.append(np.tile((0.45 - where) * rng.uniform(2, 12), (len(x), 1)))
    materials = [
        NeoHookean(E=10 ** rng.uniform(4, 6), density=rng.uniform(200, 4000)) for _ in range(count)
    ]
    pairs = [
        Pair(i, j, rng.uniform(0, 1), bool(rng.random() < 0.2))
        for i in range(count)
        for j in range(i)
    ]
    s = solver(bodies, materials, v=np.vstack(v), pairs=pairs, precision="float64")
    if spoil:
        spoil(s)
    before = diagnose(s)
    s.advance(0.15)
    after = diagnose(s)
    scale = np.sqrt(2 * before.kinetic * s.model.total_mass)
    return (
        np.abs(after.momentum - before.momentum).max() / scale,
        np.abs(after.angular - before.angular).max() / scale,
        after.energy / before.energy - 1,
    )
