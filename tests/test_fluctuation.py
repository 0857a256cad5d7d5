"""Transfers that keep what the grid does not carry: AFLIP and XPIC."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Scheme
from phy124.scene import Scene
from phy124.studies.validation.accuracy.problems import angular_momentum
from phy124.studies.validation.bodies import block, make_solver

SOFT = NeoHookean(E=2e4)


def shaken(scheme, *, speed=0.3, **options):
    """A block of random velocities."""
    rng = np.random.default_rng(1)
    x = block(8, 0.4)
    v = rng.normal(scale=speed, size=x.shape)
    volume = np.full(len(x), 0.05**3)
    return make_solver(x, volume, [SOFT], dx=0.1, v=v, scheme=scheme, **options)


def test_a_share_of_nothing_is_apic_bit_for_bit():
    plain, none = shaken(Scheme()), shaken(Scheme(1, 0.0))
    for solver in (plain, none):
        solver.advance(0.02)
    assert plain.fluctuation is None
    assert np.array_equal(plain.state.x.numpy(), none.state.x.numpy())
    assert np.array_equal(plain.state.C.numpy(), none.state.C.numpy())


def test_all_of_it_is_flip_which_loses_nothing_in_a_still_grid():
    """Without stress and forces the grid's velocities stay: the particles keep theirs, too."""
    free = shaken(Scheme(1, 1.0))
    v, C = free.state.v.numpy(), free.state.C.numpy()
    free.step(1e-9, 1e-9)
    assert np.allclose(free.state.v.numpy(), v, atol=1e-5)
    assert np.allclose(free.state.C.numpy(), C, atol=1e-4)


def test_two_passes_keep_what_two_round_trips_leave():
    """v + D v - D D v, and a third pass changes less than the second."""
    kept = []
    for passes in (0, 2, 3, 5):
        solver = shaken(Scheme(passes))
        before = diagnose(solver).kinetic
        solver.step(1e-9, 1e-9)
        kept.append(diagnose(solver).kinetic / before)
    gains = np.diff(kept)
    assert 0 < kept[0] < kept[-1] < 1
    assert gains[0] > gains[1] > 0


@pytest.mark.parametrize("scheme", [Scheme(1, 0.95), Scheme(3)])
def test_round_trip_keeps_linear_and_angular_momentum(scheme):
    solver = shaken(scheme)
    first, turn = diagnose(solver).momentum, angular_momentum(solver)
    solver.step(1e-9, 1e-9)
    scale = float(np.linalg.norm(turn))
    assert np.allclose(angular_momentum(solver), turn, atol=1e-5 * scale)
    solver.advance(0.02)
    assert np.allclose(diagnose(solver).momentum, first, atol=1e-4 * np.abs(first).max())


def test_two_threads_compute_what_one_does():
    single, two = shaken(Scheme(2), threads=1), shaken(Scheme(2), threads=2)
    for solver in (single, two):
        solver.advance(0.02)
    assert len(two.workers) == 2
    assert np.allclose(single.state.x.numpy(), two.state.x.numpy(), atol=1e-5)


def test_a_run_continues_bit_for_bit_from_a_snapshot():
    whole, half = shaken(Scheme(2)), shaken(Scheme(2))
    for solver in (whole, half):
        solver.advance(0.01)
    rest = shaken(Scheme(2))
    rest.restore(half.snapshot())
    for solver in (whole, rest):
        solver.advance(0.02)
    assert np.array_equal(whole.state.v.numpy(), rest.state.v.numpy())


@pytest.mark.slow
def test_double_precision_keeps_momentum_to_rounding():
    solver = shaken(Scheme(3), precision="float64")
    first = diagnose(solver).momentum
    solver.advance(0.02)
    assert np.allclose(diagnose(solver).momentum, first, rtol=0, atol=1e-12)


def test_a_scene_asks_for_it_and_pays_in_the_forecast():
    plain = Scene()
    asked = Scene.from_data({"accuracy": {"transfer": "xpic3"}})
    assert (asked.resolution.passes, asked.resolution.share) == (3, 1.0)
    assert "transfer" not in plain.resolution.model_dump()
    half = Scene.from_data({"accuracy": {"transfer": "aflip", "blend": 0.5}})
    assert (half.resolution.passes, half.resolution.share) == (1, 0.5)


def test_a_blend_that_nothing_reads_is_refused():
    with pytest.raises(InputError, match=r"blend = 0.5: it needs transfer"):
        Scene.from_data({"accuracy": {"transfer": "xpic2", "blend": 0.5}})
