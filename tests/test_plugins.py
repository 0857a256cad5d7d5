"""Materials, forces, boundaries, generators and sinks from outside, as instances or by name."""

import json
import re
import runpy
import socket
import sys
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
import warp as wp
from pydantic import Field

import bridge.sink
from bridge.backends import choose, missing, open_sink
from bridge.command_line import run as run_bridge
from bridge.info import diagnose
from bridge.options import Options
from demo.catalogue import catalogue
from demo.settings import Settings
from phy124 import generators, pipeline
from phy124.__main__ import main
from phy124.boundaries import Ground
from phy124.budget.effects import Effects
from phy124.errors import Cancelled, InputError
from phy124.forces import Force, Gravity
from phy124.io.clip import Clip
from phy124.io.formats import (
    FORMATS,
    Format,
    endings,
    find_written_format,
    read_gaussians,
    recognise,
    write_gaussians,
    written_formats,
)
from phy124.materials import FixedCorotated
from phy124.monitor.speeds import Speeds
from phy124.mpm import Stage
from phy124.scene import Part, Scene
from phy124.scene.objects import SceneObject
from phy124.scene.reference import format_reference, format_schema
from phy124.schema import plugins
from phy124.schema.declaration import read_declaration
from phy124.simulation import Simulation, prepare
from support.clips import random_clip
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {"accuracy": {"cells": 8}, "time.frames": 3}


class Rubber(FixedCorotated):
    """A fixed corotated solid that keeps what its base says of itself."""

    law: Literal["rubber"] = "rubber"
    E: float = Field(default=3e4, ge=1, le=1e9, description="Young's modulus [Pa].")


@wp.kernel(module="test_plugins", enable_backward=False)
def freeze(v: wp.array(dtype=wp.vec3)):
    v[wp.tid()] = wp.vec3()


class Freeze(Force):
    """Stops every particle in every substep."""

    kind: Literal["freeze"] = "freeze"
    sudden: ClassVar[bool] = True

    def attach(self, model, state, tracks):
        del tracks
        return [Stage("freeze", lambda grid: model.launch(freeze, len(model), [state.v], []), True)]


class Table(Ground):
    """A ground that another package offers."""

    kind: Literal["table"] = "table"


class Lamp(bridge.sink.LiveSink):
    """A sink that keeps what it is shown."""

    def __init__(self, options, **how):
        self.options, self.how, self.times = options, how, []

    def write(self, frame):
        self.times.append(frame.time)


def register(monkeypatch, points: EntryPoints) -> None:
    """Let these be the entry points of all packages."""
    monkeypatch.setattr(plugins, "entry_points", points.select)
    monkeypatch.setattr(plugins, "entry_points_of", cache(plugins.entry_points_of.__wrapped__))


@pytest.fixture
def installed(monkeypatch):
    """A package with entry points for all of them, and for sinks that are broken."""
    points = EntryPoints(
        EntryPoint(name, f"test_plugins:{kind.__name__}", f"phy124.{group}")
        for name, kind, group in (
            ("rubber", Rubber, "materials"),
            ("freeze", Freeze, "forces"),
            ("table", Table, "boundaries"),
            ("sphere", round_thing, "generators"),
            ("lamp", Lamp, "sinks"),
            ("none", Freeze, "sinks"),
            ("dds", Lamp, "sinks"),
            ("clip", random_clip, "sinks"),
            ("gone", dict, "sinks"),
        )
    )
    register(monkeypatch, points)
    monkeypatch.setattr(EntryPoint, "load", lambda self: globals()[self.value.partition(":")[2]])
    read_declaration.cache_clear()
    yield
    read_declaration.cache_clear()


def round_thing():
    """Makes balls."""
    return lambda image_rgba, *, seed, progress: ball(100)


def rubber_scene(**changes) -> Scene:
    return Scene(material=Rubber(), boundaries=(Table(),), **changes).replaced(QUICK)


def test_instances_of_ones_own_classes_move():
    run = Simulation(prepare(ball(300), rubber_scene(forces=(Freeze(),))))
    clip = run.run()
    assert clip.report["complete"] and "freeze" in run.solver.timings
    assert np.abs(clip.means[-1] - clip.means[0]).max() < 1e-5


def test_plugins_describe_themselves():
    scene = rubber_scene(forces=(Freeze(),))
    ran = Effects.of(scene).ran
    assert {"stress rubber", "particle forces", "collider table (separate)"} <= set(ran)
    run = Simulation(prepare(ball(300), scene))
    assert run.solver.rejection.sudden(run.solver.clock)
    speeds = run.find(Speeds)
    speeds._fastest[:] = 2 * scene.material.sound_speed()
    assert any("may stay squeezed flat" in note for note in speeds.notes())


def test_scene_with_unnamed_plugins_is_not_written():
    scene = rubber_scene().replaced({"time.fps": 30})
    assert isinstance(scene.material, Rubber) and scene.time.fps == 30
    with pytest.raises(
        InputError, match=r"Rubber.* which has no name in scene files\. Register it"
    ):
        scene.to_toml()


def test_plugin_material_survives_scene_changes():
    scene = Scene(parts=(Part(gaussians=(0, 100), material=Rubber()),)).replaced(QUICK)
    assert isinstance(scene.parts[0].material, Rubber)


def test_plugin_material_in_a_part_of_a_further_object_survives():
    part = Part(gaussians=(0, 100), material=Rubber())
    scene = Scene(objects=(SceneObject(name="b", shape="box", parts=(part,)),)).replaced(QUICK)
    assert isinstance(scene.objects[0].parts[0].material, Rubber)


def test_interrupted_run_with_own_classes_leaves_no_pause(tmp_path):
    """The first frames are kept, but no file can describe how to continue the run."""

    def cancel(stage, done, total):
        if (stage, done) == ("simulate", 2):
            raise Cancelled

    out = tmp_path / "out"
    result = pipeline.simulate(ball(300), rubber_scene(), out, progress=cancel, keep=True)
    assert result.report["interrupted"] and result.report["frames"] == 2
    assert not [path for path in out.iterdir() if "pause" in path.name]
    assert "pause.safetensors" not in result.report["files"]
    assert len(Clip.load(out / "clip.safetensors")) == 2


def test_a_registered_name_is_read_and_written(installed, tmp_path):
    scene = rubber_scene(forces=(Freeze(),))
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    again = Scene.from_toml(tmp_path / "scene.toml")
    assert again == scene and type(again.material) is Rubber
    assert type(Scene.from_data({"material": {"law": "rubber"}}).material) is Rubber
    with pytest.raises(InputError, match=r"rubber.E|material.E"):
        Scene.from_data({"material": {"law": "rubber", "E": -1}})


def test_a_registered_generator_is_found_by_name(installed):
    assert len(generators.make("sphere")(None, seed=0, progress=None)) == 100
    with pytest.raises(InputError, match="sphere"):
        generators.make("sphee")


def test_a_plugin_does_not_replace_what_is_there(installed, monkeypatch):
    monkeypatch.setattr(plugins, "load_plugin", lambda group, name: Rubber)
    assert type(Scene.from_data({"material": {"law": "sand"}}).material).__name__ == "Sand"


def test_packages_are_read_once_however_many_names_are_unknown(monkeypatch):
    reads, points = [], EntryPoints([])
    register(monkeypatch, points)

    def read(**wanted: str) -> EntryPoints:
        reads.append(wanted["group"])
        return points.select(**wanted)

    monkeypatch.setattr(plugins, "entry_points", read)
    with pytest.raises(InputError, match="no such kind"):
        Scene.from_data({"forces": [{"kind": "uniform"}] * 100})
    assert "phy124.forces" in reads and len(reads) == len(set(reads))


def test_one_that_cannot_be_loaded_says_so(monkeypatch):
    points = EntryPoints([EntryPoint("odd", "no_such_module:Odd", "phy124.materials")])
    register(monkeypatch, points)
    with pytest.raises(InputError, match="cannot be loaded"):
        Scene.from_data({"material": {"law": "odd"}})


def test_a_registered_sink_is_chosen_by_name(installed):
    assert choose("lamp") == "lamp" and missing("lamp") is None
    assert "lamp: ready" in diagnose()
    options = Options()
    sink = open_sink("lamp", options, duration=2.0, network=True, port=9)
    assert sink.options is options
    assert sink.how == {"duration": 2.0, "network": True, "port": 9}
    with sink:
        sink.listen(0.0, pytest.fail)
    with pytest.raises(InputError, match="lamp does not publish /clock"):
        open_sink("lamp", options, clock=True)
    assert not isinstance(open_sink("foxglove", options), Lamp), (
        "the bridge's own names stay its own"
    )


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("none", "cannot be created"),
        ("clip", "cannot be created"),
        ("gone", "cannot be loaded"),
        ("lump", "Did you mean lamp"),
    ],
)
def test_a_broken_sink_is_refused(installed, tmp_path, capsys, name, complaint):
    random_clip().save(tmp_path / "clip.safetensors")
    assert run_bridge(["play", str(tmp_path / "clip.safetensors"), "--backend", name], None) == 2
    assert complaint in capsys.readouterr().err


def test_missing_methods_of_a_sink_are_named(monkeypatch):
    monkeypatch.setattr("bridge.backends.load_plugin", lambda group, name: lambda *a, **b: object())
    with pytest.raises(InputError, match="has no __enter__, __exit__, write, monotonic, listen"):
        open_sink("lamp", Options())


def examples(monkeypatch) -> dict:
    """The plug-ins that the guide defines: a material, a force, a boundary, a format and a sink."""
    monkeypatch.setitem(sys.modules, "phy124_bridge", bridge)
    monkeypatch.setitem(sys.modules, "phy124_bridge.sink", bridge.sink)
    guide = Path(__file__).parents[1] / "docs/guide"
    text = (guide / "extending.md").read_text("utf-8")
    text += (guide / "extending-files.md").read_text("utf-8").partition("## A format")[2]
    names: dict = {}
    for program in ("06_material.py", "07_uniform_force.py"):
        names |= runpy.run_path(str(guide.parent / "examples" / program))
    for block in re.findall(r"```python\n(.*?)```", text, re.S):
        exec(block, names)
    return names


def test_swirl_of_the_docs_is_filmed_from_python(monkeypatch, tmp_path, capsys):
    """An unregistered force: films, clip and report are written, and the clip is filmed again."""
    program = Path(__file__).parents[1] / "docs/examples/08_swirl.py"
    swirl = runpy.run_path(str(program))["Swirl"]()
    view = {"view.size": 32, "view.views": ["front"], "object.lift": 0.5}
    scene = Scene.named("drop").replaced({**QUICK, **view})
    scene = scene.model_copy(update={"forces": (*scene.forces, swirl)})
    monkeypatch.chdir(tmp_path)
    pipeline.simulate(ball(300), scene, "out/swirl")
    clip = Clip.load("out/swirl/clip.safetensors")
    assert clip.scene["forces"][1]["kind"] == "swirl" and clip.report["unregistered"] == ["Swirl"]
    t = clip.times[-1]
    turned = np.arctan2(clip.means[-1, :, 1], clip.means[-1, :, 0])
    start = np.arctan2(clip.means[0, :, 1], clip.means[0, :, 0])
    turn = np.angle(np.exp(1j * (turned - start)))
    assert np.median(turn) == pytest.approx(20 * t**2 / 2, rel=0.1), "angular acceleration of 20"
    report = json.loads(Path("out/swirl/report.json").read_text())
    assert "Swirl is defined only in your program" in " ".join(report["notes"])
    assert {"front.mp4", "clip.safetensors", "scene.toml"} <= set(report["files"])
    film = ["render", "out/swirl/clip.safetensors", "--out", "again", "--device", "cpu"]
    assert main(film) == 0
    text = Path("out/swirl/scene.toml").read_text()
    assert text.startswith("# Without Swirl") and [
        f.kind for f in Scene.from_toml("out/swirl/scene.toml").forces
    ] == ["gravity"]
    with pytest.raises(InputError, match=r"forces\.1\.kind = swirl"):
        Scene.from_data(clip.scene)


def test_scene_of_a_clip_leaves_out_unknown_classes():
    """Also a class that has the name of one of phy124's own but other fields."""
    data = Scene.named("collide").data()
    assert Scene.of_clip(data) == Scene.named("collide")
    data["forces"].append({"kind": "gravity", "strength": 1.0})
    data["boundaries"].append({"kind": "ramp"})
    data["material"] = {"law": "rubber", "shore": 3}
    data["objects"][0]["material"] = {"law": "rubber"}
    scene = Scene.of_clip(data)
    usual = Scene.named("collide")
    assert scene.forces == usual.forces and scene.boundaries == usual.boundaries
    assert {material.law for material in scene.materials} == {"neo_hookean"}
    with pytest.raises(InputError, match=r"time\.frames"):
        Scene.of_clip({**data, "time": {"frames": 0}})
    with pytest.raises(InputError, match="no_such"):
        Scene.of_clip({"no_such": 1})


def test_the_examples_of_the_docs_move(monkeypatch):
    """docs/guide/extending.md: a material, a force and a boundary of one's own."""
    names = examples(monkeypatch)
    parts = {"forces": (names["Quake"](), Gravity()), "boundaries": (names["Ramp"](),)}
    scene = Scene(material=names["Rubber"](), **parts).replaced(QUICK)
    clip = Simulation(prepare(ball(300), scene)).run()
    assert clip.report["complete"]
    assert clip.means[-1, :, 0].mean() > clip.means[0, :, 0].mean()
    assert {"stress rubber", "collider ramp (separate)"} <= set(clip.report["effects"]["ran"])


def test_the_sink_of_the_docs_sends_each_frame(monkeypatch, tmp_path):
    sink = examples(monkeypatch)["PlotJuggler"]
    points = EntryPoints([EntryPoint("plotjuggler", "docs:PlotJuggler", "phy124.sinks")])
    register(monkeypatch, points)
    monkeypatch.setattr(EntryPoint, "load", lambda self: sink)
    clip = random_clip(frames=3, fps=100)
    clip.save(tmp_path / "clip.safetensors")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plotjuggler:
        plotjuggler.bind(("127.0.0.1", 0))
        plotjuggler.settimeout(60)
        port = str(plotjuggler.getsockname()[1])
        arguments = ["play", str(tmp_path / "clip.safetensors"), "--backend", "plotjuggler"]
        assert run_bridge([*arguments, "--port", port], None) == 0
        got = [json.loads(plotjuggler.recv(1000)) for _ in range(3)]
    assert [item["timestamp"] for item in got] == pytest.approx(clip.times)
    assert got[0]["centre"]["x"] == pytest.approx(clip.means[0, :, 0].mean(), abs=1e-6)


def register_format(monkeypatch, format: Format, name: str = "npz") -> None:
    register(monkeypatch, EntryPoints([EntryPoint(name, "docs:NPZ", "phy124.formats")]))
    monkeypatch.setattr(EntryPoint, "load", lambda self: format)


def test_format_of_the_docs_is_read_and_written(monkeypatch, tmp_path, capsys):
    register_format(monkeypatch, examples(monkeypatch)["NPZ"])
    body = ball(50)
    write_gaussians(tmp_path / "ball.ply", body)
    assert main(["convert", str(tmp_path / "ball.ply"), str(tmp_path / "ball.npz")]) == 0
    assert "NumPy archive" in capsys.readouterr().out
    read = read_gaussians(tmp_path / "ball.npz")
    np.testing.assert_allclose(read.gaussians.means, body.means, atol=1e-6)
    assert recognise(tmp_path / "ball.npz").name == "npz" and ".npz" in endings()
    generator = generators.make(str(tmp_path / "ball.npz"))
    assert len(generator(None, seed=0, progress=lambda *event: None)) == 50
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="not an archive of Gaussians"):
        read_gaussians(tmp_path / "other.npz")


def test_signs_shared_by_two_formats_leave_it_to_the_ending(monkeypatch, tmp_path):
    register_format(monkeypatch, examples(monkeypatch)["NPZ"])
    write_gaussians(tmp_path / "ball.sog", ball(50))
    write_gaussians(tmp_path / "ball.npz", ball(50))
    assert recognise(tmp_path / "ball.sog").name == "sog"
    (tmp_path / "ball.npz").rename(tmp_path / "ball")
    assert recognise(tmp_path / "ball").name == "sog"


def test_format_from_outside_does_not_replace_ply(monkeypatch, tmp_path):
    register_format(monkeypatch, examples(monkeypatch)["NPZ"], "ply")
    assert find_written_format(tmp_path / "ball.ply") is FORMATS["ply"]
    assert ".npz" not in endings()


def test_broken_format_is_left_out_and_refused(monkeypatch, tmp_path):
    points = EntryPoints([EntryPoint("odd", "no_such_module:Odd", "phy124.formats")])
    register(monkeypatch, points)
    assert "odd" not in written_formats()
    with pytest.raises(InputError, match="cannot be loaded"):
        write_gaussians(tmp_path / "ball.odd", ball(10), "odd")


def test_plugins_appear_in_reference_schema_and_editor(installed):
    page, output = format_reference(), json.loads(format_schema())
    assert "## `material`: rubber\n\nA fixed corotated solid that keeps" in page
    assert "rigid, rubber, sand" in page
    assert "| `E` | a number from 1 to 1e9 |" in page
    for field, name in (("forces", "freeze"), ("boundaries", "table")):
        assert name in output["properties"][field]["items"]["discriminator"]["mapping"]
    editor = catalogue(Settings())["schema"]["properties"]["material"]
    assert "rubber" in editor["discriminator"]["mapping"]


def test_help_lists_registered_generators_and_sinks(installed, capsys):
    with pytest.raises(SystemExit):
        main(["generate", "--help"])
    assert ", sphere)" in " ".join(capsys.readouterr().out.replace("│", "").split())
    with pytest.raises(SystemExit):
        run_bridge(["play", "--help"], None)
    shown = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "rclpy, dds, foxglove, clip, gone, lamp, none)" in shown


def test_misspelt_name_lists_registered_names(installed):
    with pytest.raises(InputError, match="Did you mean rubber"):
        Scene.from_data({"material": {"law": "ruber"}})


def test_a_broken_kind_is_refused_but_stops_no_other(monkeypatch, installed):
    monkeypatch.setitem(globals(), "Rubber", Table)
    assert plugins.load_kinds("materials", FixedCorotated) == {}
    assert set(plugins.load_kinds("forces", Force)) == {"freeze"}
    with pytest.raises(InputError, match="not a subclass of Material"):
        Scene.from_data({"material": {"law": "rubber"}})
