"""Promises: only what was measured for such a scene, and nothing of a run that may be torn."""

import json
from pathlib import Path

import numpy as np
import pytest

from phy124.accuracy import promises
from phy124.accuracy.expectation import expect, kind_of, properties, table
from phy124.accuracy.promises import (
    Promise,
    check_promise,
    format_percent,
    promise,
    promise_measured,
    promise_own,
)
from phy124.accuracy.severity import motion_of, violence, yielding
from phy124.io.ply import write_ply
from phy124.monitor.tearing import Tearing
from phy124.particles.thickness import Proportions
from phy124.pipeline import simulate
from phy124.scene import PRESETS, Scene
from phy124.simulation.bodies import proportions_of
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

ROOT = Path(promises.__file__).parents[2]
USUAL = Proportions(0.3, 0.3)
COMPRESSIBLE = {"accuracy": {"cells": 48, "liquid": "compressible"}}
"""Proportions of a compact object."""


def test_model_names_its_machines_and_ranges():
    known = table()
    assert known["machines"] and known["objects"] >= 25
    for kind in known["kinds"].values():
        assert kind["objects"] >= 4 and kind["cells"][0] <= 16
        assert all(low <= high for low, high in (kind[name] for name in ("nu", "length")))


@pytest.mark.parametrize("name", ["press", "drop", "sway", "spin"])
def test_finer_grids_are_expected_to_err_less(name):
    scene = Scene.named(name).replaced({"time.frames": 14})
    grids = [scene.replaced({"accuracy": {"cells": n}}) for n in (10, 16, 24, 32, 48, 64)]
    errors = [expect(grid, USUAL).error for grid in grids]
    assert None not in errors and errors == sorted(errors, reverse=True)


def test_nothing_is_promised_to_objects_thinner_than_all():
    accuracy = {"cells": 16, "solver": "mpm"}
    press = Scene.named("press").replaced({"accuracy": accuracy, "material.law": "neo_hookean"})
    known = {"coefficients": {}, "features": [], "kinds": {"elastic squeezed": dict(RANGE)}}
    said = expect(press, Proportions(0.1, 0.3), known)
    assert said.error is None and "with an object only 1.6 grid cells thick" in said.unmeasured
    assert expect(press, Proportions(0.2, 0.3), known).error == 1.0
    unknown = promise(press, None)
    assert unknown.error is None
    assert unknown.brief == ("Expected error: not measured for an object of unknown proportions.")


RANGE = {
    "objects": 9,
    "particles_per_axis": 2.0,
    "cells": [8, 32],
    "thickness": [2.5, 20.0],
    "compliance": [0.1, 9.0],
    "violence": [0.1, 1.0],
    "yielding": [0.0, 0.0],
    "damping": [0.0, 1.0],
    "nu": [0.3, 0.4],
    "length": [1.0, 9.0],
}


def test_predictions_add_the_groups_and_never_extrapolate():
    press = Scene.named("press").replaced({"accuracy.solver": "mpm", "time.frames": 14})
    coefficients = {
        "all": {"one": -3.0, "cells": -1.0, "coarse": 2.0},
        "squeezed": {"one": 0.5, "thickness": -1.0},
        "elastic": {"one": 0.25},
        "sand": {"one": 9.0},
    }
    known = {"coefficients": coefficients, "features": [], "kinds": {"elastic squeezed": RANGE}}
    error = expect(press, Proportions(10 / 32, 0.3), known).error
    assert error == pytest.approx(np.exp(-3 + 0.5 + 0.25) / 2)
    finer = press.replaced({"accuracy.cells": 128})
    assert expect(finer, Proportions(10 / 32, 0.3), known).error == pytest.approx(error)
    coarser = press.replaced({"accuracy.cells": 16})
    assert expect(coarser, Proportions(20 / 32, 0.3), known).error == pytest.approx(8 * error)


def test_errors_on_lattices_come_from_runs_on_lattices():
    press = Scene.named("press").replaced({"time.frames": 14, "accuracy.solver": "lattice"})
    kinds = {"elastic squeezed": RANGE}
    known = {"coefficients": {"lattice": {"one": -1.0}}, "features": [], "kinds": kinds}
    said = expect(press, USUAL, known)
    assert said.error is None and said.unmeasured == "elastic pressed or gripped, on a lattice"
    kinds["lattice elastic squeezed"] = {**RANGE, "objects": 5}
    said = expect(press, USUAL, known)
    assert (said.error, said.objects) == (pytest.approx(np.exp(-1)), 5)
    mpm = expect(press.replaced({"accuracy.solver": "mpm"}), USUAL, known)
    assert (mpm.error, mpm.objects, mpm.such) == (1.0, 9, "elastic pressed or gripped, by MPM")
    wind = press.replaced({"forces": [{"kind": "wind", "v": [0, 1, 0]}]})
    known["features"] = ["a force of the kind wind"]
    assert expect(wind, USUAL, known).unmeasured == "a force of the kind wind, on a lattice"


def test_violence_sees_forces_walls_and_hands():
    still = Scene.named("sway").replaced({"forces": []})
    assert violence(still) == 0
    forces = [
        {"kind": "wind", "v": [0, 9, 0]},
        {"kind": "force", "f": [0, 9, 0]},
        {"kind": "impulse", "p": [0, 9, 0]},
        {"kind": "set_velocity", "v": [0, 9, 0]},
        {"kind": "wrench", "torque": [0, 0, 9]},
        {"kind": "zone", "a": [0, 9, 0]},
        {"kind": "attraction", "g": 9},
        {"kind": "particle_force", "f": [0, 9e-3, 0]},
        {"kind": "grab", "targets": [[0, 0, 0.5], [0, 0, 0.9]]},
    ]
    for force in forces:
        assert violence(still.replaced({"forces": [force]})) > 1e-4, force
    swing = {"boundaries.0.motion": {"kind": "swing"}}
    assert violence(still.replaced(swing)) > 1e-4


SHOWN = {"jelly", "sand", "snow", "water", "foam", "metal", "wind"}
"""Presets that show a material or the wind; what they may promise depends on the table."""


@pytest.mark.parametrize("name", ["press", "drop", "bounce", "push_right", "spin", "sway"])
def test_presets_are_promised_what_was_measured(name):
    """The named accuracies, from coarse to fine; or nothing, and that it was not measured."""
    scene = Scene.named(name)
    scenes = [scene.replaced({"accuracy": level}) for level in PRESETS]
    said = [promise(scene, USUAL) for scene in scenes]
    errors = [item.error for item in said if item.error is not None]
    assert all("not measured" in item.sentence for item in said if item.error is None)
    assert len(errors) == 3 or name in SHOWN
    assert all(0 <= error < 0.4 for error in errors)
    for solver in ("mpm", "lattice"):
        pairs = zip(scenes, said, strict=True)
        same = [item.error or 0.0 for scene, item in pairs if scene.solver == solver]
        assert same == sorted(same, reverse=True)


@pytest.mark.parametrize("name", ["snow", "stack", "bury", "land_on_cushion"])
def test_presets_of_several_objects_and_of_snow_are_measured(name):
    scene = Scene.named(name).replaced({"accuracy": {"cells": 16, "solver": "mpm"}})
    assert 0.01 < expect(scene, USUAL).error < 0.2


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"material.E": 2e3}, "with so fast a motion or so soft a material"),
        ({"object.velocity": [0, 0, -30]}, "with so fast a motion or so soft a material"),
        ({"accuracy": {"cells": 4}}, "on so coarse a grid"),
        ({"accuracy": {"cells": 32, "particles_per_axis": 1.0}}, "fewer than 2 particles per cell"),
        ({"parts": [{"region": {}, "material": {"law": "sand"}}]}, "elastic and sand falling"),
        ({"material.law": "sand", "material.repose_angle": 20}, "with another repose_angle"),
    ],
)
def test_off_what_was_measured_nothing_is_promised(changes, why):
    said = promise(Scene.named("drop").replaced(changes), USUAL)
    assert said.error is None
    assert why in said.sentence
    assert "phy124 accuracy" in said.sentence


GRAVITY = {"kind": "gravity"}
GROUND = {"kind": "ground"}
GRAB = {"kind": "grab", "targets": [[0, 0, 0.5], [0, 0, 2.0]]}


@pytest.mark.parametrize(
    ("preset", "changes", "why"),
    [
        ("sway", {"forces": [{"kind": "wind", "v": [0, 30, 0]}]}, "force of the kind wind"),
        ("drop", {"forces": [{"kind": "force", "f": [0, 9e3, 0]}]}, "force of the kind force"),
        ("drop", {"forces": [{"kind": "impulse", "p": [0, 9e3, 0]}]}, "kind impulse"),
        ("drop", {"forces": [{"kind": "set_velocity", "v": [0, 9, 0]}]}, "kind set_velocity"),
        ("drop", {"forces": [GRAVITY, GRAB]}, "kind grab"),
        ("drop", {"forces": [{"kind": "wrench", "torque": [0, 0, 9e3]}]}, "kind wrench"),
        ("drop", {"forces": [{"kind": "zone", "a": [0, 9, 0]}]}, "kind zone"),
        ("sway", {"forces": [{"kind": "acceleration", "region": {}}]}, "on a region"),
        (
            "press",
            {"boundaries": [GROUND, {"kind": "press", "down": 0.1}]},
            "with so fast a motion",
        ),
        (
            "press",
            {"boundaries": [GROUND, {"kind": "press", "depth": 0.9, "down": 9.0, "up": 9.0}]},
            "with so fast a motion",
        ),
        ("drop", {"boundaries": [{"kind": "ground", "motion": {"kind": "swing"}}]}, "that moves"),
        ("drop", {"material.damping": 0.0}, "with so little damping"),
        ("drop", {"material.nu": 0.49}, "with Poisson's ratio above"),
        (
            "drop",
            {"material": {"law": "metal", "yield_stress": 2e4}},
            "with so large a plastic deformation",
        ),
        ("drop", {"material": {"law": "fluid", "viscosity": 50.0}}, "a liquid by projection"),
        ("drop", {"material": {"law": "foam", "viscosity": 1.0}}, "with so little damping"),
    ],
)
def test_scenes_beyond_the_measured_have_no_promise(preset, changes, why):
    """Nothing is promised beyond what was measured, in whatever it is."""
    usual = Scene.named(preset).replaced({"accuracy": "fine"})
    law = changes.get("material", {}).get("law")
    plain = usual.replaced({"material": {"law": law}, **COMPRESSIBLE} if law else {})
    limits = {name: [value, value] for name, value in properties(plain, USUAL).items()}
    kind = {"objects": 9, "particles_per_axis": plain.particles_per_axis, **limits}
    known = {"coefficients": {}, "features": [], "kinds": {kind_of(plain): kind}}
    assert expect(plain, USUAL, known).error == 1.0
    said = expect(usual.replaced(changes), USUAL, known)
    assert said.error is None and why in said.unmeasured


def test_longer_scene_is_promised_its_measured_beginning():
    press = Scene.named("press").replaced({"accuracy": "draft"})
    brief, longer = (promise(press.replaced({"time.frames": n}), USUAL) for n in (14, 48))
    assert brief.seconds is None and "in the first" not in brief.sentence
    assert longer.error == brief.error and longer.seconds == pytest.approx(13 / 24, rel=1e-3)
    assert "of the object's size in the first 0.54 s. Fitted to" in longer.sentence
    assert "The rest of the clip, up to 1.96 s, was not measured." in longer.brief
    assert longer.missing == "error after 0.54 s not measured" and not brief.missing
    assert longer.off(3.0).endswith("(3 px) in the first 0.54 s")
    assert check_promise(longer, 0.5).endswith("for the first 0.54 s only; measured here: 50 %")
    assert check_promise(brief, 0.5).endswith("DOES NOT HOLD")


def test_promise_of_a_falling_object_names_its_end():
    said = {name: promise(Scene.named(name), USUAL).sentence for name in ("bounce", "press")}
    assert "holds until the motion begins to differ from grid to grid" in said["bounce"]
    assert "grid to grid" not in said["press"]


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.0, "0.010 %"), (0.0084, "0.84 %"), (0.01, "1.0 %"), (0.123, "12 %"), (1.2, "120 %")],
)
def test_percentages_have_two_significant_digits(fraction, text):
    assert format_percent(fraction) == text


def test_verdict_shows_the_digits_that_decide_it():
    said = check_promise(Promise(0.00801, ""), 0.00804, stated={"at_most": 0.011})
    assert said == (
        "at most 0.801 %, measured 0.804 %: the bound DOES NOT HOLD; "
        "the run itself states at most 1.1 %"
    )
    said = check_promise(Promise(0.008, ""), 0.008)
    assert said == "at most 0.80 %, measured 0.80 %: the bound holds"


def test_error_of_several_grids_has_a_bound_above_it():
    said = promise_measured(0.01, 24, (12, 16, 24))
    assert said.size() == "about 1.0 % of the object's size, at most 3.0 %"
    assert said.off(8.0) == "off by at most 3.0 % (8 px)"
    assert said.row == ("Error of this run", f"{said.size()}. Measured on D/12, D/16 and D/24.")


def test_finished_run_without_its_own_error_says_why():
    press = Scene.named("press").replaced({"accuracy": "draft"})
    report = {"error": {"about": None, "why_not": "a coarser grid would take too long"}}
    reason = " This run did not estimate its error: a coarser grid would take too long."
    for scene in (press, press.replaced({"material.E": 2e3})):
        before, after = promise(scene, USUAL), promise(scene, USUAL, report)
        assert after.sentence == before.sentence + reason and after.brief == before.brief + reason


def test_player_and_report_word_the_parting_alike():
    script = (ROOT / "phy124/io/viewer/player.js").read_text("utf-8")
    words = "s the motion differs from grid to grid: it is plausible, but not a prediction."
    assert words in script
    entry = {"about": 0.01, "at_most": 0.02, "until": 1.2, "cells": 16}
    assert words in promise_own(entry).sentence


@pytest.mark.parametrize("name", ["snow", "sand"])
def test_promise_ignores_the_tint(name):
    scene = Scene.named(name)
    assert scene.material.tint is not None
    assert (
        promise(scene, USUAL).error == promise(scene.replaced({"material.tint": None}), USUAL).error
    )
    assert "tint" not in promise(scene, USUAL).sentence


@pytest.mark.parametrize(
    ("name", "changes", "kind"),
    [
        ("press", {}, "squeezed"),
        ("drop", {}, "landing"),
        ("bounce", {}, "landing"),
        ("drop", {"object.lift": 0.0}, "standing"),
        ("sway", {}, "held"),
        ("jelly", {}, "held"),
        ("spin", {}, "free"),
        ("push_right", {}, "free"),
    ],
)
def test_kinds_of_motion(name, changes, kind):
    assert motion_of(Scene.named(name).replaced(changes)) == kind


def test_violence_is_energy_over_stiffness():
    drop = Scene.named("drop")
    assert violence(drop.replaced({"material.E": 1e5})) == pytest.approx(2 * violence(drop))
    assert violence(drop.replaced({"object.lift": 0.8})) == pytest.approx(
        violence(drop) * 2.6 / 1.6
    )
    softer = drop.replaced({"material.nu": 0.0})
    assert violence(softer) == violence(drop), "a bar is as stiff, whatever Poisson's ratio is"
    press = Scene.named("press")
    assert violence(press) > violence(press.replaced({"boundaries.1.depth": 0.1})) > 0
    metal = drop.replaced({"material": {"law": "metal", "yield_stress": 1e5}})
    assert yielding(metal) == pytest.approx(2700 * 9.81 * 1.6 / 1e5)


def test_a_run_that_may_be_torn_or_stopped_keeps_no_promise(tmp_path, monkeypatch):
    """However well such scenes did elsewhere."""
    monkeypatch.setattr(Tearing, "likely", property(lambda self: True))
    scene = Scene.named("drop").replaced(
        {"time.frames": 2, "view.size": 16, "view.views": ["front"]}
    )
    scene = scene.replaced({"accuracy": {"cells": 16, "solver": "mpm"}})
    assert promise(scene, USUAL).error is not None
    result = simulate(ball(100), scene, tmp_path)
    output = json.loads((tmp_path / "report.json").read_text())["promise"]
    assert output == result.report["promise"]
    assert output["error"] is None and "torn" in output["why"]
    assert promise(scene, USUAL, {"complete": False}).error is None


def test_simulate_prints_what_is_promised(tmp_path, capsys):
    from phy124.__main__ import main

    write_ply(tmp_path / "b.ply", ball(100))
    small = ["--frames", "2", "--accuracy", "draft", "--size", "16", "--views", "front"]
    arguments = ["simulate", str(tmp_path / "b.ply"), "--out", str(tmp_path / "o"), *small]
    assert main([*arguments, "--scene", "press", "--device", "cpu"]) == 0
    scene = Scene.named("press").replaced({"accuracy": "draft", "time.frames": 2})
    said = promise(scene, proportions_of(ball(100), scene)).sentence
    assert said in capsys.readouterr().out


def test_no_one_else_words_a_promise():
    """Sentences about promised and measured errors are in a single file."""
    words = ("can be promised", "Expected error", "Error of this run", "error not measured")
    sources = [
        path
        for part in ("phy124", "demo", "bridge")
        for kind in ("py", "js")
        for path in (ROOT / part).rglob(f"*.{kind}")
    ]
    results = {p.name for p in sources if any(word in p.read_text("utf-8") for word in words)}
    assert results == {"promises.py"}
