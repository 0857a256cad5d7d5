"""Settings from the environment, and the catalogue that the page is built from."""

import json
from contextlib import suppress

import pytest
from PIL import Image

from demo.__main__ import main, read_options
from demo.catalogue import FOLDER, catalogue, check_time, scene_of
from demo.forecast import Estimator, probe_estimate, stops_table
from demo.jobs import Studio
from demo.settings import Settings, table
from demo.visitors import Visitors
from phy124.accuracy.load import Load
from phy124.accuracy.promises import format_percent
from phy124.boundaries import BOUNDARIES
from phy124.budget.cost import Work, count_substeps
from phy124.errors import InputError
from phy124.forces import FORCES
from phy124.materials import LAWS
from phy124.particles.thickness import Proportions
from phy124.rendering.nearest import ROOM
from phy124.runtime.context import RunContext
from phy124.runtime.installation import install_command
from phy124.scene import Scene, preset_names
from phy124.scene.files import files_named

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.fixture(autouse=True)
def quiet(monkeypatch):
    """Nobody else is at work."""
    monkeypatch.setattr("demo.forecast.Load.measure", lambda *_: Load())


def test_settings_come_from_the_environment():
    settings = Settings.from_environment({"PHY124_MAX_FRAMES": "30", "OTHER": "x"})
    assert settings.max_frames == 30 and settings.port == 7860


def test_every_setting_is_an_option_as_well(capsys):
    assert read_options(["--max-frames", "30", "--hosts", ""]) == {
        "PHY124_MAX_FRAMES": "30",
        "PHY124_HOSTS": "",
    }
    with pytest.raises(SystemExit):
        read_options(["--help"])
    output = capsys.readouterr().out
    for name, field in Settings.model_fields.items():
        assert f"PHY124_{name.upper()}" in output and (field.description or "").split()[0] in output
    assert main(["--port", "0"]) == 2
    assert "PHY124_PORT = 0: it must be a whole number" in capsys.readouterr().err


def test_a_page_without_gradio_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setattr("demo.__main__.find_spec", lambda name: None)
    assert main([]) == 2
    said = capsys.readouterr().err
    assert said.startswith("phy124-demo: page = gradio: ") and install_command("demo") in said


def test_a_space_listens_to_the_outside_and_a_desk_does_not():
    assert Settings.from_environment({}).host == "127.0.0.1"
    assert Settings.from_environment({"SPACE_ID": "a/b"}).host == "0.0.0.0"


def test_gradios_own_variables_are_honoured_and_ours_come_first():
    options = {"GRADIO_SERVER_NAME": "0.0.0.0", "GRADIO_SERVER_PORT": "8001"}
    settings = Settings.from_environment(options)
    assert (settings.host, settings.port) == ("0.0.0.0", 8001)
    assert Settings.from_environment({**options, "PHY124_PORT": "9000"}).port == 9000
    with pytest.raises(InputError, match="GRADIO_SERVER_PORT = x"):
        Settings.from_environment({"GRADIO_SERVER_PORT": "x"})


@pytest.mark.parametrize(
    ("variable", "value"), [("MAX_FRAMES", "many"), ("PORT", "0"), ("MAX_UPLOAD_MB", "-1")]
)
def test_bad_settings_are_refused_by_name(variable, value):
    with pytest.raises(InputError, match=f"PHY124_{variable} = {value}"):
        Settings.from_environment({f"PHY124_{variable}": value})


def test_the_documented_table_is_the_classes_own():
    text = (FOLDER.parent / "docs/guide/hosting.md").read_text("utf-8")
    assert table() in text, (
        "write the output of `python -m demo.settings` into docs/guide/hosting.md"
    )


def test_every_law_force_and_boundary_is_offered():
    text = json.dumps(catalogue(Settings())["schema"])
    for kinds in (LAWS, FORCES, BOUNDARIES):
        for section in kinds.by_name.values():
            assert f'"{section.__name__}"' in text


def test_every_preset_has_a_small_preview():
    cards = {card["name"]: card for card in catalogue(Settings())["presets"]}
    assert set(cards) == set(preset_names())
    for name, card in cards.items():
        path = FOLDER / "previews" / f"{name}.webp"
        assert path.exists(), f"python -m demo.make_previews {name}"
        assert path.stat().st_size < 125_000
        with Image.open(path) as picture:
            minimum, _ = picture.convert("RGBA").getchannel("A").getextrema()
        assert minimum == 0, f"{name} would be a white square on a dark page"
        assert card["text"] and scene_of(card["scene"], Settings()).description == card["text"]


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"time.frames": 73}, "frames"),
        ({"accuracy": {"cells": 65}}, "cells"),
        ({"view.size": 1024}, "size"),
        ({"accuracy": {"cells": 64, "particles_per_axis": 3.5}}, "particles"),
        ({"forces": [{"kind": "gravity"}] * 17}, "forces and boundaries"),
    ],
)
def test_values_beyond_the_pages_limits_are_refused(changes, field):
    data = Scene.named("press").replaced(changes).data()
    with pytest.raises(InputError, match=f"{field} = .*allows at most"):
        scene_of(data, Settings())


@pytest.mark.parametrize(
    "change",
    [
        {"forces": [{"kind": "?"}] * 800},
        {"boundaries": [1] * 800},
        {"objects": [{}] * 300},
        {"parts": [{"x": 1}] * 300},
        {"pairs": [None] * 300},
    ],
)
def test_lists_of_a_scene_are_counted_first(change, monkeypatch):
    monkeypatch.setattr(Scene, "from_data", lambda *_: pytest.fail("it was read"))
    with pytest.raises(InputError, match="allows at most"):
        scene_of(change, Settings())


@pytest.mark.parametrize("data", [None, "press", {"material": {"law": "gold"}}])
def test_invalid_scenes_are_refused(data):
    with pytest.raises(InputError):
        scene_of(data, Settings())


def test_long_scenes_are_refused_before_they_are_read(monkeypatch):
    monkeypatch.setattr(Scene, "from_data", lambda *_: pytest.fail("it was read"))
    with pytest.raises(InputError, match=r"longer than .* characters"):
        scene_of({"x" * 300_000: 1}, Settings())


FILES = [
    {"stiffness": {"kind": "picture", "file": "/etc/hostname"}},
    {"properties": {"file": "/dev/zero"}},
    {"parts": [{"mask": "/no/such/file.png", "material": {"law": "sand"}}]},
    {"parts": [{"mask": "/dev/random", "material": {"law": "sand"}}]},
]


@pytest.mark.parametrize("change", FILES)
def test_scenes_from_outside_name_no_file_of_the_server(change, tmp_path):
    """The answer tells nobody whether there is such a file."""
    data = {**Scene.named("press").data(), **change}
    for uploads in (None, tmp_path):
        with pytest.raises(InputError, match="cannot name a file, except a picture"):
            scene_of(data, Settings(), uploads)


def test_a_mask_may_be_a_picture_that_the_visitor_has_sent(tmp_path):
    from PIL import Image

    Image.new("L", (16, 16), 255).save(tmp_path / "mask.png")
    part = {"mask": str(tmp_path / "mask.png"), "material": {"law": "sand"}}
    data = {**Scene.named("press").data(), "parts": [part]}
    scene = scene_of(data, Settings(), tmp_path)
    assert [field for field, _ in files_named(scene)] == ["parts.0.mask"]
    with pytest.raises(InputError):
        scene_of(data, Settings(max_upload_mb=1e-6), tmp_path)


def test_fields_that_name_files_are_refused_by_type():
    """A new one is refused without anybody thinking of it; text may not stand for a path."""
    import re

    for name, section in Scene.model_json_schema()["$defs"].items():
        for field, info in section.get("properties", {}).items():
            texts = [s for s in [info, *info.get("anyOf", [])] if s.get("type") == "string"]
            for text in (t for t in texts if "const" not in t and "enum" not in t):
                named = re.search(r"file|mask|path|folder", field)
                assert text.get("format") == "path" or not named, f"{name}.{field}"


def test_fractions_of_frames_are_refused():
    data = Scene.named("press").data()
    data["time"]["frames"] = 3.5
    with pytest.raises(InputError, match="frames"):
        scene_of(data, Settings())


def test_too_long_runs_are_refused_before_they_start():
    stiff = Scene.named("press").replaced({"material.E": 1e10})
    with pytest.raises(InputError, match="would take about"):
        check_time(Estimator().minimum(stiff), Settings())


STIFFENS = {"kind": "ramp", "duration": 0.3, "first": 1.0, "last": 9.0}


@pytest.mark.parametrize(
    "changes", [{}, {"material.damping": 2e4}, {"stiffness_profile": STIFFENS}], ids=str
)
def test_the_forecast_counts_the_substeps_of_a_run(three_gaussians, changes):
    from phy124.simulation import Simulation, prepare

    small = {"accuracy": {"cells": 8, "particles_per_axis": 1.0}, **changes}
    scene = Scene.named("push_right").replaced(small)
    run = Simulation(prepare(three_gaussians, scene, RunContext(device="cpu")))
    run.run()
    assert count_substeps(scene) == pytest.approx(run.solver.clock.substeps, rel=0.25)


@pytest.mark.slow
def test_the_page_measures_this_machine_before_the_first_visitor(tmp_path, monkeypatch):
    """Every cost but that of nodes, 1 % of a substep, and of the rest is replaced."""
    monkeypatch.setattr("demo.warm.preset_names", lambda: ["press", "water"])
    studio = Studio(Settings(device="cpu"), Visitors(tmp_path))
    written = vars(studio.forecaster.rates)
    studio.warm_up()
    assert studio.warm.is_set()
    measured = vars(studio.forecaster.rates)
    same = {name for name in written if measured[name] == written[name]}
    assert same == {"rest", "node"}
    assert all(0 < value < 60 for value in measured.values())


def test_a_page_that_is_not_warmed_up_is_ready_at_once(tmp_path):
    studio = Studio(Settings(warm_up=False), Visitors(tmp_path))
    written = dict(vars(studio.forecaster.rates))
    studio.warm_up()
    assert studio.warm.is_set() and not studio.searches
    assert vars(studio.forecaster.rates) == written


def test_the_page_measures_this_machine_with_its_threads(tmp_path, monkeypatch):
    used = []
    monkeypatch.setattr("demo.warm.search_seconds", lambda: 1.0)
    monkeypatch.setattr("demo.warm.warm", lambda scenes, context: used.append(context.threads))
    monkeypatch.setattr("demo.warm.pipeline.simulate", lambda *sent: used.append(sent[3].threads))
    monkeypatch.setattr("demo.warm.pipeline.generate", lambda *sent: used.append(sent[3].threads))
    studio = Studio(Settings(device="cpu", threads=1), Visitors(tmp_path))

    def calibrate(*runs):
        for run in runs:
            with suppress(AttributeError):
                run()  # it has no report

    monkeypatch.setattr(studio.forecaster, "calibrate", calibrate)
    studio.warm_up()
    assert used == [1, 1, 1]


def test_accuracy_levels_follow_measurements_of_the_scene():
    forecaster, scene = Estimator(), Scene.named("press").replaced({"accuracy": "draft"})
    stops = forecaster.stops(scene, proportions=Proportions(0.5, 0.3))
    assert [stop.name for stop in stops] == ["draft", "standard", "fine"]
    assert stops[0].seconds == forecaster(scene).seconds
    assert sorted(stop.seconds for stop in stops) == [stop.seconds for stop in stops]
    assert stops[0].pixels == pytest.approx(stops[0].error * 512 / ROOM)
    twice = forecaster.stops(scene, proportions=Proportions(0.5, 0.3), seconds=2 * stops[0].seconds)
    assert [b.seconds / a.seconds for a, b in zip(stops, twice, strict=True)] == [2, 2, 2]
    table = stops_table(stops, scene.accuracy)
    assert table.count("<tr") == 3 and table.count("class=chosen") == 1
    assert f"off by at most {format_percent(stops[0].error)} ({stops[0].pixels:.0f} px)" in table


def test_unmeasured_error_is_not_promised():
    changes = {"material.law": "fluid", "object.velocity": [0, 0, -30]}
    scene = Scene.named("drop").replaced(changes)
    forecast = Estimator()(scene)
    assert forecast.promise.error is None
    assert "Expected error: not measured for fluid" in forecast.sentence
    assert (
        stops_table(
            Estimator().stops(scene, proportions=Proportions(0.5, 0.3)), scene.accuracy
        ).count("error not measured")
        == 3
    )


def test_estimate_skips_finished_stages(monkeypatch):
    scene, forecaster = Scene.named("press"), Estimator()
    whole = forecaster(scene).seconds
    made = forecaster(scene, generated=True).seconds
    moved = forecaster(scene, generated=True, simulated=True).seconds
    assert whole > made > moved > 0
    assert forecaster(scene, generated=True, simulated=True, filmed=True).seconds == 0
    monkeypatch.setattr("demo.forecast.Load.measure", lambda *_: Load(2.0, 3.0))
    busy = Estimator()(scene)
    motion = forecaster.rates.seconds(Work.of(scene))["simulate"]
    assert busy.seconds == pytest.approx(2 * whole + motion)
    assert "while this machine is busy" in busy.sentence
    assert "make the motion take 3.0 times as long" in busy.sentence


def test_a_run_of_our_own_is_not_taken_for_others(monkeypatch):
    occupied = True
    forecaster = Estimator(lambda: occupied)
    monkeypatch.setattr("demo.forecast.Load.measure", lambda *_: Load(2.0, 3.0))
    assert not forecaster.load().busy
    occupied = False
    assert forecaster.load().busy


def test_two_looks_do_not_take_each_other_for_others(monkeypatch):
    forecaster, at_once = Estimator(), []

    def look(*_):
        at_once.append(forecaster.meter._measuring.locked())
        return Load()

    monkeypatch.setattr("demo.forecast.Load.measure", look)
    forecaster.meter.measure()
    assert at_once == [True] and not forecaster.meter._measuring.locked()


def test_time_for_missing_kernels_is_announced(monkeypatch):
    monkeypatch.setattr("demo.forecast.Load.measure", lambda *_: Load(2.0, 3.0))
    scene, forecaster = Scene.named("press"), Estimator()
    warm, cold = forecaster(scene), forecaster(scene, compiling=5.0)
    assert cold.seconds == pytest.approx(warm.seconds + 10.0)
    assert "compiles for about 10 s" in cold.sentence and "compiles" not in warm.sentence
    again = forecaster(scene, simulated=True, compiling=5.0)
    assert "compiles" not in again.sentence
    assert again.seconds == forecaster(scene, simulated=True).seconds


def test_rates_are_measured_less_what_others_took(monkeypatch):
    report = {
        "stages": [{"name": "simulate", "seconds": 4.0}],
        "substeps": 100,
        "frames": 2,
        "gaussians": 0,
        "particles": 1000,
    }
    scene, result = Scene.named("press"), []
    for before, after in ((1.0, 1.0), (2.0, 2.0), (3.0, 1.0)):
        looks = iter([Load(before, before), Load(after, after)] * 2)
        monkeypatch.setattr("demo.forecast.Load.measure", lambda *_, looks=looks: next(looks))
        forecaster = Estimator()
        forecaster.calibrate(lambda: (report, scene), lambda: (report, scene))
        result.append(forecaster.rates.substep)
    assert result[1] == result[2] == pytest.approx(result[0] / 2)


def test_a_forecast_can_be_measured_on_the_object_itself(three_gaussians):
    scene = Scene.named("drop").replaced(
        {"accuracy": {"cells": 8, "particles_per_axis": 1.0}, "view.size": 32}
    )
    forecast = probe_estimate(three_gaussians, scene, RunContext(device="cpu"), rest=1.0)
    assert forecast.seconds > 1.0 and forecast.promise.error is None
    assert forecast.substeps > 0 and forecast.particles >= 3


def test_page_shows_each_preset_on_the_stage():
    offer = catalogue(Settings())
    assert {card["scene"]["view"]["stage"] for card in offer["presets"]} == {"studio"}
    assert offer["schema"]["$defs"]["View"]["properties"]["stage"]["enum"] == ["plain", "studio"]


def test_two_minuses_end_the_options(capsys):
    assert read_options(["--port", "80", "--"]) == {"PHY124_PORT": "80"}
    with pytest.raises(SystemExit):
        read_options(["--", "--port"])
    assert "unrecognized arguments" in capsys.readouterr().err
