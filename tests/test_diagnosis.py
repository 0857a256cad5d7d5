"""Diagnosis: which particle went wrong and what limits the substep, in words."""

import numpy as np
import pytest

from phy124.materials import NeoHookean, Rigid, Sand
from phy124.monitor.diagnostics import describe_particle, describe_substep, find_broken, name_law
from phy124.studies.validation.bodies import block, make_solver


@pytest.fixture
def solver():
    """Half a block of jelly, half of sand, in which one particle flies."""
    x = block(middle=(0, 0, 0.24))
    half = len(x) // 2
    v = np.zeros_like(x)
    v[half + 3] = 0, 0, 7
    made = make_solver(
        x,
        np.full(len(x), 1e-4),
        [NeoHookean(E=1e4), Sand(E=1e4)],
        dx=0.125,
        v=v,
        material=np.repeat([0, 1], [half, len(x) - half]),
        measure_every=1,
    )
    for time in (1e-4, 2e-4):  # the second substep measures what the first has left
        made.advance(time)
    return made


def spoil(array, index, value) -> None:
    values = array.numpy()
    values[index] = value
    array.assign(values)


def test_the_first_broken_particle_is_found_in_any_array(solver):
    assert not len(find_broken(solver.state))
    spoil(solver.state.F, (9, 1, 1), np.nan)
    assert find_broken(solver.state)[0] == 9
    spoil(solver.state.v, (4, 2), np.inf)
    assert find_broken(solver.state)[0] == 4


def test_a_law_has_the_name_that_scenes_use():
    x = block(2)
    body = make_solver(x, np.full(len(x), 1e-4), [Rigid(speed=1, strain=0.02)], dx=0.125)
    assert name_law(body.model, 0) == "rigid"
    soft = make_solver(x, np.full(len(x), 1e-4), [NeoHookean(E=1e4, damping=1)], dx=0.125)
    assert name_law(soft.model, 0) == "neo_hookean"


def test_a_particle_is_named_by_number_law_place_and_speed(solver):
    flying = len(solver.model) // 2 + 3
    assert name_law(solver.model, 0) == "neo_hookean"
    words = describe_particle(solver.model, solver.state, flying)
    speed = np.linalg.norm(solver.state.v.numpy()[flying])
    assert words.startswith(f"particle {flying} of law sand, at (")
    assert words.endswith(f"with {speed:.3g} m/s") and speed > 0.1
    spoil(solver.state.x, (flying, 0), np.nan)
    words = describe_particle(solver.model, solver.state, flying)
    assert words.endswith("m at rest"), "a position that is not finite is not written down"


def test_substep_limit_and_fastest_particle_are_named(solver):
    words = describe_substep(solver.model, solver.state, solver.clock)
    assert "limited by the stiffness of the material" in words
    assert f"fastest is particle {len(solver.model) // 2 + 3} of law sand" in words
