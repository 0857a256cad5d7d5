"""The solver against known answers: coarse grids here, fine ones in the slow run, one code."""

import json

import numpy as np
import pytest
import warp as wp

from phy124.__main__ import main
from phy124.commands import accuracy
from phy124.kernels.forces import make_vortex
from phy124.materials import NeoHookean
from phy124.studies.validation.accuracy import problems, verify
from phy124.studies.validation.accuracy.verify import CHECKS, Verdict


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_known_answers_on_coarse_grids(check):
    verdicts = list(check(False, "cpu"))
    assert verdicts
    assert all(verdict.passed for verdict in verdicts), verdicts


@pytest.mark.slow
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_known_answers_on_fine_grids(check):
    verdicts = list(check(True, "cpu"))
    assert verdicts
    assert all(verdict.passed for verdict in verdicts), verdicts


def test_a_wrong_answer_and_a_wrong_order_fail():
    good = Verdict("p", "q", 0.01, 0.02, (8, 16), 2.0, (1.8, 2.2))
    assert good.passed
    assert not Verdict("p", "q", 0.03, 0.02, (8, 16), 2.0, (1.8, 2.2)).passed
    assert not Verdict("p", "q", 0.01, 0.02, (8, 16), 1.0, (1.8, 2.2)).passed
    assert not Verdict("p", "q", 0.01, 0.02, (8, 16), None, (1.8, 2.2)).passed
    assert not Verdict("p", "q", float("nan"), 0.02).passed


def test_bar_with_a_wrong_frequency_is_detected(monkeypatch):
    exact = problems.bar_frequency
    monkeypatch.setattr(problems, "bar_frequency", lambda *args: 1.02 * exact(*args))
    (verdict,) = verify.vibrating_bar(False, "cpu")
    assert not verdict.passed


def test_frequency_error_of_the_bar_is_the_one_of_the_scheme():
    """-0.09 (k dx)^2, k = pi: the grid makes it slower, as Fourier analysis of MLS-MPM says."""
    error = problems.vibrating_bar(16)
    assert -0.11 < error / (np.pi / 16) ** 2 < -0.08


def test_half_a_kick_is_what_makes_the_fall_exact():
    """Without it symplectic Euler is off by g T dt / 2, far more than is allowed."""
    assert problems.free_fall(time=0.1) < 1e-13
    way = np.linalg.norm(problems.fall(np.zeros(3), np.zeros(3), 0.1))
    assert 9.81 * 0.1 * 1e-3 / 2 / way > 1e-3


def vortex_force(x: np.ndarray, time: float, problem: problems.Vortex) -> np.ndarray:
    """Force per mass at points [P,3] from the kernel."""
    stiffness = problem.material.lame[0] / problem.material.density
    middle, width = (problem.inner + problem.outer) / 2, problem.outer - problem.inner
    ring = wp.vec4d(middle, width, problem.amplitude, stiffness)
    clock = wp.array([1.0, 0.0, time], dtype=wp.float64, device="cpu")
    v = wp.zeros(len(x), dtype=wp.vec3d, device="cpu")
    points = wp.array(x, dtype=wp.vec3d, device="cpu")
    wp.launch(make_vortex(wp.float64), len(x), [ring, clock, points], [v], device="cpu")
    return v.numpy()


def test_the_vortex_solves_the_equation_of_motion():
    """rho a = Div P + rho b, a and P by differences of the exact motion alone."""
    problem, time, h = problems.Vortex(amplitude=0.3), 0.3, 1e-4
    rho, (mu, lam) = problem.material.density, problem.material.lame
    angle = np.linspace(0.1, 6, 7)
    radius = np.linspace(0.8, 1.2, 7)
    X = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)

    def deformation(points: np.ndarray) -> np.ndarray:
        steps = h * np.eye(3)
        columns = [
            (problem.position(points + s, time) - problem.position(points - s, time)) / (2 * h)
            for s in steps
        ]
        return np.stack(columns, axis=2)

    def stress(points: np.ndarray) -> np.ndarray:
        F = deformation(points)
        inverse = np.linalg.inv(F).transpose(0, 2, 1)
        logJ = np.log(np.linalg.det(F))[:, None, None]
        return mu * (F - inverse) + lam * logJ * inverse

    divergence = sum(
        (stress(X + h * e) - stress(X - h * e))[:, :, k] / (2 * h) for k, e in enumerate(np.eye(3))
    )
    later, now, before = (problem.position(X, time + s) for s in (h, 0, -h))
    a = (later - 2 * now + before) / h**2
    b = vortex_force(now, time, problem)
    assert np.abs(rho * a - divergence - rho * b).max() < 1e-4 * np.abs(rho * b).max()


def test_the_ring_has_no_stress_at_its_edges():
    problem = problems.Vortex()
    edges = np.array([problem.inner, problem.outer])
    assert np.abs(problem.angle(edges, 0.5)).max() < 1e-15
    slope = (problem.angle(edges + 1e-6, 0.5) - problem.angle(edges - 1e-6, 0.5)) / 2e-6
    assert np.abs(slope).max() < 1e-9


def test_order_is_in_the_material_not_in_the_problem():
    """The vortex holds for any stiffness: a twice as stiff ring is as accurate."""
    stiff = problems.Vortex(material=NeoHookean(E=2000.0, nu=0.3, density=1000.0))
    assert problems.vortex(32, problem=stiff) < 0.05


def test_verification_runs_on_the_selected_device(monkeypatch):
    seen = []
    monkeypatch.setattr(verify, "CHECKS", (lambda fine, device: seen.append(device) or (),))
    monkeypatch.setattr(accuracy, "pick_device", lambda name: f"picked {name}")
    assert main(["accuracy", "--verify", "--device", "cuda:0"]) == 0
    assert seen == ["picked cuda:0"]


def test_an_error_that_is_nan_on_one_grid_fails(monkeypatch):
    errors = iter([1e-9, np.nan, 1e-9])
    monkeypatch.setattr(
        problems, "hydrostatic_column", lambda *_: dict.fromkeys(("mean", "inside"), next(errors))
    )
    assert not any(verdict.passed for verdict in verify.hydrostatic_column(False, "cpu"))


@pytest.mark.parametrize(
    "options", [["press"], ["--out", "x"], ["--levels", "8", "10", "12"], ["--generator", "lgm"]]
)
def test_verification_refuses_options_of_a_study(monkeypatch, capsys, options):
    monkeypatch.setattr(verify, "CHECKS", ())
    assert main(["accuracy", "--verify", *options]) == 2
    name = options[0] if options[0].startswith("--") else "SCENE"
    assert f"Remove {name} or --verify" in capsys.readouterr().err


def test_verify_on_the_command_line(capsys, monkeypatch):
    monkeypatch.setattr(verify, "CHECKS", (verify.free_fall,))
    assert main(["accuracy", "--verify"]) == 0
    text = capsys.readouterr().out
    assert text.count("pass  free fall") == 2
    assert "all as expected" in text
    monkeypatch.setattr(problems, "free_fall", lambda **_: 0.5)
    assert main(["accuracy", "--verify", "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["passed"] is False
    assert result["checks"][0]["value"] == 0.5
