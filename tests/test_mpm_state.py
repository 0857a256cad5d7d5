"""Model, State and Clock: what is built, refused, kept and restored."""

import numpy as np
import pytest

from phy124.kernels.measure import COUNT
from phy124.materials import FixedCorotated, Metal, NeoHookean, Sand
from phy124.mpm import Clock, Model, State
from phy124.mpm.stage import launches
from phy124.mpm.timestep import Extremes, Maxima
from phy124.studies.validation.bodies import block


def model(*materials, **options) -> Model:
    x = block(4)
    return Model.of(x, np.full(len(x), 1e-6), materials or (NeoHookean(),), dx=0.2, **options)


def test_particles_must_be_sorted_by_law_and_have_a_volume():
    mixed = np.tile([0, 1], 32)
    with pytest.raises(ValueError, match="sorted by constitutive law"):
        model(NeoHookean(), Sand(), material=mixed)
    with pytest.raises(ValueError, match="volume above zero"):
        Model.of(block(2), np.zeros(8), [NeoHookean()], dx=0.2)


def test_equal_particles_share_one_row_of_parameters():
    made = model(NeoHookean(), FixedCorotated(), material=np.repeat([0, 1], 32))
    assert [len(group) for group in made.groups] == [32, 32]
    assert all(len(group.theta) == 1 for group in made.groups)
    varied = model(stiffness=np.linspace(1, 2, 64))
    assert len(varied.groups[0].theta) == 64
    assert made.total_mass == pytest.approx(64e-6 * 1000, rel=1e-6)


def test_only_plastic_laws_have_history_and_F_total():
    elastic, plastic = State.of(model()), State.of(model(Metal()))
    assert len(elastic.history) == len(elastic.total) == 0
    assert elastic.deformation is elastic.F
    assert len(plastic.history) == 64 and plastic.deformation is plastic.total


def test_a_state_returns_to_a_snapshot():
    state = State.of(model(), v=np.ones((64, 3)))
    kept = state.snapshot()
    state.v.fill_(7.0)
    state.restore(kept)
    assert (state.v.numpy() == 1).all()


def test_clock_restores_and_measures_after_violence():
    clock = Clock(model())
    clock.since_measured = 0
    clock.finish(1e-3)
    clock.count("elastic", needed=0.7)
    assert not clock.due
    kept = clock.snapshot()
    clock.finish(1e-3, violent=True)
    assert clock.due and clock.time == 2e-3
    clock.restore(kept)
    assert (clock.time, clock.substeps, clock.limiters) == (1e-3, 1, {"elastic": 1})
    assert clock.needed == {"elastic": 0.7}


def test_maxima_are_read_with_their_names():
    row = np.arange(float(COUNT))
    result = Maxima.of(row)
    assert result.extremes == Extremes(0.0, 1.0, 2.0)
    assert result.lower.tolist() == [-3, -4, -5] and result.upper.tolist() == [6, 7, 8]


def test_empty_launches_are_skipped():
    assert launches([("nothing", None)]) == []
