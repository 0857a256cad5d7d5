"""Forces on a part of the body: a hand that draws a point along, and wrenches."""

import numpy as np
import pytest
from pydantic import ValidationError

from phy124.errors import InputError
from phy124.forces import Grab, WrenchForce
from phy124.forces.held import weights
from phy124.monitor.diagnostics import Diagnostics
from phy124.mpm import Solver
from phy124.tracks import Ramp
from support.shapes import block
from test_forces import momentum, solver

POINT = (0.0, 0.0, 0.0)


def grab(*targets: tuple[float, float, float], every: float = 0.01, **fields: object) -> Grab:
    times = tuple(every * i for i in range(len(targets)))
    given = {"point": POINT, "radius": 0.3, "stiffness": 100.0, "damping": 1.0, "strength": 1e3}
    return Grab(times=times, targets=targets, **(given | fields))


def centre(s: Solver, held: Grab) -> np.ndarray:
    """Where the point is now."""
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


def test_it_holds_within_its_time_only():
    held = grab((0, 0, 1), (0, 0, 1), start=2e-3, end=4e-3)
    s = solver(held, ceiling=1e-4)
    s.advance(2e-3)
    assert not momentum(s).any()
    s.advance(6e-3)
    after = momentum(s)
    s.advance(8e-3)
    np.testing.assert_allclose(momentum(s), after, atol=1e-12)
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
    found = Diagnostics.of(s.model, s.state, s.clock).angular
    expected = np.add(np.cross(arm, force), torque) * 0.004
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.linalg.norm(expected))


def test_a_wrench_follows_its_profile():
    push = WrenchForce(force=(2.0, 0, 0), end=0.01, profile=Ramp(duration=0.01))
    s = solver(push, ceiling=1e-3)
    s.advance(0.02)
    np.testing.assert_allclose(momentum(s), [0.01, 0, 0], atol=1e-9)


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
    with pytest.raises(ValidationError, match="leave profile out"):
        Grab(profile=Ramp())
    for kind in (Grab, WrenchForce):
        with pytest.raises(ValidationError, match="leave region out"):
            kind(region={"lower": [0, 0, 0]})


def test_what_acts_can_be_replaced_between_two_substeps():
    one, other = WrenchForce(force=(1, 0, 0)), WrenchForce(force=(0, 2, 0), start=0.005)
    first = WrenchForce(force=(1, 0, 0), end=0.005)
    both = solver(first, other, ceiling=1e-3)
    changed = solver(one, ceiling=1e-3)
    for s in (both, changed):
        s.advance(0.005)
    changed.bind([first, other])
    for s in (both, changed):
        s.advance(0.012)
    assert np.array_equal(both.state.v.numpy(), changed.state.v.numpy())
    with pytest.raises(InputError):
        changed.bind([grab(POINT, POINT, point=(0, 0, 50))])
    before = changed.state.v.numpy().copy()
    changed.advance(0.013)
    # What was refused left the old forces in place.
    assert changed.state.v.numpy()[:, 1].mean() > before[:, 1].mean()
