"""The kernels to compile for a scene: all that a run launches, except those in the cache."""

import pytest
import warp as wp
from warp._src.context import Module

from phy124.accuracy.filming import time_film
from phy124.accuracy.probe import probe, seconds_to_compile
from phy124.runtime.compiling import is_compiled
from phy124.runtime.context import RunContext
from phy124.runtime.kernel_cache import compiled_file
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.solver import kernels
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {"accuracy": {"cells": 8, "particles_per_axis": 1.0}, "time.frames": 2, "time.fps": 240.0}
WALLS = {
    "container": {"kind": "container"},
    "gripper": {"kind": "gripper", "thick": 0.3},
    "sphere": {"kind": "sphere", "centre": [0.0, 0.0, 0.0]},
    "capsule": {"kind": "capsule", "start": [0.0, 0.0, 0.0], "end": [0.1, 0.0, 0.0], "radius": 0.3},
}


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("press", {}),
        ("sway", {}),
        ("spin", {}),
        ("drop", {"material": {"law": "sand"}}),
        pytest.param(
            "drop",
            {"accuracy": {"cells": 8, "particles_per_axis": 1.0, "precision": "float64"}},
            marks=pytest.mark.slow,
        ),
        *(
            pytest.param("drop", {"boundaries": [wall]}, marks=pytest.mark.slow)
            for wall in WALLS.values()
        ),
    ],
)
def test_all_that_takes_long_is_listed(name, changes, monkeypatch):
    """Modules that a run loads are listed, but for a few of tenths of a second."""
    loaded, load = set(), Module.load

    def noted(module, *arguments, **options):
        loaded.add(module.name)
        return load(module, *arguments, **options)

    monkeypatch.setattr(Module, "load", noted)
    # Else all that is listed would be loaded, whether a run launches it or not.
    monkeypatch.setattr("phy124.simulation.run.compile_missing", lambda *_: 0)
    scene = Scene.named(name).replaced({**QUICK, **changes})
    Simulation(prepare(ball(300), scene)).run()
    listed = {kernel.module.name: kernel.seconds for kernel in kernels(scene)}
    assert set(listed) <= loaded
    small = ("uniform_sums", "merge", "barrier", "push_", "field")
    assert not {n for n in loaded - set(listed) if not any(word in n for word in small)}
    assert sum(listed.values()) > 4
    assert seconds_to_compile(scene) == 0, "a run has compiled them"


def test_kernels_missing_in_the_cache_take_time(monkeypatch, tmp_path):
    scene = Scene.named("drop").replaced({"material": {"law": "plasticine"}})
    missing = [*kernels(scene)]
    for kernel in missing:  # Other tests of this process may have loaded some, or all.
        monkeypatch.setattr(kernel.module, "execs", {})
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    assert not any(is_compiled(kernel) for kernel in missing)
    made = compiled_file(missing[0], "cpu")
    assert made is not None
    made.parent.mkdir()
    assert not is_compiled(missing[0])
    assert seconds_to_compile(scene, "cuda:0") == 0
    longest = max(kernel.seconds for kernel in missing)
    monkeypatch.setattr("phy124.accuracy.probe.cores", lambda: 99)
    assert seconds_to_compile(scene) == longest, "no module is compiled by two cores"
    monkeypatch.setattr("phy124.accuracy.probe.cores", lambda: 1)
    before = seconds_to_compile(scene)
    for file in (made, made.with_suffix(".meta")):
        file.touch()
    assert is_compiled(missing[0])
    assert seconds_to_compile(scene) < before


def test_probe_of_a_graph_leaves_the_state(monkeypatch):
    """The substeps of a GPU's graph are measured by two probes, here with the graph of a CPU."""
    monkeypatch.setattr("phy124.mpm.solver.usable", lambda device: True)
    run = Simulation(prepare(ball(300), Scene.named("drop").replaced(QUICK)))
    x, counts = run.solver.state.x.numpy().copy(), []
    advance = run.solver.advance
    monkeypatch.setattr(
        run.solver,
        "advance",
        lambda *args, **options: (
            counts.append("graph" in run.solver.timings) or advance(*args, **options)
        ),
    )
    cost, nodes, checks = probe(run)
    assert any(counts), "no graph was used"
    assert cost.particle > 0 and cost.node == 0 and nodes > 0 and checks > 0
    assert (run.solver.state.x.numpy() == x).all() and run.solver.clock.substeps == 0


@pytest.mark.parametrize("viscosity", [0.0, 1.0])
def test_a_liquid_at_rest_is_probed(monkeypatch, viscosity):
    """At rest, a viscous liquid allows a substep of minutes, which the probe must not simulate."""
    changes = {"accuracy": {"cells": 8}, "time.frames": 2, "material.viscosity": viscosity}
    run = Simulation(prepare(ball(200), Scene.named("water").replaced(changes)))
    advance = run.solver.advance

    def soon(until, **options):
        assert until - run.solver.clock.time < 3
        return advance(until, **options)

    monkeypatch.setattr(run.solver, "advance", soon)
    cost, nodes, _ = probe(run)
    assert cost.particle > 0 and nodes > 0


@pytest.mark.parametrize(
    ("view", "stages"),
    [({"formats": ["ply"]}, {"export"}), ({"formats": [], "outputs": ["depth"]}, {"outputs"})],
)
def test_forecast_without_videos_has_no_encoding(view, stages):
    scene = Scene.named("drop").replaced({**QUICK, "view": {"size": 32, **view}})
    predicted = time_film(prepare(ball(200), scene), RunContext())
    assert set(predicted) == {"save", "render", *stages}


def test_forecast_has_the_pictures_of_a_seamless_video(monkeypatch):
    """Videos run forwards and backwards; a picture is assumed to take a second."""
    monkeypatch.setattr(
        "phy124.accuracy.filming.film",
        lambda clip, view, folder, context: context.watch.seconds.update(
            render=len(clip), encode=0.5 + len(clip)
        ),
    )
    view = {"size": 32, "views": ["front", "orbit"], "seamless": True}
    scene = Scene.named("drop").replaced({**QUICK, "time.frames": 10, "view": view})
    predicted = time_film(prepare(ball(200), scene), RunContext())
    assert predicted["render"] == 2 * 18
    assert predicted["encode"] == 2 * (0.5 + 18)


@pytest.mark.parametrize(("name", "shines"), [("water", True), ("metal", True), ("jelly", False)])
def test_forecast_has_the_time_of_highlights(name, shines):
    changes = {"accuracy": {"cells": 8}, "time.frames": 2, "view": {"size": 32}}
    setup = prepare(ball(200), Scene.named(name).replaced(changes))
    assert ("shine" in time_film(setup, RunContext())) == shines
