"""Free bodies in the solver: rigid solids that push the material and are pushed back."""

import numpy as np
import pytest

from phy124.boundaries import Ground, HalfSpace
from phy124.errors import InputError
from phy124.forces import Gravity
from phy124.gaussians import quaternions
from phy124.io.axes import euler
from phy124.materials import Fluid, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import ExternalWork
from phy124.mpm import FreeBody
from phy124.mpm.free import STAGE
from phy124.studies.validation.bodies import lattice, make_solver
from support.balls import elements, pressed_on_box
from support.shapes import watch_run

pytestmark = pytest.mark.usefixtures("coarse_solids")

DX, G = 0.05, 9.81
BALL = FreeBody("ball", "sphere", (0.15,) * 3, (0.0, 0.0, 1.0))
JELLY = NeoHookean(E=1e5)


def block(sides, at=(0.0, 0.0, 0.0), dx=DX):
    """Particles of a block, two per cell and axis, whose lowest side's middle is at a place."""
    x = lattice([round(2 * side / dx) for side in sides], dx / 2)
    return x - [sides[0] / 2, sides[1] / 2, 0] + at


def world(body, x, material=JELLY, *, dx=DX, precision="float64", floor=None, g=G, **options):
    """A free body and a block of material, maybe on a floor."""
    walls = [] if floor is None else [Ground(friction=floor)]
    options.setdefault("threads", 1)
    options.setdefault("boundaries", walls)
    forces = [Gravity(g=(0.0, 0.0, -g))] if g else []
    return make_solver(
        x,
        np.full(len(x), (dx / 2) ** 3),
        [material],
        dx=dx,
        precision=precision,
        free=[body],
        planes=walls,
        forces=forces,
        origin=(0.0, 0.0, -0.75 * dx),
        **options,
    )


def beside(body, *, floor=None, g=G):
    """A free body far from the only material."""
    return world(body, block((0.2, 0.2, 0.2), (9, 0, 0)), NeoHookean(E=1e4), floor=floor, g=g)


def whole(s):
    """Momentum, angular momentum about the origin, and energy of all."""
    (body,), result = s.free.all, diagnose(s)
    place, V, w = s.free.poses()[0, :3], s.free.motions()[0, :3], s.free.motions()[0, 3:]
    R = body._replace(turn=tuple(s.free.poses()[0, 3:])).axes
    L = R @ (body.moments * (R.T @ w))
    momentum = result.momentum + body.mass * V
    angular = result.angular + np.cross(place, body.mass * V) + L
    return momentum, angular, result.energy + body.mass * V @ V / 2 + w @ L / 2


def test_alone_it_flies_a_parabola_and_turns_as_it_did():
    s = beside(BALL._replace(velocity=(1.0, 0, 2.0), spin=(0, 0, 3.0)))
    s.advance(0.25)
    s.advance(0.3)
    (pose,) = s.free.poses()
    np.testing.assert_allclose(pose[:3], [0.3, 0, 1 + 0.6 - G * 0.045], rtol=0, atol=1e-12)
    np.testing.assert_allclose(pose[3:], [np.cos(0.45), 0, 0, np.sin(0.45)], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("threads", "sticky"), [(1, False), (2, False), (1, True)])
def test_momentum_is_exchanged_with_the_material(threads, sticky):
    body = BALL._replace(
        place=(0.05, 0.03, 0.46), velocity=(0.3, 0.1, -1.0), spin=(1.0, 2.0, 3.0), sticky=sticky
    )
    external = ExternalWork()
    s = world(body, block((0.4, 0.4, 0.3)), g=0, threads=threads, accumulators=[external])
    before, dog = whole(s), watch_run(s, external)
    dog.before_attempt()
    s.free.begin()
    s.advance(0.1, after=dog.after_substep)
    after = whole(s)
    np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-13 * np.abs(before[0]).max())
    np.testing.assert_allclose(after[1], before[1], rtol=0, atol=1e-13 * np.abs(before[1]).max())
    assert 0.4 * before[2] < after[2] < before[2]
    got = diagnose(s).momentum
    assert got[2] < -3
    (wrench,) = s.free.wrenches(0.1)
    np.testing.assert_allclose(0.1 * wrench.force, -got, rtol=1e-10)
    assert s.free.names == ("0_on_ball",)
    assert dog.after_attempt() is None, "what the solid gives is in the balance"
    s.free.total(0).zero_()
    what = dog.after_attempt().what
    assert "momentum has no physical source" in what or "energy" in what


def test_free_solid_slides_by_friction_and_rolls():
    box = FreeBody("box", "box", (0.2, 0.15, 0.1), (0, 0, 0.1), velocity=(2.0, 0, 0))
    for body, speed in ((box, 2 - 0.3 * G * 0.3), (BALL._replace(place=(0, 0, 0.15)), 10 / 7)):
        s = beside(body._replace(velocity=(2.0, 0, 0)), floor=0.3)
        s.advance(0.3)
        V = s.free.motions()[0]
        # Velocities are those half a substep before.
        late = 0.3 * G * s.clock.last_dt / 2 if body is box else 0
        np.testing.assert_allclose(V[:3], [speed + late, 0, 0], rtol=0, atol=1e-9)
        assert s.free.poses()[0, 2] == pytest.approx(body.half[2], abs=1e-9)
        s.advance(1.0)
        stopped = [0, 0, 0] if body is box else [10 / 7, 0, 0]
        np.testing.assert_allclose(s.free.motions()[0, :3], stopped, rtol=0, atol=1e-9)


def test_free_body_slides_on_slopes_beyond_its_friction():
    for friction, moves in ((0.4, False), (0.3, True)):
        slope = np.radians(20)
        n = (np.sin(slope), 0, np.cos(slope))
        turn = (np.cos(slope / 2), 0.0, np.sin(slope / 2), 0.0)
        body = FreeBody("box", "box", (0.2, 0.15, 0.1), tuple(0.1 * np.array(n)), turn=turn)
        s = beside(body)
        s.bind(forces=[Gravity()], planes=[HalfSpace(normal=n, friction=friction)])
        s.advance(0.4)
        pull = G * (np.sin(slope) - friction * np.cos(slope)) if moves else 0.0
        way = np.linalg.norm(s.free.poses()[0, :3] - body.place)
        assert way == pytest.approx(pull * 0.08, rel=1e-6, abs=1e-7)


def test_a_free_top_keeps_its_angular_momentum_and_energy():
    """About the middle axis, which turns over."""
    body = FreeBody("box", "box", (0.3, 0.2, 0.1), (0, 0, 1.0), spin=(0.1, 6.0, 0.2))
    s = beside(body, g=0)
    before = whole(s)
    flipped = False
    for frame in range(1, 9):
        s.advance(0.25 * frame)
        R = body._replace(turn=tuple(s.free.poses()[0, 3:])).axes
        flipped |= bool(R[1, 1] < -0.5)
    after = whole(s)
    np.testing.assert_allclose(after[1], before[1], rtol=1e-12)
    assert flipped and after[2] == pytest.approx(before[2], rel=2e-4)


def test_too_thin_a_body_is_refused():
    with pytest.raises(InputError, match=r"objects \(ball\) = 0.08 m: it is thinner than two"):
        world(BALL._replace(half=(0.04,) * 3), block((0.2, 0.2, 0.2)))


def test_without_free_bodies_nothing_is_launched():
    x = block((0.2, 0.2, 0.2))
    s = make_solver(x, np.full(len(x), 1e-5), [JELLY], dx=DX, threads=1)
    s.advance(0.01)
    assert STAGE not in [name for phase in s.workers[0].phases for name, _ in phase]
    assert not s.snapshot()["free"]["bodies"]


@pytest.mark.parametrize("shape", ["sphere", "box", "capsule"])
def test_volume_and_moments_are_those_of_the_shape(shape):
    half = (0.1, 0.1, 0.25) if shape == "capsule" else (0.15,) * 3
    body = FreeBody("one", shape, half, (0, 0, 0), density=700.0)
    n = 80
    line = (np.arange(n) + 0.5) / n * 2 - 1
    x = np.stack(np.meshgrid(*[line * side for side in half], indexing="ij"), -1).reshape(-1, 3)
    core = np.clip(x, np.array(min(half)) - half, np.array(half) - min(half))
    inside = (
        np.linalg.norm(x - core, axis=1) <= min(half) if shape != "box" else np.full(n**3, True)
    )
    each = 700.0 * 8 * np.prod(half) / n**3
    x = x[inside]
    assert body.mass == pytest.approx(each * len(x), rel=5e-3)
    moments = each * ((x**2).sum() - (x**2).sum(axis=0))
    np.testing.assert_allclose(body.moments, moments, rtol=1e-2)


def settled(body, *, seconds=3.0, top=0.3, E=3e4, **options):
    """A body some time after it fell on soft jelly, and its mean weight on it since [weights]."""
    s = world(body, block((0.8, 0.8, top)), NeoHookean(E=E, damping=40), floor=0.5, **options)
    s.advance(seconds)
    s.free.begin()
    s.advance(seconds + 0.5)
    force = s.free.wrenches(0.5)[0].force
    return s, force[2] / body.mass / G


@pytest.mark.slow
@pytest.mark.parametrize("density", [10.0, 1000.0, 5000.0])
@pytest.mark.parametrize("shape", ["sphere", "box", "capsule"])
def test_at_rest_on_jelly_it_weighs_what_it_weighs(shape, density):
    half = (0.15, 0.15, 0.15) if shape != "capsule" else (0.25, 0.15, 0.15)
    body = FreeBody("one", shape, half, (0.01, 0.02, 0.5), density=density)
    E = 3e4 if density < 2000 else 2e5
    s, weight = settled(body, E=E, precision="float32")
    assert weight == pytest.approx(1, abs=0.02)
    assert np.abs(s.free.motions()).max() < 0.05
    near = np.hypot(*s.state.x.numpy()[:, :2].T) < 0.1
    gap = s.free.poses()[0, 2] - 0.15 - s.state.x.numpy()[near, 2].max()
    assert -0.6 * DX < gap < 0.6 * DX


@pytest.mark.slow
def test_heavy_free_body_squeezes_jelly_soundly():
    body = BALL._replace(place=(0.01, 0.02, 0.5), density=1e5)
    s, _ = settled(body, seconds=1.0, E=1e5, precision="float32")
    assert np.isfinite(s.state.x.numpy()).all() and np.isfinite(s.free.poses()).all()
    assert s.free.poses()[0, 2] >= 0.15 - 1e-6, "it never sinks through the floor"
    assert np.abs(s.free.motions()[0, 2]) < 0.2


@pytest.mark.slow
def test_mirrored_scene_has_the_mirrored_motion():
    results = []
    for way in (1, -1):
        body = FreeBody(
            "box",
            "box",
            (0.2, 0.1, 0.1),
            (way * 0.05, 0.0, 0.5),
            velocity=(way * 0.5, 0.1, -1.0),
            spin=(1.0, way * 2.0, way * 0.5),
        )
        x = block((0.6, 0.6, 0.3))
        s = world(body, x, NeoHookean(E=5e4), floor=0.4)
        s.advance(0.5)
        results.append(np.concatenate([s.free.poses()[0, :3], s.free.motions()[0]]))
    flip = np.array([-1, 1, 1, -1, 1, 1, 1, -1, -1])
    np.testing.assert_allclose(results[1] * flip, results[0], atol=1e-6)
    assert abs(results[0][0]) > 0.05


@pytest.mark.slow
def test_two_bodies_that_it_meets_get_what_it_loses():
    """It falls on both at their edges, one of which is twice as heavy."""
    x = np.vstack([block((0.3, 0.4, 0.3), (way * 0.18, 0, 0)) for way in (-1, 1)])
    body = np.repeat([0, 1], len(x) // 2)
    first = BALL._replace(place=(0.02, 0.03, 0.47), velocity=(0.1, 0.2, -1.0), spin=(1.0, 2.0, 3.0))
    heavier = NeoHookean(E=1e5, density=2000)
    s = make_solver(
        x,
        np.full(len(x), (DX / 2) ** 3),
        [JELLY, heavier],
        dx=DX,
        body=body,
        material=body,
        names=["left", "right"],
        precision="float64",
        free=[first],
        threads=1,
    )
    before = whole(s)
    s.free.begin()
    s.advance(0.2)
    after = whole(s)
    np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-13 * np.abs(before[0]).max())
    np.testing.assert_allclose(after[1], before[1], rtol=0, atol=1e-12 * np.abs(before[1]).max())
    assert s.free.names == ("left_on_ball", "right_on_ball") and after[2] < before[2]
    assert all(wrench.force[2] > 10 for wrench in s.free.wrenches(0.2))


@pytest.mark.slow
def test_between_jelly_and_floor_it_rests():
    """A light box under a block of jelly carries it."""
    body = FreeBody("box", "box", (0.3, 0.3, 0.1), (0, 0, 0.1), density=10.0)
    s = world(body, block((0.3, 0.3, 0.3), (0, 0, 0.2)), NeoHookean(E=5e4, damping=40), floor=0.5)
    s.advance(1.0)
    s.free.begin()
    s.advance(1.5)
    force = s.free.wrenches(0.5)[0].force
    assert force[2] == pytest.approx(-27 * G, rel=0.02)
    np.testing.assert_allclose(s.free.poses()[0, :3], [0, 0, 0.1], atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
def test_a_ball_on_a_box_pushes_as_finite_elements_say(phase):
    """Wherever the box's top is between two nodes."""
    for depth in (0.02, 0.05):
        assert pressed_on_box(16, depth, phase) == pytest.approx(elements(depth), rel=0.08)


@pytest.mark.slow
def test_free_solid_resumes_bit_for_bit():
    made = []
    for pause in (False, True):
        body = BALL._replace(place=(0.05, 0.03, 0.46), velocity=(0.3, 0.1, -1.0))
        s = world(body, block((0.4, 0.4, 0.3)), floor=0.5)
        s.advance(0.1)
        if pause:
            kept = s.snapshot()
            s.advance(0.15)
            s.restore(kept)
        s.advance(0.2)
        made.append((s.state.x.numpy().copy(), s.free.poses(), s.free.motions()))
    for first, second in zip(*made, strict=True):
        assert np.array_equal(first, second)


def floating(density):
    """Return the depth of a cube in a tank of water [sides], and its weight on the water
    [weights]."""
    tank, side = (0.8, 0.8, 0.5), 0.3
    walls = [Ground(friction=0, contact="slip")]
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        n, at = np.zeros((2, 3))
        n[axis], at[axis] = sign, -sign * tank[axis] / 2
        walls.append(HalfSpace(point=tuple(at), normal=tuple(n), contact="slip"))
    body = FreeBody("cube", "box", (side / 2,) * 3, (0, 0, 0.66), density=density, friction=0.0)
    s = world(body, block(tank), Fluid(), floor=0.0, boundaries=walls, precision="float32")
    s.advance(2.0)
    s.free.begin()
    heights = []
    for step in range(10):
        s.advance(2.1 + 0.1 * step)
        heights.append(s.free.poses()[0, 2] - side / 2)
    # Of all the water there is, and of what the cube pushes away.
    bottom = np.mean(heights)
    level = (tank[2] * tank[0] * tank[1] - side**2 * bottom) / (tank[0] * tank[1] - side**2)
    return (level - bottom) / side, s.free.wrenches(1.0)[0].force[2] / body.mass / G


@pytest.mark.slow
def test_free_body_floats_or_sinks_by_density():
    """Somewhat deeper, up to half a cell: water reaches into what floats on it."""
    result = [floating(density) for density in (300.0, 600.0)]
    for (depth, weight), density in zip(result, (300.0, 600.0), strict=True):
        assert weight == pytest.approx(1, abs=0.02)
        assert -0.02 < depth - density / 1000 < 0.1
    assert result[1][0] - result[0][0] == pytest.approx(0.3, rel=0.2)
    assert floating(2000.0)[0] > 1.2, "it lies on the ground"


@pytest.mark.parametrize("shape", ["sphere", "box", "capsule"])
def test_depth_is_that_below_its_surface(shape):
    half = (0.1, 0.1, 0.3) if shape == "capsule" else (0.2, 0.2, 0.2)
    turn = tuple(quaternions(euler((0, 90, 0))[None])[0].tolist())
    body = FreeBody("one", shape, half, (1.0, 0, 0), turn=turn)
    along = np.array([[1.0, 0, 0], [1.15, 0, 0], [1.4, 0, 0], [1.0, 0, 0.3]])
    deep = {
        "sphere": [0.2, 0.05, -0.2, -0.1],
        "box": [0.2, 0.05, -0.2, -0.1],
        "capsule": [0.1, 0.1, -0.1, -0.2],
    }
    np.testing.assert_allclose(body.measure_depth(along), deep[shape], rtol=0, atol=1e-12)
