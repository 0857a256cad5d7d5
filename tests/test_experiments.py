"""Experiments of the literature: their theories, what is made of three grids, how they are run."""

import errno
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.commands import validate
from phy124.commands.validate import Validate
from phy124.errors import Cancelled, InputError
from phy124.progress import silent
from phy124.studies.validation.bodies import ball_of_shells, lattice, sheet
from phy124.studies.validation.experiments import (
    EXPERIMENTS,
    Experiment,
    Quantity,
    beam,
    dam_break,
    find_experiment,
    hertz,
    incline,
    liquids,
    middle_axis,
    pressed_block,
    restitution,
    sand_column,
    terminal_speed,
)
from phy124.studies.validation.experiments import page as page_module
from phy124.studies.validation.experiments import running as running_module
from phy124.studies.validation.experiments.elastic_ball import Law, fit_law
from phy124.studies.validation.experiments.experiment import Outcome, estimate
from phy124.studies.validation.experiments.page import data, details, save_page, summary
from phy124.studies.validation.experiments.running import (
    Measured,
    Run,
    conclude,
    list_runs,
    measure_run,
    run_all,
)

QUARTER = Quantity.within("a quarter", 0.25, 0.02)


def made(**changes) -> Experiment:
    """An experiment that needs no solver: its error is 1 / cells^2."""
    options = {
        "name": "made",
        "title": "Made",
        "source": "nobody",
        "measured": "A number.",
        "band": "2 %",
        "published": lambda: (QUARTER,),
        "run": lambda cells: (0.25 + cells**-2,),
        "control": lambda cells: (0.5 + cells**-2,),
        "mistake": "twice as much",
        "grids": (4, 6, 8),
        "across": "it",
    }
    return Experiment(**{**options, **changes})


def result(experiment: Experiment) -> Outcome:
    """Return the outcome of an experiment, computed in this process."""
    grids = [
        Measured(Run(experiment.name, n, False), experiment.run(n), 1.0) for n in experiment.grids
    ]
    coarse = experiment.grids[0]
    control = Measured(Run(experiment.name, coarse, True), experiment.control(coarse), 1.0)
    return conclude(experiment, [*grids, control])


def test_every_experiment_is_declared_whole():
    names = [each.name for each in EXPERIMENTS]
    assert len(set(names)) == len(names) == 24
    for each in EXPERIMENTS:
        quantities = each.published()
        assert all(q.low <= q.published <= q.high for q in quantities), each.name
        assert all(math.isfinite(q.low) and q.low < q.high for q in quantities), each.name
        assert list(each.grids) == sorted(set(each.grids)), each.name
        assert bool(each.axis) == all(q.at is not None for q in quantities), each.name
        assert {*each.known} <= {q.name for q in quantities}, each.name
        assert bool(each.known) == bool(each.reason), each.name
    assert sum(each.quick for each in EXPERIMENTS) >= len(EXPERIMENTS) // 2


def test_the_elastica_is_that_of_the_tables():
    """Values of the published tables at 1 and 2; linear theory for small loads: a third of it."""
    assert beam.elastica_drop(1.0) == pytest.approx(0.30172, abs=1e-5)
    assert beam.elastica_drop(2.0) == pytest.approx(0.49346, abs=1e-5)
    assert beam.elastica_drop(1e-3) == pytest.approx(1e-3 / 3, rel=1e-3)
    assert beam.heavy_elastica_drop(1e-3) == pytest.approx(1e-3 / 8, rel=1e-3)


def test_impact_lasts_as_hertz_says_and_damping_slows_it():
    depth = restitution.SHALLOW
    lossless = restitution.solve_theory(0.0, depth, Law(0.0))
    assert lossless.restitution == pytest.approx(1.0, abs=1e-4)
    ways = np.cumsum(-lossless.speeds) * lossless.times[0:2].max() * restitution.speed(depth)
    assert ways.max() == pytest.approx(depth * restitution.RADIUS, rel=0.01)
    losses = [
        restitution.solve_theory(loss, depth, Law(0.0)).restitution for loss in (0.0, 0.02, 0.05)
    ]
    assert losses == sorted(losses, reverse=True)
    assert 0.9 < hertz.turning_time(fit_law(0.0, whole=True)) < 0.95, "a whole ball is stiffer"


def test_a_body_turns_over_as_euler_says():
    """A spin just off the middle axis, and three quarter periods until the second turn."""
    first, second = middle_axis.exact()
    assert second == pytest.approx(3 * first, rel=1e-4)
    a, b, c = middle_axis.moments(middle_axis.EDGES)
    assert a < b < c


def test_a_pressed_block_has_the_moduli_of_small_strain():
    nu = pressed_block.NU
    for axial, lateral, modulus in (
        (1 - 1e-6, 1.0, (1 - nu) / ((1 + nu) * (1 - 2 * nu))),
        (1 - 1e-6, 1 - 1e-6, 1 / (1 - 2 * nu)),
        (1 - 1e-6, 1 + 1e-6 * nu, 1.0),
    ):
        assert -pressed_block.stress(axial, lateral)[0] / 1e-6 == pytest.approx(modulus, rel=1e-4)


def test_sand_has_both_regimes_and_a_wider_angle_in_a_plane():
    assert sand_column.run_out(1.0, sand_column.LUBE) == 1.2
    assert sand_column.run_out(8.0, sand_column.LUBE) == pytest.approx(1.9 * 4)
    angle = sand_column.plane_strain(31.0)
    s = math.sin(math.radians(angle))
    assert 2 * math.sqrt(3) * s / (3 - s) == pytest.approx(math.sin(math.radians(31.0)))
    assert 22 < angle < 24


def test_speed_of_the_dam_ignores_a_delayed_start():
    time = np.linspace(0, 4, 41)
    front = 1 + time**2 / 4
    at_places, at_times = dam_break.mean_speeds(time, front)
    late_at_places, late_at_times = dam_break.mean_speeds(time + 0.25, front)
    assert late_at_places == pytest.approx(at_places)
    assert late_at_times < 0.95 * at_times


@pytest.mark.slow
def test_viscous_heap_spreads_at_the_rate_of_theory():
    """The exponent is 0.092, 0.109, 0.120, 0.124 and 0.127 with 3, 4, 6, 8 and 12 cells."""
    prefactor, exponent = liquids.spread(6, liquids.THICK, longer=2.0)
    assert prefactor == pytest.approx(liquids.SIMILARITY, rel=0.02)
    assert exponent == pytest.approx(0.125, rel=0.1)


def test_blocks_stay_where_friction_holds_them():
    assert incline.acceleration(0.3, 0.5) == 0.0
    assert incline.acceleration(1.0, 0.0) == pytest.approx(math.sqrt(0.5))


def test_ball_of_shells_and_lattice_have_their_sizes():
    x, volume = ball_of_shells(0.5, 0.1)
    assert volume.sum() == pytest.approx(math.pi / 6)
    assert np.linalg.norm(x, axis=1).max() == pytest.approx(0.45)
    assert lattice((2, 1, 3), 0.5, (1, 2, 3)).min(axis=0).tolist() == [1.25, 2.25, 3.25]
    assert sheet((2, 3), 0.5, (1, 2, 3)).min(axis=0).tolist() == [1.25, 2.0, 3.25]


def test_three_grids_give_the_value_of_none():
    """An error of second order is taken away; a mistake leaves the band."""
    first = result(made()).estimates[0]
    assert first.value == pytest.approx(0.25, abs=1e-6) and first.order == pytest.approx(
        2, abs=0.05
    )
    assert first.error == pytest.approx(1 / 64, rel=0.05)
    assert first.inside and first.control_outside


def test_diverging_grids_give_the_finest_and_the_spread():
    first = estimate((4, 6, 8), QUARTER, (0.25, 0.3, 0.2), 0.5)
    assert first.order is None and first.value == 0.2 and first.error == pytest.approx(0.1)


def test_value_inside_only_by_its_error_is_marked():
    """The limit is 0.27, the band ends at 0.26, and the finest grid is a hundredth away."""
    near = result(made(run=lambda cells: (0.27 + cells**-2,))).estimates[0]
    assert near.inside and near.by_its_error
    assert not result(made()).estimates[0].by_its_error
    assert "in by error" in "\n".join(details(result(made(run=lambda cells: (0.27 + cells**-2,)))))


def test_missed_band_is_reported_and_needs_a_reason():
    off = made(run=lambda cells: (0.3 + cells**-2 / 100,))
    missed = result(off)
    assert not missed.estimates[0].inside and not missed.good
    assert "+20.0 %, is new; the largest known deviation is +0.0 %" in "\n".join(details(missed))
    explained = result(made(run=off.run, reason="it leaks", known={QUARTER.name: 0.21}))
    assert explained.good and data(explained)["new"] == []
    said = "\n".join(details(explained))
    assert "OUTSIDE" in said and "it leaks" in said and "new" not in said


@pytest.mark.parametrize("value", [0.75, 0.2], ids=["too large", "too small"])
def test_a_reason_does_not_excuse_other_deviations(value):
    off = made(run=lambda cells: (value,), reason="it leaks", known={QUARTER.name: 0.21})
    seen = result(off)
    assert not seen.good and data(seen)["new"] == [QUARTER.name]


def test_shear_of_a_beam_is_that_of_timoshenko():
    """Integrals of bending moments and of shear forces, with nu = 0 and k = 5/6."""
    s = (np.arange(20_000) + 0.5) / 20_000 * beam.LENGTH
    rigidity = 5 / 6 * beam.E / 2 * beam.THICKNESS
    for shear, moment, force in (
        (beam.TIP_SHEAR, s, np.ones_like(s)),
        (beam.OWN_SHEAR, s**2 / 2, s),
    ):
        bent, sheared = (moment * s / beam.STIFFNESS).mean(), (force / rigidity).mean()
        assert shear * (beam.THICKNESS / beam.LENGTH) ** 2 == pytest.approx(
            sheared / bent, rel=1e-6
        )
    tip = beam.ELASTICA.published()[0]
    assert tip.high / tip.published == pytest.approx(1 + (1.2 + 0.2 / 12) / 144)


def test_a_control_that_is_not_measured_does_not_leave():
    unmeasured = result(made(control=lambda cells: (math.nan,)))
    assert not unmeasured.control_holds and not unmeasured.good
    assert middle_axis.find_turns(np.array([0.0, 1.0]), np.ones(2)) == (math.inf, math.inf)
    late = result(made(control=lambda cells: (math.inf,)))
    assert late.control_holds and json.loads(json.dumps(data(late), allow_nan=False))


def test_a_control_that_stays_inside_is_a_failure():
    vacuous = result(made(control=lambda cells: (0.25 + cells**-2,)))
    assert vacuous.estimates[0].inside and not vacuous.good
    assert "the control run also stays inside" in summary(vacuous)


def test_failed_run_is_reported_and_stops_no_other(monkeypatch):
    broken = made(run=lambda cells: (1 / (cells - 6),), grids=(4, 6, 8))
    monkeypatch.setattr(running_module, "find_experiment", lambda name: broken)
    (seen,) = run_all([broken], jobs=1, progress=silent)
    assert not seen.good and "ZeroDivisionError" in seen.failures[0]
    assert data(seen)["verdict"] == "FAILED"


def test_progress_stops_the_runs(monkeypatch):
    def stop(stage: str, done: int, total: int) -> None:
        assert (stage, total) == ("validate", 4)
        if done == 2:
            raise Cancelled

    monkeypatch.setattr(running_module, "find_experiment", lambda name: made())
    with pytest.raises(Cancelled):
        list(run_all([made()], jobs=1, progress=stop))


def test_experiments_that_are_done_survive_an_error(tmp_path, monkeypatch, capsys):
    """A process of the second is killed."""

    def fail_after_first(*_: object, **options: object):
        yield result(first)
        raise OSError(errno.EIO, "a process was killed")

    first = made(name="hertz")
    monkeypatch.setattr(validate, "run_all", fail_after_first)
    monkeypatch.setattr(validate, "EXPERIMENTS", [first, made(name="second")])
    monkeypatch.setattr(page_module, "save_plot", lambda outcome, path: path.touch())
    assert main(["validate", "--json", "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "a process was killed; 1 experiments were made" in said.err
    (row,) = json.loads((tmp_path / "out/experiments.json").read_text())
    assert json.loads(said.out) == {"good": False, "experiments": [row]}
    assert (tmp_path / "out/experiments.md").is_file()


def both() -> list[Outcome]:
    """Pages of an experiment with rows and of an experiment with a curve."""
    curve = made(
        name="other",
        title="Other",
        axis="x",
        run=lambda n: (0.25, 0.5 + 1 / n),
        published=lambda: (Quantity("a", 0.25, 0.2, 0.3, 1.0), Quantity("b", 0.5, 0.4, 0.6, 2.0)),
        control=lambda n: (0.9, math.nan),
    )
    return [result(made()), result(curve)]


def test_a_page_has_a_row_and_a_plot_for_each(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(page_module, "save_plot", lambda outcome, path: drawn.append(path.name))
    save_page(both(), tmp_path / "page.md", tmp_path / "plots", machine="Here.")
    page = (tmp_path / "page.md").read_text("utf-8")
    assert "| [made](#made) | 1 of 1 |" in page and "![Other](plots/other.svg)" in page
    assert drawn == ["made.svg", "other.svg"]


@pytest.mark.slow
def test_the_same_figures_give_the_same_plots(tmp_path):
    for folder in ("one", "two"):
        save_page(both(), tmp_path / "page.md", tmp_path / folder, machine="Here.")
    for name in ("made.svg", "other.svg"):
        first = (tmp_path / "one" / name).read_bytes()
        assert first.startswith(b"<?xml") and first == (tmp_path / "two" / name).read_bytes()


def test_a_falling_block_comes_to_its_terminal_speed():
    """The smallest experiment, run by its name."""
    done = measure_run(Run("terminal-speed", 4, False))
    assert not done.failure and len(done.values) == len(terminal_speed.TIMES) + 1
    *ways, speed = done.values
    assert speed == pytest.approx(terminal_speed.LIMIT, rel=5e-3)
    wanted = [terminal_speed.way(time) for time in terminal_speed.TIMES]
    assert ways == pytest.approx(wanted, rel=5e-3)


@pytest.mark.parametrize("press", [pressed_block.press, pressed_block.press_particles])
def test_a_pressed_block_is_as_stiff_as_its_law(press):
    """The forces come from the impulses of a plate."""
    stress, ratio = press(4, 1, 0, pressed_block.NU)
    assert stress / pressed_block.E == pytest.approx(1.0, rel=0.01)
    assert ratio == pytest.approx(pressed_block.NU, rel=0.01)


def test_names_are_refused_with_those_that_exist(capsys):
    with pytest.raises(InputError, match="elastica, elastica-mpm"):
        Validate(name="elastics").run()
    with pytest.raises(InputError, match="the page shows all experiments"):
        Validate(name="hertz", docs=True).run()
    assert Validate(list=True).run() == 0
    listed = capsys.readouterr().out
    assert all(each.name in listed for each in EXPERIMENTS)
    assert Validate(list=True, json=True).run() == 0
    assert [row["name"] for row in json.loads(capsys.readouterr().out)] == [
        each.name for each in EXPERIMENTS
    ]
    coarse, middle, fine = find_experiment("hertz").grids
    assert [run.cells for run in list_runs(find_experiment("hertz"))] == [
        fine,
        middle,
        coarse,
        coarse,
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", [each.name for each in EXPERIMENTS])
def test_an_experiment_comes_out_as_the_page_says(name, capsys):
    """The control leaves the band, and every value outside the band is a known deviation."""
    assert Validate(name=name, json=True).run() == 0
    output = json.loads(capsys.readouterr().out)
    assert output["good"] and output["experiments"][0]["control_holds"]


class Oscillators:
    """Springs of many stiffnesses, whose velocities are half a substep behind their positions."""

    def __init__(self):
        self.clock = SimpleNamespace(time=0.0)
        self.frequency = np.linspace(1.4, 1.64, 400) / 1e-3
        self.state = SimpleNamespace(v=Numbers(np.ones(400)), C=Numbers(np.zeros(400)))
        self.x = np.zeros(400)

    def advance(self, until):
        count = math.ceil((until - self.clock.time) / 1e-3)
        dt = (until - self.clock.time) / count
        for _ in range(count):
            self.state.v.values -= dt * self.frequency**2 * self.x
            self.x += dt * self.state.v.values
        self.clock.time = until


class Numbers:
    """An array on a device."""

    def __init__(self, values):
        self.values = values

    def numpy(self):
        return self.values

    def assign(self, values):
        self.values = values


def test_damping_of_a_beam_excites_no_fast_vibration():
    springs = Oscillators()
    beam._settle(springs, 5.0)
    assert (
        max(np.abs(springs.state.v.values).max(), np.abs(springs.frequency * springs.x).max()) < 1
    )
