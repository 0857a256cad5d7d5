"""The hard cases with their bounds, and proof that each of them can fail."""

import json
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import warp as wp

from phy124.__main__ import main
from phy124.studies.validation.stress import CASES, Setting, examine, limits
from phy124.studies.validation.stress.bodies import alike
from phy124.studies.validation.stress.case import at_least, lower
from phy124.studies.validation.stress.tips import PIERCED, check_depth, depth_in_body, hairs, needle
from support.processes import run_program

PACKAGE = Path(__file__).parents[1] / "phy124"
PRECISIONS = ["float32", pytest.param("float64", marks=pytest.mark.slow)]
"""Double precision takes as long again to compile, and rounds less."""
DEVICES = ["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)]


LONG = (21, 30, 31, 33, 34, 35, 36, 37)
"""Long cases; the tests of tips below, of laws, remedies and liquids run parts of them."""
MARKED = [
    pytest.param(
        case, marks=[pytest.mark.slow] * (case.number in LONG), id=f"{case.number}-{case.name}"
    )
    for case in CASES
]


@pytest.mark.usefixtures("coarse_solids")
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("case", MARKED)
def test_hard_case_holds(case, device, precision):
    """The bounds hold; SABOTAGE below names for each case what makes it fail."""
    if device != "cpu" and not wp.is_cuda_available():
        pytest.skip("this machine has no CUDA device")
    row, checks = examine(case, Setting(device, precision))
    assert row.verdict == "pass", [check.bound for check in checks if not check.holds] or row


@pytest.mark.parametrize(
    ("inside", "solver"), [pytest.param(hairs, "mpm", marks=pytest.mark.slow), (needle, "lattice")]
)
def test_hairs_and_a_needle_stay_above_the_floor(inside, solver):
    """Two of the ten runs of case 33, one for each solver."""
    assert check_depth(inside, 0.3, "draft", Setting(), solver).holds


def test_a_needle_stays_out_of_another_body():
    """One of the four runs of case 34."""
    assert depth_in_body(needle, "draft", Setting(), "mpm") <= PIERCED


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: str(case.number))
def test_hard_case_holds_at_full_length(case, precision):
    """100,000 substeps instead of 2,000, and so on: what `phy124 stress --all` runs."""
    row, checks = examine(case, Setting("cpu", precision, long=True))
    assert row.verdict == "pass", [check.bound for check in checks if not check.holds] or row


class Sabotage(NamedTuple):
    """A deliberate error: what it is, and where to replace what."""

    what: str
    file: str
    old: str
    new: str


SABOTAGE = {
    1: Sabotage("stress at rest is 1e-5 mu", "kernels/elastic.py",
                "log_volume(wp.determinant(F)) - theta[0]\n",
                "log_volume(wp.determinant(F)) - type(theta[0])(1.00001) * theta[0]\n"),
    2: Sabotage("nodes lighter than 1e-15 are left out, as PhysGaussian does", "kernels/grid.py",
                "if m > type(m)(0.0):", "if m > type(m)(1.0e-15):"),
    3: Sabotage("the first kick is a whole one", "mpm/solver.py",
                "self.step((clock.last_dt + dt) / 2, dt)", "self.step(dt, dt)"),
    4: Sabotage("half of C is lost on the way to the grid", "kernels/transfer.py",
                "affine = m * C[p]", "affine = real(0.5) * m * C[p]"),
    5: Sabotage("the limit uses the shear wave speed", "materials/base.py",
                "math.sqrt((3 * max(lam, 0) + 2 * mu) / self.density)",
                "math.sqrt(mu / self.density)"),
    6: Sabotage("forces are half as large again", "kernels/transfer.py",
                "(real(4.0) * clock[0]", "(real(6.0) * clock[0]"),
    7: Sabotage("forces are half as large", "kernels/transfer.py",
                "(real(4.0) * clock[0]", "(real(2.0) * clock[0]"),
    8: Sabotage("substeps are at least a microsecond", "mpm/timestep.py",
                '"elastic": _divide(', '"elastic": 1e-6 + _divide('),
    9: Sabotage("Poisson's ratio up to 0.7 is let in", "materials/base.py",
                "le=0.4999", "le=0.7"),
    10: Sabotage("the user's substep is an order", "mpm/timestep.py",
                 "limiter = min(limits, key=limits.__getitem__)",
                 'limiter = "user" if math.isfinite(ceiling) else min(limits, key=limits.get)'),
    11: Sabotage("forces are a tenth", "kernels/transfer.py",
                 "(real(4.0) * clock[0]", "(real(0.4) * clock[0]"),
    12: Sabotage("the logarithm is not continued for flat elements", "kernels/elastic.py",
                 "    if J > floor:\n", "    if J > type(J)(-1.0e30):\n"),
    13: Sabotage("at rest it is stressed by mu", "kernels/elastic.py",
                 "log_volume(wp.determinant(F)) - theta[0]\n",
                 "log_volume(wp.determinant(F)) - type(theta[0])(2.0) * theta[0]\n"),
    14: Sabotage("dropped rows are not counted", "io/content.py",
                 "int(np.count_nonzero(~good))", "0"),
    15: Sabotage("far particles stand still", "mpm/outliers.py",
                 "if not count:", "if count >= 0:"),
    16: Sabotage("truncation instead of floor", "kernels/transfer.py",
                 "return int(wp.floor(", "return int(("),
    17: Sabotage("a picometre is added to every axis", "kernels/native/deform.h",
                 "= scales0.data[g][k];", "= scales0.data[g][k] + 1e-12;"),
    18: Sabotage("invisible Gaussians stay", "particles/cleaning.py",
                 "INVISIBLE = 1 / 255", "INVISIBLE = -1.0"),
    19: Sabotage("all limit as if as dense as the heavy block", "kernels/measure.py",
                 "A * volume[p] / mass[p])", "A / real(1.0e5))"),
    20: Sabotage("no substep is ever taken back", "mpm/rejection.py", "if cells <= 1:", "if True:"),
    21: Sabotage("sand holds together in tension", "kernels/granular.py",
                 "if volume >= zero:", "if volume >= type(zero)(1.0e9):"),
    22: Sabotage("a wrong term of the series", "kernels/hencky.py",
                 "wp.vector(unit, unit / type(unit)(3.0),",
                 "wp.vector(unit, unit / type(unit)(4.0),"),
    23: Sabotage("columns count as orthogonal too early", "kernels/deform.py",
                 "TOLERANCE = wp.constant(wp.float64(4e-6))",
                 "TOLERANCE = wp.constant(wp.float64(4e-2))"),
    24: Sabotage("quaternions take the other sign", "kernels/native/deform.h",
                 "side = facing < 0.0", "side = facing > 0.0"),
    25: Sabotage("no compensated sum", "kernels/transfer.py",
                 "change = dt * v - residue_out[p]", "change = dt * v"),
    26: Sabotage("y offsets are x offsets", "kernels/transfer.py",
                 "- f[1] * cy", "- f[0] * cy"),
    27: Sabotage("launches are not recorded anew when the window moves", "mpm/solver.py",
                 "if self._moved:", "if False:"),
    28: Sabotage("a slab's nodes overwrite those of the one before", "kernels/grid.py",
                 "if added == 0:\n                    clear",
                 "if True:\n                    clear"),
    29: Sabotage("walls answer before the body has come to them", "kernels/columns.py",
                 "if m[1] * coverage(u[0]) >= enough:", "if m[0] > enough:"),
    30: Sabotage("what is too fast is told to be softer", "budget/remedies.py",
                 '"speed": ("push",)', '"speed": ("softer",)'),
    31: Sabotage("what flows meets walls node by node", "boundaries/base.py",
                 "return self.reach(dx) is None", "return False"),
    32: Sabotage("a free solid gives momentum and loses none", "kernels/free/exchange.py",
                 "(at3(trial, WALLS) - J) / mass", "at3(trial, WALLS) / mass"),
    33: Sabotage("walls take every body for a straight one", "kernels/columns.py",
                 "NARROWING = wp.constant(1.55)", "NARROWING = wp.constant(0.0)"),
    34: Sabotage("bodies touch half a cell too late", "kernels/pairs.py",
                 "return is_closed(here, more)",
                 "return is_closed(here + type(here)(0.5), more)"),
    35: Sabotage("the pressure of a liquid has the wrong sign", "kernels/liquid/pressure.py",
                 "right_out[n] = -wp.float64(flux)", "right_out[n] = wp.float64(flux)"),
    36: Sabotage("a liquid pulls bodies", "kernels/liquid/bodies.py",
                 "pushes_out[p] = total / duration", "pushes_out[p] = -total / duration"),
    37: Sabotage("bodies on lattices fall through the liquid", "liquid/immersed.py",
                 "lambda: lattice.crew.press(bodies.pushes, bodies.turns)", "lambda: None"),
}  # fmt: skip
"""One deliberate error per case, by its number."""

EXAMINE = """
import sys
sys.path.insert(0, sys.argv[1])
import phy124
assert phy124.__file__.startswith(sys.argv[1]), phy124.__file__
from phy124.studies.validation.stress import CASES, Setting, examine
from phy124.studies.validation.stress.bodies import alike
from phy124.studies.validation.stress.tips import (
    PIERCED,
    check_depth,
    depth_in_body,
    hairs,
    needle,
)
print(examine(CASES[int(sys.argv[2]) - 1], Setting())[0].verdict)
"""


def test_equal_bits_are_asked_of_a_cpu_only():
    first, other = np.ones(3), np.ones(3) + [0, 0, 1e-6]
    for device, holds in (("cpu", False), ("cuda:0", True)):
        assert alike("x", other, first, Setting(device)).holds == holds
        assert alike("x", first, first, Setting(device)).holds
    assert not alike("x", other, first, Setting("cuda:0", "float64")).holds


def test_values_that_become_nan_fail(monkeypatch):
    """The lowest and the highest of all values are NaN if one of them is."""
    monkeypatch.setattr(limits, "volume_ratios", lambda solver: np.array([1.0, np.nan]))
    stack = limits.heavy_on_light(1.0, Setting(), 1e-4)
    assert np.isnan(stack.min_J) and np.isnan(stack.max_J)
    assert not at_least("J", lower(1.0, np.nan), 0.9).holds


def test_every_case_has_a_sabotage():
    assert set(SABOTAGE) == {case.number for case in CASES} == set(range(1, 38))


@pytest.mark.parametrize("number", SABOTAGE)
def test_sabotages_fit_the_source(number):
    """The replaced code still exists; otherwise the slow test below would prove nothing."""
    sabotage = SABOTAGE[number]
    assert sabotage.old in (PACKAGE / sabotage.file).read_text()


@pytest.mark.slow
@pytest.mark.parametrize("number", SABOTAGE)
def test_a_broken_build_fails(number, tmp_path):
    """A copy of the package with one deliberate error fails its case (or dies trying)."""
    sabotage = SABOTAGE[number]
    shutil.copytree(PACKAGE, tmp_path / "phy124", ignore=shutil.ignore_patterns("__pycache__"))
    path = tmp_path / "phy124" / sabotage.file
    path.write_text(path.read_text().replace(sabotage.old, sabotage.new))
    run = run_program([sys.executable, "-c", EXAMINE, str(tmp_path), str(number)], cwd=tmp_path)
    verdict = (run.stdout.split() or ["died"])[-1]
    assert (verdict == "fail") or run.returncode < 0, (sabotage.what, run.stdout, run.stderr)


def test_the_command_prints_the_table(capsys):
    """Two cases are enough to see the form."""
    chosen = ["eight turns", "3"]
    assert main(["stress", *chosen, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [set(row) for row in rows] == [{"case", "bound", "measured", "verdict"}] * len(rows)
    assert len(rows) >= 4
    assert {row["verdict"] for row in rows} == {"pass"}
    assert main(["stress", *chosen, "--device", "cpu", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [row for row in rows if "cpu" in row["case"]]
    assert main(["stress", "free FALL"]) == 0
    assert "free fall (float32 on cpu)" in capsys.readouterr().out
