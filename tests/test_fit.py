"""Fits: the search on a formula, its refusals and intervals; slow ones on runs of scenes."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.ply import write_ply
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.fit.budget import Budget, Outlook
from phy124.studies.fit.declaration import Fit, parse_ranges
from phy124.studies.fit.estimate import estimate
from phy124.studies.fit.interval import (
    bootstrap,
    extrapolate,
    find_undetermined,
    find_unexplained,
    find_unseen,
    shift_values,
    suggest_experiment,
)
from phy124.studies.fit.observation import (
    Forces,
    Kind,
    Table,
    at_times,
    read_table,
    refuse_outside,
)
from phy124.studies.fit.points import Points
from phy124.studies.fit.problem import Distance, differentiate
from phy124.studies.fit.search import Start, refine, search
from phy124.studies.fit.target import Target
from support.clips import falling
from support.pages import PAGES, blocks
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

POINTS, INSTANTS = 20, np.linspace(0, 2, 25)
TRUTH = np.array([0.6, 0.35])
PLACES = (("x", "y", "z"), ("u", "v"))


class Oscillator:
    """Points that swing with one frequency and decay; the coarser the grid, the stiffer.

    `bent` is an error of the grid besides, of a shape that no value has.
    """

    def __init__(
        self, seed=0, *, noise=0.02, names=("k", "c"), grids=(16, 24), truth=TRUTH, bent=0.0
    ):
        random = np.random.default_rng(seed)
        self.names, self.grids, self.calls = names, grids, [0] * len(grids)
        self.heights = random.uniform(0.3, 1, POINTS)
        self.bend = bent * np.tile(np.cos(3 * np.pi * INSTANTS), POINTS)
        exact = self.swing(truth, 0.0)
        self.measured = exact + noise * random.standard_normal(exact.shape)
        self.groups = np.repeat(np.arange(POINTS), len(INSTANTS))
        self.kinds = [Kind("points", "m", slice(0, len(exact)))]

    def swing(self, place, spacing):
        """Heights of all points at all instants; a third value is a mass, a fourth does nothing."""
        k, c = 20 * 10 ** place[0] * (1 + 0.3 * spacing), 0.1 * 20 ** place[1]
        if len(place) > 2:
            k /= 10 ** place[2]
        return np.outer(self.heights, np.exp(-c * INSTANTS) * np.cos(k**0.5 * INSTANTS)).ravel()

    def predict(self, places, level):
        self.calls[level] += len(places)
        spacing = 1 / self.grids[level]
        return [self.swing(place, spacing) + spacing * self.bend for place in places]

    def late(self, part):
        return False


def test_a_damped_oscillator_is_found_on_an_infinitely_fine_grid():
    problem = Oscillator()
    result = estimate(problem)
    limit, errors = result.on(np.inf)
    assert np.all(np.abs(limit - TRUTH) < errors)
    assert abs(limit[0] - TRUTH[0]) < 0.2 * abs(result.places[1][0] - TRUTH[0])
    assert np.array_equal(result.on(24)[0], result.places[1])
    assert problem.calls[1] < problem.calls[0] / 4, "the finer grid is for the last steps only"


def test_a_search_out_of_time_keeps_the_best_point_of_all():
    """One generation around an excellent start is worse than the start."""
    problem = Oscillator(noise=0)
    distance = Distance(problem)
    start = Start(TRUTH + 1e-4, distance.cost(problem.predict([TRUTH + 1e-4], 0)[0]))
    problem.late = lambda part: problem.calls[0] > 1
    best = search(problem, distance, start, 0)
    assert problem.calls[0] > 1 and distance.cost(problem.predict([best], 0)[0]) <= start.cost
    assert distance.cost(np.full(len(problem.measured), np.nan)) == distance.cost(None)


def covered(seeds):
    """Return, for each value, how many intervals from measurements alone contain the true value."""
    held = np.zeros(2, int)
    for seed in seeds:
        problem = Oscillator(seed, grids=(1_000_000,))
        distance = Distance(problem)
        slopes = differentiate(problem, TRUTH, 0, 0.01)
        result = refine(problem, distance, TRUTH + 0.02, slopes, 0)
        weighted = distance.weigh(result.jacobian), distance.residual(result.predicted)
        spread = bootstrap(*weighted, problem.groups, problem.kinds, seed)
        held += np.abs(result.place - TRUTH) <= spread.errors
    return held


def test_intervals_hold_the_truth():
    assert np.all(covered(range(25)) >= 22)
    assert np.all(covered(range(25)) <= 25)


@pytest.mark.slow
def test_intervals_hold_the_truth_in_90_of_100_seeds():
    assert np.all(covered(range(100)) >= 90)
    result = [estimate(Oscillator(seed), seed=seed) for seed in range(100)]
    held = sum(np.abs(item.on(np.inf)[0] - TRUTH) <= item.on(np.inf)[1] for item in result)
    assert np.all(held >= 90)


def test_intervals_hold_the_truth_if_forces_have_correlated_errors():
    """The errors of the forces on a wall are an AR(1) process with coefficient 0.8."""
    frames, held = 96, 0
    shape = np.stack([np.sin(6 * (t := np.linspace(0, 1, frames))), 0 * t, 1 - np.exp(-5 * t)], 1)
    names = np.full(frames, "floor")
    table = Table(np.arange(frames) / 24, names, shape, ("fx", "fy", "fz"))
    groups, kinds = Forces(table, ("floor",)).groups, [Kind("forces", "N", slice(0, 3 * frames))]
    for seed in range(100):
        errors = np.random.default_rng(seed).normal(size=shape.shape)
        errors[1:] *= 0.6
        for k in range(1, frames):
            errors[k] += 0.8 * errors[k - 1]
        slope = shape.reshape(-1, 1)
        value = float(slope[:, 0] @ errors.ravel() / (slope**2).sum())
        spread = bootstrap(slope, slope[:, 0] * value - errors.ravel(), groups, kinds, seed)
        held += abs(value) <= spread.errors[0]
    assert 88 <= held <= 100


def test_fit_of_stiffness_and_mass_is_refused():
    problem = Oscillator(
        names=("material.E", "material.damping", "material.density"),
        truth=np.array([0.6, 0.35, 0.5]),
    )
    with pytest.raises(InputError, match=r"material\.E, material\.density: .* the same way"):
        estimate(problem)
    assert sum(problem.calls) < 40


def test_parameter_without_effect_is_refused():
    names = ("material.E", "material.damping", "material.density", "boundaries.0.friction")
    problem = Oscillator(names=names, truth=np.full(4, 0.5))
    with pytest.raises(InputError, match=r"friction: no measurement .* slope"):
        estimate(problem)


def test_a_vague_value_is_refused():
    assert find_undetermined(("a", "b"), np.array([0.1, 0.2]), np.zeros(2), np.eye(2)) is None
    blind = find_undetermined(("a", "b"), np.array([0.1, 0.7]), np.zeros(2), np.diag([0.01, 0.1]))
    assert blind.names == ("b",)
    assert "1.4 times the range" in str(blind)


def test_misfits_on_two_grids_tell_the_error_of_the_finer_one():
    """m^2 = a^2 + (c h)^2: errors of the measurements cancel."""
    coarse, fine = (np.hypot([0.5, 2.0, 1.0], np.array([3.0, 0, 6]) / n) for n in (12, 16))
    assert np.allclose(find_unexplained((12, 16), coarse, fine) * fine, [3 / 16, 0, 6 / 16])
    assert find_unexplained((12, 16), [1.0], [1.1]) == 0


def test_no_error_of_a_size_shifts_values_further():
    """By least squares; the error that looks most like the effect of a value shifts it so far."""
    random, kinds = np.random.default_rng(0), Oscillator().kinds
    slopes, groups = random.standard_normal((500, 2)) @ [[1, 0.6], [0, 1]], np.arange(500) // 25
    reach = shift_values(slopes, np.array([0.5]), groups, kinds)
    solve = np.linalg.pinv(slopes)
    errors = np.concatenate([random.standard_normal((200, 500)), solve])
    errors *= 0.5 * np.sqrt(20) / np.linalg.norm(errors, axis=1, keepdims=True)
    shifts = np.abs(errors @ solve.T)
    assert np.allclose(shifts.max(axis=0), reach, rtol=1e-6)
    assert np.allclose(np.diag(shifts[-2:]), reach, rtol=1e-6)


@pytest.mark.parametrize("bent", [0.3, 5.0])
def test_the_error_of_the_grid_widens_an_interval(bent):
    result = estimate(Oscillator(bent=bent))
    limit, errors = result.on(np.inf)
    assert np.all(np.abs(limit - TRUTH) < errors)
    assert result.model[1] > bent * estimate(Oscillator()).sampling[1]


def test_a_value_that_the_error_of_the_grid_hides_is_refused():
    with pytest.raises(InputError, match=r"c: the grid's error .* times the range.* To determine"):
        estimate(Oscillator(bent=20.0))


def test_independent_effects_are_distinguished():
    assert find_unseen(("a", "b"), np.array([[1.0, 0.5], [0, 1], [0, 0]]), 1.0) is None


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["material.E", "material.density"], "force on a wall"),
        (["parts.0.material.E", "parts.0.material.density"], "newtons"),
        (["material.nu"], "sides"),
        (["object.velocity.2"], "fly"),
        (["view.fov"], "another load"),
    ],
)
def test_an_experiment_is_named(names, words):
    assert words in suggest_experiment(names)


def test_richardson_takes_the_first_power():
    places = [np.array([0.6]), np.array([0.55])]
    assert np.allclose(extrapolate((16, 32), places, np.inf), [[0.5], [0.05]])
    assert np.allclose(extrapolate((16, 32), places, 64), [[0.525], [0.025]])
    assert extrapolate((16,), places[:1], 32)[1] == 0


@pytest.mark.parametrize(
    ("text", "kind"), [("1e4..1e6", "log_uniform"), ("0.2..0.45", "uniform"), ("-1..1", "uniform")]
)
def test_ranges(text, kind):
    declared = Fit.from_data({"target": "x", "find": parse_ranges((f"material.E={text}",))})
    assert list(declared.find["material.E"].model_dump()) == [kind]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"find": {"material.E": "1e6..1e4"}}, "not smaller"),
        ({"find": {"material.E": "soft"}}, "not a range"),
        ({"find": {}}, "find"),
        ({"find": {"time.frames": "1..5"}}, r"time\.frames is a setting of the run"),
        ({"find": {"accuracy.cells": "8..16"}}, r"accuracy\.cells is a setting of the run"),
        ({"find": {"material.E": "1..2"}, "grids": [24, 16]}, "finer"),
        ({"find": {"material.E": "1..2"}, "secondes": 3}, "secondes"),
    ],
)
def test_bad_declarations(data, words):
    with pytest.raises(InputError, match=words):
        Fit.from_data({"target": "points.csv", **data})


@pytest.mark.parametrize("text", ["material.E", "=1..2"])
def test_invalid_ranges_of_a_path(text):
    with pytest.raises(InputError, match="LEAST"):
        parse_ranges((text,))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "The first line must begin with time,id,x,y,z or time,id,u,v"),
        ("time,id,x,y\n0,a,1,2\n", "its first line is 'time,id,x,y'"),
        ("time,id,x,y,z\n", "no rows"),
        ("time,id,x,y,z\n0,a,1,2,nan\n", r"row 1 \(0,a,1,2,nan\)"),
        ("time,id,x,y,z\n0,a,1,2,3\n0,a,1,2\n", "row 2"),
        ("time,id,x,y,z\n0,a,one,2,3\n", "finite"),
    ],
)
def test_bad_tables(tmp_path, content, words):
    (tmp_path / "points.csv").write_text(content)
    with pytest.raises(InputError, match=words):
        read_table(tmp_path / "points.csv", "target", "id", PLACES)


def test_a_table_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "none.csv", "target", "id", PLACES)


def test_a_target_longer_than_the_scene():
    with pytest.raises(InputError, match=r"until 2 s.*time\.seconds=2\.1"):
        refuse_outside("target", "x.csv", np.array([0.0, 2.0]), 0.5)
    with pytest.raises(InputError, match="begins at -1 s"):
        refuse_outside("target", "x.csv", np.array([-1.0, 0.2]), 0.5)


def tracked(values, times, names):
    return Table(times, np.array(names), values, ("x", "y", "z"))


def test_points_move_with_the_gaussians_near_them():
    clip, rest = falling()
    places = np.array([[0.1, 0.2, 0.3], [0.9, 0.6, 0.7]])
    fallen = places[None] + (clip.means - rest)[:, :1]
    points = Points(tracked(fallen.reshape(-1, 3), clip.times.repeat(2), ["a", "b"] * 5), rest)
    assert np.allclose(points.predict(clip), points.measured, atol=1e-6)


def test_a_track_is_a_group_and_few_tracks_are_divided_by_time():
    few, times = np.eye(3), np.repeat(np.arange(12.0)[::-1], 3)
    table = tracked(np.tile(few, (12, 1)), times, ["a", "b", "c"] * 12)
    groups = Points(table, few).groups.reshape(12, 3, 3)
    assert np.array_equal(np.unique(groups), range(9)), "three tracks of three parts"
    assert np.all(groups == groups[:, :, :1]) and np.all(groups[:4] == groups[0])
    many = np.random.default_rng(0).random((8, 3))
    both = tracked(np.tile(many, (2, 1)), np.repeat([0.0, 1.0], 8), [*"abcdefgh"] * 2)
    assert np.array_equal(Points(both, many).groups, np.tile(np.repeat(np.arange(8), 3), 2))


def test_pixels_move_with_the_gaussians_in_front():
    clip, rest = falling()
    camera = Camera.orbit(0, 10, 4, 128, target=(0.5, 0.5, 0.5))
    front = np.flatnonzero(rest[:, 0] == 1)[[5, 6, 9]]
    seen = np.stack([camera.project(means[front])[0] for means in clip.means])
    table = Table(clip.times.repeat(3), np.array(["a", "b", "c"] * 5), seen.reshape(-1, 2), ("u",))
    points = Points(table, rest, [camera] * 5)
    assert np.all(rest[points.chosen[points.weights > 0.2], 0] == 1)
    assert np.allclose(points.predict(clip), points.measured, atol=0.15)


def test_points_off_the_object_or_late_are_refused():
    _, rest = falling()
    with pytest.raises(InputError, match=r"away from the object.* pictures of --side \(pixels\)"):
        Points(tracked(np.full((2, 3), 5.0), np.array([0, 0.1]), ["a", "a"]), rest)
    with pytest.raises(InputError, match="point b is not seen at the first time"):
        Points(tracked(np.zeros((2, 3)), np.array([0, 0.1]), ["a", "b"]), rest)
    with pytest.raises(InputError, match="have the same time"):
        Points(tracked(np.zeros((1, 3)), np.zeros(1), ["a"]), rest)


def test_points_of_a_clip_need_enough_gaussians_or_its_object(tmp_path):
    still = Scene.from_data({"accuracy": {"cells": 4}, "time": {"frames": 2}, "boundaries": []})
    path, flat = str(tmp_path / "clip.safetensors"), str(tmp_path / "flat.ply")
    Simulation(prepare(ball(400), still, RunContext(threads=1))).run().save(path)
    whole = ball(400)
    write_ply(flat, replace(whole, means=whole.means * np.float32([1, 1, 0.1])))
    find = {"material.E": "1e4..1e5"}
    with pytest.raises(InputError, match=r"away from the object.* Give more --gaussians\."):
        Target(Fit.from_data({"target": path, "find": find, "gaussians": 8}))
    with pytest.raises(InputError, match=r"away from the object.* Remove --object, or"):
        Target(Fit.from_data({"target": path, "find": find, "object": flat}))


def test_a_clip_tells_where_its_object_lies_in_a_picture(tmp_path):
    path, find = str(tmp_path / "clip.safetensors"), {"material.E": "1e4..1e5"}
    Image.fromarray(np.uint8([[0, 255]])).save(tmp_path / "stiff.png")
    data = {"accuracy": {"cells": 4}, "time": {"frames": 2}, "boundaries": []}
    data["stiffness"] = {"kind": "picture", "file": str(tmp_path / "stiff.png")}
    crop = (0.5, 0.0, 1.0, 1.0)
    setup = prepare(ball(400), Scene.from_data(data), RunContext(threads=1), crop=crop)
    clip = Simulation(setup).run()
    clip.save(path)
    assert Target(Fit.from_data({"target": path, "find": find})).crop == crop
    old = {key: value for key, value in clip.report.items() if key != "crop"}
    clip.with_report(old).save(path)
    with pytest.raises(InputError, match=r"stiffness\.file = .*older version.* Generate the clip"):
        Target(Fit.from_data({"target": path, "find": find}))


def test_forces_between_objects_and_on_parts_of_walls_are_read(tmp_path):
    path = str(tmp_path / "clip.safetensors")
    inside = {"lower": [-3, -3, 0], "upper": [3, 3, 3]}
    walls = [{"kind": "container", "inside": inside}]
    data = {"time.frames": 2, "accuracy.cells": 4, "wrenches": True, "boundaries": walls}
    scene = Scene.named("collide").replaced(data)
    clip = Simulation(prepare(ball(400), scene, RunContext(threads=1))).run()
    clip.save(path)
    target = Target(Fit.from_data({"target": path, "find": {"material.E": "1e4..1e5"}}))
    forces = clip.wrenches[:, :, 0].ravel()
    assert {"container_z_low", "left_on_right"} <= set(clip.walls)
    assert np.array_equal(target.observations.measured[-forces.size :], forces)
    assert np.array_equal(target.observations.predict(clip)[-forces.size :], forces)


def test_between_frames_a_spline_is_read():
    times = np.arange(6) / 10
    assert at_times(times, times**3, np.array([0.25]))[0] == pytest.approx(0.25**3, rel=1e-6)
    assert at_times(times, times**3, np.array([0.20001]))[0] == times[2] ** 3


def test_a_budget_that_is_too_small_is_refused():
    outlook = Outlook((16, 24), (0.5, 2.0), 2, 2)
    outlook.refuse(600)
    with pytest.raises(InputError, match=r"takes at least .* --seconds"):
        outlook.refuse(10)
    clock = iter([0.0, 50.0, 50.0])
    budget = Budget(100, clock=lambda: next(clock))
    assert not budget.late(0.6)
    assert budget.late(0.4)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["points.csv", "--object", "o.ply"], "there is no value to find"),
        (["points.csv", "--object", "o.ply", "--find", "material.E"], "find = material.E: it is"),
        (["points.csv", "--find", "material.E=1..2"], "no object is set"),
        (["gone.mp4", "--object", "o.ply", "--find", "material.E=1e4..1e5"], "it does not exist"),
        (["points.csv", "--object", "o.ply", "--find", "material.E=1e4..1e5"], "until 9 s"),
        (
            ["points.csv", "--object", "o.ply", "--find", "material.E=1..2", "--out", "o.ply"],
            "out = o.ply: it is a file",
        ),
    ],
)
def test_command_refuses_with_a_sentence(tmp_path, monkeypatch, capsys, words, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "points.csv").write_text("time,id,x,y,z\n0,a,0,0,0.5\n9,a,0,0,0.5\n")
    n = 8
    rest = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, n).T
    turned, ones = np.tile([1.0, 0, 0, 0], (n, 1)), np.ones(n)
    write_ply("o.ply", Gaussians.from_rgb(rest, turned, np.full((n, 3), 0.1), ones, rest * 0.5))
    assert main(["fit", *words]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_file_on_the_page_is_a_fit(tmp_path):
    page = next(page for page in PAGES if page.name == "fitting.md")  # fitting.md
    text = next(block.text for block in blocks() if block.page == page and block.words[0] == "toml")
    (tmp_path / "fit.toml").write_text(text)
    declared = Fit.from_data(Fit.from_toml(tmp_path / "fit.toml"))
    assert list(declared.find) == ["material.E", "material.nu"]
