"""Forces: what each does to momentum and motion of a body or a part, and what it launches."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from phy124.errors import InputError
from phy124.forces import (
    Acceleration,
    AnyForce,
    Attraction,
    Grab,
    Gravity,
    Impulse,
    ParticleForce,
    SetVelocity,
    TotalForce,
    Wind,
    WrenchForce,
    ZoneForce,
)
from phy124.forces.held import weights
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Solver
from phy124.mpm.tracks import Keyframes, Ramp, Sine
from phy124.mpm.workers import HOST
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import block, make_solver
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DX = 0.125
LEFT = Region(upper=(0.0, 1e9, 1e9))


def solver(*forces, x: np.ndarray | None = None, **options) -> Solver:
    x = block() if x is None else x
    options.setdefault("precision", "float64")
    material = options.pop("material", NeoHookean(E=1e4))
    return make_solver(x, np.full(len(x), 1e-4), [material], dx=DX, forces=forces, **options)


def momentum(s: Solver) -> np.ndarray:
    return (s.model.mass.numpy().astype(float)[:, None] * s.state.v.numpy()).sum(axis=0)


def launches(s: Solver) -> set[str]:
    """Names of the stages of a substep."""
    s.advance(0.002)
    usual = {"measure", "clear", "p2g neo_hookean", "grid", "g2p neo_hookean"}
    return set(s.timings) - usual - set(HOST)


@pytest.mark.parametrize("kinds", [("mpm",), ("lattice",), ("fluid",), ("fluid", "sand")])
def test_an_impulse_is_shared_with_a_free_solid(kinds):
    """Also a liquid and other material, which two solvers move, have the velocity p / m."""
    apart = {"shape": "box", "size": 0.4, "place": [0, 2]}
    objects = [{**apart, "name": "solid", "motion": {"kind": "free", "density": 500}}]
    objects += [
        {**apart, "name": kind, "place": [0, -2], "material": {"law": kind}} for kind in kinds[1:]
    ]
    material = {"law": "fluid"} if kinds[0] == "fluid" else {"law": "neo_hookean", "E": 1e5}
    solver = {} if kinds[0] == "fluid" else {"solver": kinds[0]}
    blow = {"kind": "impulse", "p": [0, 0, 300]}
    scene = Scene.from_data(
        {"accuracy": {"cells": 8, **solver}, "material": material, "objects": objects}
        | {"forces": [blow], "boundaries": [], "time": {"frames": 2}}
    )
    run = Simulation(prepare(ball(300), scene, RunContext(threads=1)))
    run.step()
    run.step()
    s, (solid,) = run.solver, run.setup.free
    mass = s.model.mass.numpy().astype(float)
    v = s.state.v.numpy()[:, 2]
    expected = 300 / (mass.sum() + solid.mass)
    assert s.free.motions()[0, 2] == pytest.approx(expected, rel=1e-3)
    for body in range(s.model.bodies):
        part = s.model.particles(body)
        mean = mass[part] @ v[part] / mass[part].sum()
        assert mean == pytest.approx(expected, rel=1e-3), s.model.names[body]


@pytest.mark.parametrize("region", [None, LEFT], ids=["whole", "part"])
@pytest.mark.parametrize(("precision", "close"), [("float32", 2e-5), ("float64", 1e-10)])
def test_an_impulse_gives_its_momentum_whatever_the_substeps(region, precision, close):
    p = (3.0, -1.0, 0.5)
    for ceiling in (1e-2, 1.7e-3, 1.13e-4):
        blow = Impulse(p=p, start=0.0037, duration=0.0051, region=region)
        s = solver(blow, precision=precision, ceiling=ceiling)
        s.advance(0.03)
        np.testing.assert_allclose(momentum(s), p, atol=3.2 * close)


def test_an_impulse_at_once_and_one_with_a_profile_are_whole_too():
    now = solver(Impulse(p=(0.0, 2.0, 0.0), duration=0.003))
    rising = Impulse(p=(0.0, 2.0, 0.0), duration=0.02, profile=Ramp(duration=0.01))
    grows = solver(rising)
    for s in (now, grows):
        s.advance(0.05)
        np.testing.assert_allclose(momentum(s), [0, 2, 0], rtol=0, atol=1e-10)


def test_a_monstrous_impulse_is_still_exact():
    """A million times the weight on one particle: finite, and all of it arrives."""
    x = block()
    first = Region(lower=tuple(x[0] - 1e-6), upper=tuple(x[0] + 1e-6))
    weight = 0.1 * 9.81
    blow = Impulse(p=(1e6 * weight * 1e-4, 0, 0), duration=1e-4, region=first)
    s = solver(blow, x=x, precision="float32")
    s.advance(2e-3)
    assert np.all(np.isfinite(s.state.v.numpy()))
    np.testing.assert_allclose(momentum(s)[0], blow.p[0], rtol=1e-4)


def test_forces_follow_their_profile():
    """Free flight under a = a0 sin(2 pi f t): v = a0 / (2 pi f) (1 - cos)."""
    push = Acceleration(a=(0.0, 2.0, 0.0), profile=Sine(frequency=4.0))
    s = solver(push, ceiling=1e-3)
    s.advance(0.3)
    middle = 0.3 - s.clock.last_dt / 2
    exact = 2.0 / (2 * np.pi * 4) * (1 - np.cos(2 * np.pi * 4 * middle))
    np.testing.assert_allclose(s.state.v.numpy()[:, 1], exact, rtol=5e-3)


def test_a_force_in_a_window_with_a_profile_stops():
    beat = Keyframes(times=(0.0, 0.01), factors=(1.0, 3.0))
    s = solver(TotalForce(f=(5.0, 0, 0), start=0.01, end=0.02, profile=beat))
    s.advance(0.05)
    np.testing.assert_allclose(momentum(s), [5.0 * 2 * 0.01, 0, 0], rtol=0, atol=1e-10)


def test_wind_draws_things_along_at_its_rate():
    wind = Wind(v=(0.0, 4.0, 0.0), rate=20.0)
    s = solver(wind)
    s.advance(0.05)
    exact = 4.0 * (1 - np.exp(-20.0 * (0.05 - s.clock.last_dt / 2)))
    np.testing.assert_allclose(s.state.v.numpy()[:, 1], exact, rtol=1e-9)
    storm = solver(Wind(v=(0.0, 4.0, 0.0), rate=1e6))
    storm.advance(0.02)
    np.testing.assert_allclose(storm.state.v.numpy()[:, 1], 4.0, rtol=1e-9)


def test_wind_that_is_over_drags_no_more():
    s = solver(Wind(v=(0.0, 4.0, 0.0), rate=20.0, end=0.02))
    s.advance(0.02)
    before = momentum(s)
    s.advance(0.06)
    np.testing.assert_allclose(momentum(s), before, rtol=0, atol=1e-10)
    assert momentum(s)[1] > 1


@pytest.mark.parametrize("distance", [0.25, 0.5, 1.0, 2.0])
def test_attraction_is_linear_inside_and_inverse_square_outside(distance):
    s = solver(Attraction(centre=(distance, 0.0, 0.0), g=8.0, radius=0.5), x=np.zeros((1, 3)))
    s.step(1e-4, 1e-9)
    g = 8.0 * (distance / 0.5 if distance <= 0.5 else (0.5 / distance) ** 2)
    np.testing.assert_allclose(s.state.v.numpy()[0], [1e-4 * g, 0, 0], rtol=0, atol=1e-12)


def test_a_body_attracted_swings_through_the_point():
    """Inside the radius it is a spring of omega^2 = g / radius."""
    s = solver(Attraction(centre=(0.1, 0.0, 0.0), g=4.0, radius=1.0), ceiling=2e-3)
    s.advance(np.pi / 2)
    assert s.state.x.numpy()[:, 0].mean() == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("cylinder", [None, "x"])
def test_a_field_acts_on_what_is_inside_at_the_moment(cylinder):
    """v^2 grows by 2 a d over a slab of thickness d; beside it nothing happens."""
    place = Region(lower=(0.4, -1.0, -1.0), upper=(0.6, 1.0, 1.0), cylinder=cylinder)
    field = ZoneForce(place=place, a=(3.0, 0.0, 0.0))
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.9, 0.9] if cylinder else [0.0, 3.0, 0.0]])
    v = np.tile([2.0, 0.0, 0.0], (2, 1))
    s = solver(field, x=x, v=v, material=NeoHookean(E=10.0), ceiling=5e-4)
    s.advance(0.5)
    speeds = s.state.v.numpy()[:, 0]
    assert speeds[0] ** 2 == pytest.approx(2.0**2 + 2 * 3.0 * 0.2, rel=2e-3)
    assert speeds[1] == pytest.approx(2.0, rel=1e-12)


BLOWS = Keyframes(times=(0.0, 5e-4, 1e-3), factors=(0.0, 2.0, 0.0), repeat=True)
"""A mean of 1 in a period that is shorter than a substep."""


@pytest.mark.parametrize(
    "force",
    [
        Acceleration(a=(0.0, 100.0, 0.0), profile=BLOWS),
        Acceleration(a=(0.0, 100.0, 0.0), profile=BLOWS, region=Region()),
        ZoneForce(a=(0.0, 100.0, 0.0), profile=BLOWS),
        TotalForce(f=(0.0, 10.0, 0.0), profile=BLOWS),
        Wind(v=(0.0, 100.0, 0.0), rate=1.0, profile=BLOWS),
        Attraction(centre=(0.0, 1e3, 0.0), radius=1e3, g=100.0, profile=BLOWS),
        SetVelocity(v=(0.0, 1.0, 0.0), profile=BLOWS),
    ],
    ids=lambda force: force.kind,
)
def test_a_profile_shorter_than_the_substep_pushes_by_its_mean(force):
    """What a constant of the same mean does, by where the body gets in an eighth of a second."""
    constant = force.model_copy(update={"profile": Keyframes(factors=(1.0, 1.0))})
    quick, steady = solver(force), solver(constant)
    for item in (quick, steady):
        item.advance(0.1237)
        assert item.clock.substeps < 60
    ways = [item.state.x.numpy()[:, 1].mean() - block()[:, 1].mean() for item in (quick, steady)]
    assert ways[0] == pytest.approx(ways[1], rel=0.02)


def test_set_velocity_turns_and_scales_with_its_profile():
    turn = SetVelocity(spin=(0.0, 0.0, 3.0), centre=(0.1, 0.0, 0.0), profile=Ramp(duration=0.1))
    s = solver(turn)
    s.advance(0.05)
    s.step(1e-9, 1e-9)
    x, v = s.state.x.numpy(), s.state.v.numpy()
    expected = 0.5 * np.cross([0, 0, 3.0], x - [0.1, 0, 0])
    np.testing.assert_allclose(v, expected, atol=0.03)
    np.testing.assert_allclose(s.state.C.numpy()[0, 1, 0], 1.5, rtol=0.05)


def test_only_local_forces_launch_kernels():
    assert launches(solver(Gravity(), Acceleration(), TotalForce())) == set()
    assert launches(solver(Gravity(profile=Sine()))) == {"tracks"}
    assert launches(solver(Impulse())) == {"tracks"}
    for force, name in [
        (Gravity(region=LEFT), "region_force"),
        (TotalForce(region=LEFT), "region_force"),
        (ParticleForce(), "particle_force"),
        (ZoneForce(), "zone"),
        (Wind(), "wind"),
        (Attraction(), "attraction"),
        (SetVelocity(), "set_velocity"),
    ]:
        assert launches(solver(force)) == {name}


def test_forces_are_named_by_their_kind_and_refuse_nonsense():
    adapter = TypeAdapter(AnyForce)
    for force in (Impulse(), ZoneForce(), Wind(), Attraction(), Gravity(profile=Sine())):
        assert adapter.validate_python(force.model_dump()) == force
        assert adapter.validate_json(force.model_dump_json()) == force
    with pytest.raises(ValidationError, match="an impulse ends after its duration"):
        Impulse(end=1.0)
    with pytest.raises(ValidationError, match="must not repeat, and its mean must be positive"):
        Impulse(profile=Sine())
    with pytest.raises(ValidationError, match="remove `region`"):
        ZoneForce(region=LEFT)
    with pytest.raises(ValidationError, match="must be before end"):
        Gravity(start=2.0, end=1.0)


POINT = (0.0, 0.0, 0.0)


def grab(*targets: tuple[float, float, float], every: float = 0.01, **fields: object) -> Grab:
    times = tuple(every * i for i in range(len(targets)))
    options = {"point": POINT, "radius": 0.3, "stiffness": 100.0, "damping": 1.0, "strength": 1e3}
    return Grab(times=times, targets=targets, **(options | fields))


def centre(s: Solver, held: Grab) -> np.ndarray:
    """Return the current position of the point."""
    share = weights(s.model.rest, held.point, held.radius) * s.model.mass.numpy()
    return share @ s.state.x.numpy() / share.sum()


def test_the_impulse_is_that_of_the_force_between_hand_and_point():
    held = grab((0, 0, 1), (0, 0, 1))
    s = solver(held, ceiling=1e-4)
    gap = 1 - centre(s, held)[2]
    s.advance(1e-3)
    # Within a thousandth of a second the spring does not change; the damper takes a little.
    assert momentum(s)[2] == pytest.approx(
        100 * gap * (s.clock.time - s.clock.last_dt / 2), rel=0.03
    )


def test_the_force_has_a_largest_size_however_far_and_stiff():
    held = grab((0, 500, 0), (0, 500, 0), stiffness=1e12, strength=2.0)
    s = solver(held, ceiling=1e-4)
    s.advance(5e-3)
    np.testing.assert_allclose(
        momentum(s), [0, 2 * (s.clock.time - s.clock.last_dt / 2), 0], atol=1e-6
    )
    # Its stage says how much it accelerates a particle: the substeps need not guess.
    assert s.rejection.acceleration == pytest.approx(2.0 / _mass(s, held))


def _mass(s: Solver, held: Grab) -> float:
    return float(weights(s.model.rest, held.point, held.radius) @ s.model.mass.numpy())


def test_spring_of_any_stiffness_reaches_its_target():
    for stiffness in (1e4, 1e9):
        held = grab(POINT, (0.02, 0.05, 0), stiffness=stiffness, damping=900.0, every=0.1)
        s = solver(held.model_copy(update={"strength": 1e9}))
        s.advance(0.8)
        assert s.rejection.rejected == 0
        np.testing.assert_allclose(centre(s, held), (0.02, 0.05, 0), atol=2e-3)


def test_grab_acts_only_within_its_time():
    held = grab((0, 0, 1), (0, 0, 1), start=2e-3, end=4e-3)
    s = solver(held, ceiling=1e-4)
    s.advance(2e-3)
    assert not momentum(s).any()
    s.advance(6e-3)
    after = momentum(s)
    s.advance(8e-3)
    np.testing.assert_allclose(momentum(s), after, rtol=0, atol=1e-12)
    assert after[2] > 0


@pytest.mark.parametrize("point", [None, (0.0, 0.0, 0.1)], ids=["whole", "part"])
@pytest.mark.parametrize(("precision", "close"), [("float32", 2e-4), ("float64", 1e-9)])
def test_a_wrench_gives_its_momentum_and_its_angular_momentum(point, precision, close):
    force, torque = (3.0, -1.0, 0.5), (0.02, 0.01, -0.03)
    push = WrenchForce(force=force, torque=torque, point=point, radius=0.3, end=0.004)
    s = solver(push, precision=precision, ceiling=3.3e-4)
    mass = s.model.mass.numpy().astype(float)
    weight = mass * weights(s.model.rest, point, 0.3)
    arm = weight @ s.model.rest / weight.sum()
    s.advance(0.01)
    np.testing.assert_allclose(momentum(s), np.multiply(force, 0.004), atol=3 * close)
    # The force acts where the part is: its moment about the origin comes to the torque. The part
    # moves by less than a ten-thousandth of its arm meanwhile.
    result = diagnose(s).angular
    expected = np.add(np.cross(arm, force), torque) * 0.004
    np.testing.assert_allclose(result, expected, atol=2e-3 * np.linalg.norm(expected))


def test_a_wrench_follows_its_profile():
    push = WrenchForce(force=(2.0, 0, 0), end=0.01, profile=Ramp(duration=0.01))
    s = solver(push, ceiling=1e-3)
    s.advance(0.02)
    np.testing.assert_allclose(momentum(s), [0.01, 0, 0], rtol=0, atol=1e-9)


def test_a_line_of_particles_can_be_turned_and_a_point_cannot():
    line = np.zeros((5, 3))
    line[:, 0] = np.linspace(-0.2, 0.2, 5)
    for x in (line, np.array([[0.01, 0.0, 0.0]])):
        s = solver(WrenchForce(force=(0, 0, 0), torque=(1e-3, 0, 1e-3), end=0.01), x=x)
        s.advance(0.02)
        assert np.isfinite(s.state.v.numpy()).all()


def test_a_point_beside_the_object_is_refused_with_the_way_to_it():
    with pytest.raises(InputError, match=r"forces.point.*no material.*nearest material is 9"):
        solver(grab(POINT, POINT, point=(0, 0, 9.0 + block()[:, 2].max())))
    with pytest.raises(InputError, match="larger radius"):
        solver(WrenchForce(point=(0, 0, 50)))


def test_grabs_and_wrenches_refuse_nonsense():
    with pytest.raises(ValidationError, match="do not match"):
        Grab(times=(0, 1, 2), targets=((0, 0, 0), (0, 0, 1)))
    with pytest.raises(ValidationError, match="remove `profile`"):
        Grab(profile=Ramp())
    for kind in (Grab, WrenchForce):
        with pytest.raises(ValidationError, match="remove `region`"):
            kind(region={"lower": [0, 0, 0]})


def test_forces_can_be_replaced_between_two_substeps():
    single, other = WrenchForce(force=(1, 0, 0)), WrenchForce(force=(0, 2, 0), start=0.005)
    first = WrenchForce(force=(1, 0, 0), end=0.005)
    both = solver(first, other, ceiling=1e-3)
    changed = solver(single, ceiling=1e-3)
    for s in (both, changed):
        s.advance(0.005)
    changed.bind(forces=[first, other])
    for s in (both, changed):
        s.advance(0.012)
    assert np.array_equal(both.state.v.numpy(), changed.state.v.numpy())
    with pytest.raises(InputError):
        changed.bind(forces=[grab(POINT, POINT, point=(0, 0, 50))])
    before = changed.state.v.numpy().copy()
    changed.advance(0.013)
    # What was refused left the old forces in place.
    assert changed.state.v.numpy()[:, 1].mean() > before[:, 1].mean()
