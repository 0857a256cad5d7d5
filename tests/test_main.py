"""The command line as a user meets it."""

import gc
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.camera import Camera
from phy124.io.clip import Clip
from phy124.io.ply import read_ply, write_ply
from phy124.rendering.render import Renderer
from phy124.scene import Scene
from support.processes import run_program
from support.shapes import ball
from support.videos import read_video

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
QUICK = ["--accuracy", "draft", "--frames", "3", "--size", "64", "--device", "cpu"]
FEW = ["--gaussians", "2000"]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """One quick run of the duck, pressed."""
    out = tmp_path_factory.mktemp("made")
    assert main(["generate", str(DUCK), *QUICK, *FEW, "--out", str(out)]) == 0
    return out


def test_generate_makes_every_file(made):
    assert sorted(path.name for path in made.iterdir()) == [
        "back.mp4",
        "clip.safetensors",
        "cutout.png",
        "front.mp4",
        "gaussians.ply",
        "left.mp4",
        "orbit.mp4",
        "report.json",
        "right.mp4",
        "scene.toml",
    ]


def test_videos_have_the_frames_asked_for(made):
    for view in ("front", "orbit"):
        assert read_video(made / f"{view}.mp4").shape == (3, 64, 64, 3)


def test_the_report_has_the_documented_keys(made):
    report = json.loads((made / "report.json").read_text())
    assert set(report) >= {
        "stages",
        "gaussians",
        "particles",
        "grid",
        "substeps",
        "frames",
        "device",
        "versions",
        "foreground",
        "generator",
        "effects",
    }
    assert report["foreground"] == report["cutout"]["method"] == "alpha"
    assert report["cutout"]["pieces"] == 1 and report["cutout"]["warnings"] == []
    assert report["generator"] == "relief"
    stages = {stage["name"]: stage for stage in report["stages"]}
    assert {"image", "generate", "particles", "simulate", "deform", "render"} <= set(stages)
    assert stages["simulate"]["launches"] > 4 * report["substeps"]
    covered = sum(stage["seconds"] for stage in report["stages"])
    # Stages of two threads may overlap a little.
    assert 0.7 * report["seconds"] < covered <= 1.1 * report["seconds"]
    assert report == Clip.load(made / "clip.safetensors").report


def test_warm_scene_is_reported_as_such(made, capsys):
    assert main(["warm", "press", "--device", "cpu"]) == 0
    assert main(["warm", "press", "--device", "cpu"]) == 0
    printed, problems = capsys.readouterr()
    assert printed.splitlines()[-1].startswith("press: everything was compiled already; ")
    assert problems.splitlines()[-1] == "try: 1 of 1"
    assert main(["warm", "dance"]) == 2


def test_the_scene_file_repeats_the_run(made):
    scene = Scene.from_toml(made / "scene.toml")
    assert scene == Scene.named("press").replaced(
        {"accuracy": "draft", "time.frames": 3, "view.size": 64, "view.stage": "studio"}
    )


def test_the_first_frame_is_the_static_object(made):
    """The video starts with the rendering of the Gaussians as they were before any physics."""
    still = read_ply(made / "gaussians.ply").gaussians
    first = Clip.load(made / "clip.safetensors").frame(0).gaussians
    camera = Camera.orbit(0, 10, 1.9, 128, (0, 0, 0.3))
    draw = Renderer(device="cpu")
    assert np.abs(draw(still, camera) - draw(first, camera)).max() < 1.5 / 255


def test_render_films_again_without_simulating(made, tmp_path, capsys):
    arguments = ["render", str(made / "clip.safetensors"), "--views", "left", "--size", "32"]
    assert main([*arguments, "--out", str(tmp_path), "--json", "--device", "cpu"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "files": [str(tmp_path / "left.mp4")],
        "notes": [],
    }
    assert read_video(tmp_path / "left.mp4").shape == (3, 32, 32, 3)


def test_render_draws_in_as_many_threads_as_are_asked_for(made, tmp_path, capsys, monkeypatch):
    inputs = []
    film = "phy124.commands.render.film"
    monkeypatch.setattr(film, lambda *_: inputs.append(_[-1].threads))
    arguments = ["render", str(made / "clip.safetensors"), "--device", "cpu"]
    for answer in ([], ["--threads", "3"]):
        main([*arguments, "--out", str(tmp_path / "none"), *answer])
    assert inputs == [None, 3]
    assert main([*arguments, "--threads", "0"]) == 2
    assert "a run can use 1 to 256 threads" in capsys.readouterr().err


def test_render_makes_every_format_from_any_angle(made, tmp_path, capsys):
    clip = ["render", str(made / "clip.safetensors"), "--device", "cpu", "--out", str(tmp_path)]
    more = ["--azimuth", "45,-30", "--size", "48x32", "--transparent", "--format"]
    for formats in (["gif,webp", "png"], ["png"]):
        assert main([*clip, *more, *formats]) == 0
    names = capsys.readouterr().out.splitlines()
    ends = (".gif", ".webp", "-png")
    expected = sorted(f"azimuth-{a}{end}" for end in ends for a in (45, 330))
    assert [Path(name).name for name in names] == [*expected, "azimuth-330-png", "azimuth-45-png"]
    assert len(list((tmp_path / "azimuth-45-png").iterdir())) == 3
    with Image.open(tmp_path / "azimuth-45.webp") as opened:
        assert opened.size == (48, 32)
    assert main([*clip, "--transparent"]) == 2
    assert "Choose the format webm, mov, webp, png or gif" in capsys.readouterr().err


def test_render_refuses_a_folder_named_like_a_video(made, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("phy124.commands.render.film", lambda *_: pytest.fail("it began"))
    (tmp_path / "front.mp4").mkdir()
    clip = str(made / "clip.safetensors")
    assert main(["render", clip, "--out", str(tmp_path), "--views", "front"]) == 2
    assert "front.mp4: it is a folder, but a result of the run" in capsys.readouterr().err


@pytest.mark.parametrize("change", ["grains=false", "material.tint=none"])
def test_render_rejects_values_of_the_simulation(made, tmp_path, capsys, change):
    clip = str(made / "clip.safetensors")
    assert main(["render", clip, "--out", str(tmp_path / "out"), "--set", change]) == 2
    key = change.partition("=")[0]
    message = capsys.readouterr().err
    assert message.startswith(f"phy124: {key} = ") and "is a setting of the simulation" in message
    assert f"Add `--set {key}=...` to" in message and not (tmp_path / "out").exists()


def test_clip_is_filmed_slowly_by_moving_cameras(made, tmp_path, capsys):
    (tmp_path / "moves.toml").write_text('[[view.cameras]]\nkind = "dolly"\nname = "closer"\n')
    clip = ["render", str(made / "clip.safetensors"), "--device", "cpu", "--size", "48"]
    options = ["--cameras", str(tmp_path / "moves.toml"), "--outputs", "depth,flow", "--json"]
    assert main([*clip, *options, "--speed", "0.25", "--out", str(tmp_path / "out")]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [Path(name).name for name in output["files"]] == ["closer-outputs", "closer.mp4"]
    assert "6 frames per second" in output["notes"][-1]
    made_files = sorted(path.name for path in (tmp_path / "out/closer-outputs").iterdir())
    depths = [f"depth_000{i}.png" for i in (1, 2, 3)]
    assert made_files == [*depths, "flow_0001.png", "flow_0002.png", "outputs.json"]
    assert main([*clip, "--outputs", "force"]) == 2
    assert "Simulate it again with --outputs force" in capsys.readouterr().err


@pytest.mark.slow
def test_object_that_leaves_the_picture_is_noted(made, tmp_path, capsys):
    gone = ["--scene", "push_right", "--set", "object.velocity=[0,200,0]", "--views", "front"]
    simulate = ["simulate", str(made / "gaussians.ply"), *QUICK, *gone, "--out", str(tmp_path)]
    assert main([*simulate, "--no-follow"]) == 0
    printed = capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    (left,) = report["departures"]
    assert (left["view"], left["frame"]) == ("front", 1)
    (note,) = [note for note in report["notes"] if "leaves the picture" in note]
    assert f"note: {note}" in printed and "view.follow = true" in note
    assert main(["render", str(tmp_path / "clip.safetensors"), "--device", "cpu", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == [note]
    for follow in ([], ["--follow"]):
        assert main([*simulate, *follow]) == 0
        assert "leaves the picture" not in capsys.readouterr().out


def test_simulate_takes_gaussians(made, tmp_path, capsys):
    arguments = ["simulate", str(made / "gaussians.ply"), "--scene", "push_right", *QUICK]
    assert main([*arguments, "--views", "front", "--out", str(tmp_path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["complete"]
    assert report["foreground"] is None
    assert Path(report["files"][-1]).exists()


def test_set_changes_any_value(made, tmp_path, capsys):
    arguments = ["simulate", str(made / "gaussians.ply"), *QUICK, "--views", "front", "--json"]
    main([*arguments, "--out", str(tmp_path), "--set", "material.E=5e4", "boundaries.1.depth=0.2"])
    capsys.readouterr()
    scene = Scene.from_toml(tmp_path / "scene.toml")
    assert scene.material.E == 5e4
    assert scene.boundaries[1].depth == 0.2


def test_repeated_options_add_up(made, tmp_path, capsys):
    arguments = [
        "simulate",
        str(made / "gaussians.ply"),
        "--set",
        "material.E=5e4",
        "seed=3",
        *QUICK,
    ]
    arguments += ["--views", "front", "--set", "boundaries.1.depth=0.2", "--views=left", "--json"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    scene = Scene.from_toml(tmp_path / "scene.toml")
    assert (scene.material.E, scene.seed, scene.boundaries[1].depth) == (5e4, 3, 0.2)
    assert scene.view.views == ("front", "left")


def test_command_imports_are_frozen_for_the_collector(capsys):
    before = gc.get_freeze_count()
    assert main(["scenes"]) == 0
    assert gc.get_freeze_count() > before and gc.isenabled()


def test_scenes_and_effects_and_doctor_print(capsys):
    assert main(["scenes"]) == 0
    assert "press" in capsys.readouterr().out
    assert main(["scenes", "drop"]) == 0
    assert "lift = 0.3" in capsys.readouterr().out
    assert main(["effects", "press", "--device", "cpu"]) == 0
    assert "left out  return mapping: neo_hookean is elastic" in capsys.readouterr().out
    assert main(["doctor", "--json"]) == 0
    assert "cpu" in json.loads(capsys.readouterr().out)["devices"][0]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["generate", "none.png"], "none.png"),
        (["generate", str(DUCK), "--scene", "dance"], "scene = dance: no preset has that name."),
        (["generate", str(DUCK), "--frames", "0"], "time.frames = 0: it must be a whole number"),
        (["generate", str(DUCK), "--generator", "magic"], "generator = magic: There is no such"),
        (["generate", str(DUCK), "--foreground", "magic"], "magic"),
        (["generate", str(DUCK), "--device", "cuda:9"], "device = cuda:9: this machine has no"),
        (
            ["generate", str(DUCK), "--size", "64", "--size", "65"],
            "size = 65: the option has two values",
        ),
        (
            ["generate", str(DUCK), "--set", "seed=1", "--set", "seed=2"],
            "seed = 2: it is also set to 1. Give one of the two.",
        ),
        (
            ["generate", str(DUCK), "--frames", "3", "--set", "time.frames=4"],
            "time.frames = 4: it is also set to 3.",
        ),
        (["generate", str(DUCK), "--set", "speed"], "set = speed: it is not KEY=VALUE."),
        (["generate", str(DUCK), "--set", "materal.E=3"], "Did you mean material?"),
        (["simulate", "none.ply"], "none.ply"),
        (["render", "none.safetensors"], "clip = none.safetensors: there is no such file."),
        (["scenes", "dance"], "scene = dance"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(arguments, sentence, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert "Traceback" not in printed.err + printed.out
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_errors_are_json_for_scripts(capsys):
    assert main(["generate", "none.png", "--json"]) == 2
    assert "none.png" in json.loads(capsys.readouterr().out)["error"]


def test_unwritable_folder_is_refused_in_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    status = main(["generate", str(DUCK), *QUICK, "--out", str(tmp_path / "file" / "sub")])
    assert status == 2
    assert "it cannot be written" in capsys.readouterr().err


def test_interrupting_a_cut_out_that_never_ends(tmp_path):
    note = tmp_path / "process"
    forever = f"import os, time; open({str(note)!r}, 'w').write(str(os.getpid())); time.sleep(600)"
    program = f"""
import sys
from phy124.imaging import cutout
from phy124.runtime import isolated
from phy124.__main__ import main
def stuck(picture, deadline):
    return isolated.run(exec, {forever!r}, deadline=deadline)
cutout.METHODS["alpha"] = cutout.Method(lambda _: True, stuck)
sys.exit(main(["generate", {str(DUCK)!r}, "--out", {str(tmp_path / "out")!r}]))
"""
    run = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not (note.exists() and note.read_text()):
        assert run.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    run.send_signal(signal.SIGINT)
    _, errors = run.communicate(timeout=60)
    assert run.returncode == 130
    assert "stopped; no incomplete file" in errors and "Traceback" not in errors
    with pytest.raises(ProcessLookupError):
        os.kill(int(note.read_text()), 0)


@pytest.mark.parametrize(("argument", "status"), [("--version", 0), ("nonsense", 2)])
def test_program_ends_after_threads_and_exit_functions(argument, status):
    program = (
        "import atexit, sys, threading\n"
        "from phy124.__main__ import program\n"
        "atexit.register(lambda: print('exit function', flush=True))\n"
        "class Freed:\n    def __del__(self): print('freed', flush=True)\n"
        "sys.freed = Freed()\n"
        "main = threading.main_thread()\n"
        "threading.Thread(target=lambda: (main.join(), print('thread', flush=True))).start()\n"
        "program()\n"
    )
    words = [sys.executable, "-c", program, argument]
    done = run_program(words)
    assert done.returncode == status, done.stderr
    assert done.stdout.splitlines()[-2:] == ["thread", "exit function"]


def test_a_photograph_is_cut_out(tmp_path, capsys):
    """A disc on noise, without alpha: the small network must find it."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:160, :160]
    disc = (x - 80) ** 2 + (y - 80) ** 2 < 45**2
    picture = rng.integers(90, 120, (160, 160, 3), dtype=np.uint8)
    picture[disc] = [220, 60, 30]
    Image.fromarray(picture).save(tmp_path / "disc.png")
    out = tmp_path / "cutout.png"
    assert main(["cutout", str(tmp_path / "disc.png"), "--json", "--out", str(out)]) == 0
    assert json.loads(capsys.readouterr().out)["method"] == "u2netp"
    cut = np.asarray(Image.open(out))
    assert ((cut[..., 3] > 127) == disc).mean() > 0.98


def test_dropped_content_of_a_file_is_noted(tmp_path, capsys):
    """NaN Gaussians of a PLY and of a frame of a clip: in the report, and on the screen."""
    good = ball(1000)
    means, opacities = good.means.copy(), good.opacities.copy()
    means[:100], opacities[100:110] = np.nan, 1e-4
    write_ply(tmp_path / "nan.ply", replace(good, means=means, opacities=opacities))
    arguments = ["simulate", str(tmp_path / "nan.ply"), *QUICK, "--views", "front"]
    assert main([*arguments, "--set", "accuracy.cells=6", "--out", str(tmp_path / "o")]) == 0
    said = capsys.readouterr().out
    sentences = [
        "100 of 1000 Gaussians of the file had NaN or infinite values and were dropped.",
        "10 of 1000 Gaussians of the file had an opacity below 0.005 and were dropped.",
    ]
    assert said.startswith("scene: neo_hookean (density 1000 kg/m^3, E 40000 Pa, nu 0.35")
    assert json.loads((tmp_path / "o/report.json").read_text())["cleaning"] == sentences
    assert all(f"cleaning: {sentence}\n" in said for sentence in sentences)
    clip = Clip.load(tmp_path / "o/clip.safetensors")
    moved = np.array(clip.means)
    moved[2, :7] = np.nan
    replace(clip, means=moved).save(tmp_path / "nan.safetensors")
    render = ["render", str(tmp_path / "nan.safetensors"), "--size", "32", "--views", "front"]
    assert main([*render, "--out", str(tmp_path / "r"), "--device", "cpu"]) == 0
    assert (
        "note: Frame 2: 7 of 890 Gaussians have NaN or infinite values" in capsys.readouterr().out
    )


def test_frame_without_finite_gaussians_is_reported(made, tmp_path, capsys):
    clip = Clip.load(made / "clip.safetensors")
    for frame, status in ((1, 0), (0, 2)):
        means = np.array(clip.means)
        means[frame] = np.nan
        replace(clip, means=means).save(tmp_path / "nan.safetensors")
        arguments = ["render", str(tmp_path / "nan.safetensors"), "--size", "32", "--follow"]
        assert (
            main([*arguments, "--views", "front", "--out", str(tmp_path), "--device", "cpu"])
            == status
        )
        printed = capsys.readouterr()
        assert "have NaN or infinite values" in printed.out + printed.err
