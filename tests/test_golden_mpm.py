"""Parity with the recorded runs of PhysGaussian: laws point by point, whole runs as a whole.

PhysGaussian evolves F with the B-spline gradient, we (like the paper) with the MLS one, so whole
runs differ by the discretisation. `Original(mls=True)` is its solver with that one thing swapped:
what then remains of the difference is rounding.
"""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest

from phy124.materials import Hencky, Metal, Snow
from phy124.studies.validation.bodies import make_solver
from reference.material_point import evaluate
from reference.oracle import TWINS
from reference.physgaussian import MAPS, Original, Recording
from support.golden_runs import Exact, material_of, run, solver_of

EYE = np.eye(3)


@cache
def before(golden, case, step):
    """Return the original a substep before a step, from step 20 on; its state must not change."""
    original = Original(Recording.load(golden, case), 20)
    original.run(step - 1)
    return original


QUICK = ["c_metal_fall", "f5_bounding_box_slip"]
MORE = [
    "a_jelly_fall_sticky",
    "b_jelly_free_spin",
    "b4_jelly_pic",
    "d_sand_column",
    "e2_plasticine",
    "e3_snow",
    "f2_velocity_set",
    "f_impulse",
    "h_fluid_zong",
]


@pytest.mark.parametrize(
    "case", [*QUICK, *(pytest.param(case, marks=pytest.mark.slow) for case in MORE)]
)
def test_the_description_reproduces_the_recording(golden, case):
    """The other tests rely on this: `Original` is the program that made the golden data."""
    recording, step = Recording.load(golden, case), 100
    original = deepcopy(before(golden, case, step))
    original.run(step)
    assert np.abs(original.x - recording.at("x", step)).max() < 1e-5
    assert np.abs(original.v - recording.at("v", step)).max() < 2e-4
    assert np.abs(original.F_trial - recording.at("F_trial", step)).max() < 3e-4


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    "case",
    ["a_jelly_fall_sticky", "b_jelly_free_spin", "d_sand_column", "e2_plasticine", "h_fluid_zong"],
)
def test_stress_of_recorded_deformations(golden, case, precision):
    """tau(F) particle by particle, at all saved steps."""
    recording = Recording.load(golden, case)
    material = material_of(recording.meta["params"])
    for step in recording.data["steps"][1:]:
        F, stress = recording.at("F", step), recording.at("stress", step)
        intact = recording.at("mu", step) > 0 if case.startswith("e2") else np.ones(len(F), bool)
        if case.startswith("h"):
            intact = np.linalg.det(F) > 0.8  # a fluid's pressure is not theirs beyond that
        ours = evaluate(material, F, precision=precision).stress
        # Its float32 SVD leaves a noise of 1e-6 mu in a body at rest.
        scale = np.abs(stress).max() + 0.01 * material.theta()[0]
        assert np.abs(ours - stress)[intact].max() < 1e-3 * scale


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("case", ["c_metal_fall", "d_sand_column", "e2_plasticine"])
def test_return_maps_of_recorded_trials(golden, case, precision):
    """F_trial -> F at every saved step, where many particles flow, against the description."""
    recording = Recording.load(golden, case)
    material, flowed = material_of(recording.meta["params"]), 0
    for step in recording.data["steps"][1:]:
        original = Original(recording, step)
        F = MAPS[original.material](original, original.F_trial)
        h = np.zeros((len(F), 2))
        if case.startswith("e2"):
            h[:, 0] = (2000 - recording.at("yield_stress", step)) / 0.1
        ours = evaluate(material, original.F_trial, h=h, precision=precision).F
        assert np.abs(ours - F).max() < 1e-5
        flowed += int((np.abs(F - original.F_trial).max((1, 2)) > 1e-4).sum())
    assert flowed > 100


@pytest.mark.parametrize("case", ["c_metal_fall", "e2_plasticine"])
def test_trial_to_stress_lands_on_the_recording(golden, case):
    """From the F_trial one substep before: our map and stress against the saved F and stress."""
    recording = Recording.load(golden, case)
    original = before(golden, case, 100)
    h = np.zeros((len(original.x), 2))
    h[:, 0] = (2000 - original.limit) / 0.1
    material = material_of(recording.meta["params"])
    F = evaluate(material, original.F_trial, h=h, precision="float32").F
    assert np.abs(F - recording.at("F", 100)).max() < 3e-3
    assert np.quantile(np.abs(F - recording.at("F", 100)), 0.99) < 1e-5
    if case.startswith("e2"):
        stress, saved = evaluate(material, F).stress, recording.at("stress", 100)
        assert np.quantile(np.abs(stress - saved), 0.99) < 1e-4 * np.abs(saved).max()


CASES = {
    "a_jelly_fall_sticky": (0.005, 0.05),
    "b_jelly_free_spin": (0.005, 0.05),
    "d_sand_column": (0.005, 0.05),
    "h_fluid_zong": (0.005, 0.05),
    "f_impulse": (0.005, 0.05),
    # The original keeps C where it prescribes v; ours is that of the prescribed motion.
    "f2_velocity_set": (0.005, 0.15),
    # A body three cells wide hits walls at 1.9 m/s, or collapses: the gradients differ by more.
    "f5_bounding_box_slip": (0.02, 0.05),
    "e2_plasticine": (0.01, 0.05),
}
"""Largest difference of centre of mass [sizes] and of kinetic energy [largest in the run]."""


@pytest.mark.parametrize("case", CASES)
def test_runs_agree_within_the_discretisation(golden, case):
    """Centre of mass, J as a distribution, kinetic energy, at the last saved step."""
    recording, (offset, energy) = Recording.load(golden, case), CASES[case]
    solver, steps = solver_of(recording), recording.data["steps"][-1]
    run(solver, recording.meta["dt"], steps)
    mass = recording.data["mass"][:, None] / recording.data["mass"].sum()
    size = np.ptp(recording.data["x0"], axis=0).max()
    x, v = solver.state.x.numpy(), solver.state.v.numpy()
    assert np.linalg.norm((mass * (x - recording.at("x", steps))).sum(0)) < offset * size
    kinetic = [(mass * recording.at("v", k) ** 2).sum() for k in recording.data["steps"]]
    assert abs((mass * v**2).sum() - kinetic[-1]) < energy * max(kinetic)
    if case[0] in "abf":
        fractions = [0.05, 0.25, 0.5, 0.75, 0.95]
        J = np.linalg.det(solver.state.deformation.numpy())
        theirs = np.linalg.det(recording.at("F_trial", steps))
        np.testing.assert_allclose(
            np.quantile(J, fractions), np.quantile(theirs, fractions), atol=0.02
        )


def assert_the_difference_is_the_gradient(recording, steps):
    """Against the original with MLS gradients the runs agree particle by particle [m]."""
    solver = solver_of(recording, precision="float64")
    original = Original(recording, 0, mls=True)
    original.run(steps)
    run(solver, recording.meta["dt"], steps)
    assert np.abs(solver.state.x.numpy() - original.x).max() < 3e-5
    return solver, original


@pytest.mark.parametrize(
    "case",
    [
        pytest.param("b_jelly_free_spin", marks=pytest.mark.slow),
        pytest.param("f5_bounding_box_slip", marks=pytest.mark.slow),
        "f_impulse",
    ],
)
def test_the_difference_is_the_gradient_alone(golden, case):
    solver, original = assert_the_difference_is_the_gradient(Recording.load(golden, case), 80)
    assert np.abs(solver.state.v.numpy() - original.v).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("case", [case for case in CASES if not case.startswith("f2")])
def test_the_difference_is_the_gradient_alone_to_the_end(golden, case):
    recording = Recording.load(golden, case)
    if case.startswith("d"):
        pytest.skip("the original's sand has no volume correction")
    assert_the_difference_is_the_gradient(recording, recording.data["steps"][-1])


def test_original_stvk_stress_is_no_energy_derivative(golden):
    """Metal at step 400: its value, ours, and the energy's derivative."""
    recording = Recording.load(golden, "c_metal_fall")
    F, theirs = recording.at("F", 400), recording.at("stress", 400)
    material = material_of(recording.meta["params"])
    ours = evaluate(material, F).stress
    theta, step = np.array(material.theta()), 1e-5
    P = np.zeros_like(F)
    for i in range(3):
        for j in range(3):
            G = np.stack([F, F])
            G[0, :, i, j] += step
            G[1, :, i, j] -= step
            energy = [TWINS["metal"].energy(g, np.zeros((len(F), 2)), theta) for g in G]
            P[:, i, j] = (energy[0] - energy[1]) / (2 * step)
    derivative = P @ np.swapaxes(F, 1, 2)
    scale = np.abs(derivative).max()
    assert np.abs(ours - derivative).max() < 1e-5 * scale
    assert np.abs(theirs - derivative).max() > 0.02 * scale
    # The mistake is one factor: their value is ours times the stretch.
    values, U = np.linalg.eigh(F @ np.swapaxes(F, 1, 2))
    V = U * np.sqrt(values)[:, None] @ np.swapaxes(U, 1, 2)
    assert np.abs(theirs - ours @ V).max() < 1e-3 * scale


def test_the_originals_snow_has_no_stress_and_ours_has(golden):
    recording = Recording.load(golden, "e3_snow")
    F = recording.at("F", 100)
    assert np.all(recording.at("stress", 100) == 0)
    assert np.abs(F - EYE).max() > 0.05
    snow = Snow(E=1e5, nu=0.3, density=200.0)
    kept = evaluate(snow, F)
    assert np.abs(evaluate(snow, kept.F, h=kept.history).stress).max() > 1e3


def test_the_originals_slip_plane_is_sticky_and_ours_slips(golden):
    """The original stores zero for every surface type; a sliding block shows it."""
    recording = Recording.load(golden, "a_jelly_fall_sticky")
    recording.meta["bcs"][0]["point"] = [0, 0, float(recording.data["x0"][:, 2].min())]
    recording.data["v"][0] = [0.5, 0, 0]
    recording.data["v0"] = recording.data["v"][0]
    recording.meta["params"]["g"] = [0, 0, 0]
    original = Original(recording, 0)
    original.run(100)
    assert original.v[:, 0].mean() < 0.3
    solver = solver_of(recording)
    slippery = make_solver(
        recording.data["x0"],
        recording.data["vol"],
        [solver.model.materials[0]],
        dx=solver.model.dx,
        v=recording.data["v0"],
        boundaries=[Exact(point=recording.meta["bcs"][0]["point"], contact="slip")],
    )
    run(slippery, recording.meta["dt"], 100)
    np.testing.assert_allclose(slippery.state.v.numpy()[:, 0].mean(), 0.5, rtol=1e-5)


def test_plastic_gaussians_follow_the_total_deformation(golden):
    """The original exports the elastic F: a squashed block's Gaussians would keep their shape."""
    recording = Recording.load(golden, "c_metal_fall")
    solver = solver_of(recording)
    run(solver, recording.meta["dt"], 400)
    heights = [np.ptp(x[:, 2]) for x in (recording.data["x0"], solver.state.x.numpy())]
    squash = heights[1] / heights[0]
    stretch = np.median(solver.state.deformation.numpy()[:, 2, 2])
    elastic = np.median(recording.at("F_trial", 400)[:, 2, 2])
    assert squash < 0.9
    assert abs(stretch - squash) < 0.08
    assert abs(elastic - squash) > 2 * abs(stretch - squash)


def test_hencky_is_what_their_stvk_was_meant_to_be():
    F = np.diag([1.3, 1.0, 0.8])[None]
    assert np.allclose(
        evaluate(Hencky(), F).stress, evaluate(Metal(E=1e5, nu=0.3), F).stress, rtol=1e-6
    )
