"""Promises: only what was measured for such a scene, and nothing of a run that may be torn."""

import json
from pathlib import Path

import numpy as np
import pytest

from phy124.accuracy import forecast as load
from phy124.accuracy import promises
from phy124.accuracy.forecast import Load, format_span
from phy124.accuracy.promises import check_promise, largest_error, promise, table
from phy124.accuracy.severity import motion_of, violence, yielding
from phy124.io.ply import write_ply
from phy124.monitor.tearing import Tearing
from phy124.pipeline import simulate
from phy124.scene import PRESETS, Scene
from phy124.simulation.bodies import thickness_of
from support.shapes import ball

THICK = 0.5
"""Local thickness of a compact object, relative to its size."""


def test_the_table_says_what_measured_which_objects():
    known = table()
    assert "cores of" in known["machine"] and known["commits"] and known["safety"] >= 1
    assert all(0 < thickness < 1 for thickness in known["objects"].values())
    for kind in known["scenes"].values():
        assert kind["from"] and kind["violence"] > 0 and kind["length"] > 0
        assert 0 <= kind["nu"] < 0.5 and kind["damping"] >= 0 and kind["yielding"] >= 0
        assert kind["levels"] == sorted(kind["levels"]) and set(kind["errors"]) <= {
            *known["objects"]
        }
        for errors in kind["errors"].values():
            assert len(errors) == len(kind["levels"]) and any(errors)


@pytest.mark.parametrize("name", sorted(table()["scenes"]))
def test_thicker_objects_and_finer_grids_err_less(name):
    kind, thick = table()["scenes"][name], table()["objects"]
    for cells in kind["levels"]:
        found = [largest_error(kind, thick, t, cells)[0] for t in np.linspace(0.005, 1, 200)]
        errors = [error for error in found if error is not None]
        assert errors == sorted(errors, reverse=True) and errors
        assert found[: -len(errors)] == [None] * (200 - len(errors))
    for thickness in thick.values():
        found = [largest_error(kind, thick, thickness, cells)[0] for cells in kind["levels"]]
        errors = [error for error in found if error is not None]
        assert errors == sorted(errors, reverse=True)


KIND = {
    "levels": [16, 32],
    "errors": {
        "ball": [0.02, 0.01],
        "cup": [0.03, None],
        "mug": [0.04, 0.02],
        "vase": [0.01, 0.01],
        "jar": [0.01, 0.01],
        "can": [0.01, 0.01],
        "pot": [0.05, 0.01],
        "leaf": [0.3, 0.2],
    },
}
WIDTHS = (0.8, 0.7, 0.65, 0.6, 0.56, 0.55, 0.5, 0.05)
SIZES = dict(zip(KIND["errors"], WIDTHS, strict=True))


@pytest.mark.parametrize(
    ("thickness", "cells", "error", "count"),
    [
        (0.9, 16, 0.04, 6),  # thicker than all: the six thickest count
        (0.5, 16, 0.05, 7),
        (0.06, 16, 0.3, 8),  # the leaf is more than 0.8 times as thick
        (0.07, 16, 0.05, 7),
        (0.07, 32, 0.03, 7),  # of the cup, which has an error on the coarser grid only
        (0.049, 16, None, 0),  # thinner than all
    ],
)
def test_largest_error_is_that_of_objects_as_thick(thickness, cells, error, count):
    assert largest_error(KIND, SIZES, thickness, cells) == (error, count)


def test_nothing_is_promised_to_objects_thinner_than_all():
    press = Scene.named("press").replaced({"accuracy": "standard"})
    thinnest = min(table()["objects"].values())
    said = promise(press, 0.9 * thinnest)
    assert said.error is None and said.missing
    assert f"that is so thin ({0.9 * thinnest * 32:.1f} cells of this grid)" in said.sentence
    unknown = promise(press, None)
    assert unknown.error is None
    assert unknown.brief == (
        "Expected error: not measured for an object whose thickness is not known yet."
    )


SHOWN = {"jelly", "sand", "snow", "water", "foam", "metal", "wind"}
"""Presets that show a material or the wind; what they may promise depends on the table."""


@pytest.mark.parametrize("name", ["press", "drop", "bounce", "push_right", "spin", "sway"])
def test_presets_are_promised_what_was_measured(name):
    """The named accuracies, from coarse to fine; or nothing, and that it was not measured."""
    scene = Scene.named(name)
    said = [promise(scene.replaced({"accuracy": level}), THICK) for level in PRESETS]
    errors = [one.error for one in said if one.error is not None]
    assert all("not measured" in one.sentence for one in said if one.error is None)
    assert len(errors) == 3 or name in SHOWN
    assert all(0 <= error < 0.4 for error in errors)
    assert errors == sorted(errors, reverse=True)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"material.E": 2e3}, "with so fast a motion or so soft a material"),
        ({"object.velocity": [0, 0, -30]}, "with so fast a motion or so soft a material"),
        ({"accuracy": {"cells": 8}}, "on so coarse a grid"),
        ({"accuracy": {"cells": 32, "particles_per_axis": 1.0}}, "fewer than 2 particles per cell"),
        ({"parts": [{"region": {}, "material": {"law": "sand"}}]}, "several materials"),
    ],
)
def test_off_what_was_measured_nothing_is_promised(changes, why):
    said = promise(Scene.named("drop").replaced(changes), THICK)
    assert said.error is None
    assert why in said.sentence
    assert "phy124 accuracy" in said.sentence


GRAVITY = {"kind": "gravity"}
GROUND = {"kind": "ground"}
SINE = {"kind": "sine", "frequency": 2.0}
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
        ("push_right", {"forces": [{"kind": "acceleration", "profile": SINE}]}, "follows a sine"),
        ("sway", {"forces": [{"kind": "acceleration", "region": {}}]}, "on a region"),
        (
            "press",
            {"boundaries": [GROUND, {"kind": "press", "down": 0.02}]},
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
        ("drop", {"material": {"law": "fluid", "viscosity": 50.0}}, "fluid with another viscosity"),
        ("drop", {"material": {"law": "foam", "viscosity": 1.0}}, "foam with another viscosity"),
    ],
)
def test_violence_sees_all_that_makes_a_scene_violent(preset, changes, why):
    """Nothing is promised beyond what was measured, in whatever it is."""
    usual = Scene.named(preset).replaced({"accuracy": "fine"})
    law = changes.get("material", {}).get("law")
    plain = usual.replaced({"material": {"law": law}} if law else {})
    measured = f"{law or 'neo_hookean'} {motion_of(usual)}" in table()["scenes"]
    assert (promise(plain, THICK).error is not None) == measured
    said = promise(usual.replaced(changes), THICK)
    assert said.error is None and why in said.sentence


def test_longer_scene_is_promised_its_measured_beginning():
    press = Scene.named("press").replaced({"accuracy": "draft"})
    brief, longer = (promise(press.replaced({"time.frames": n}), THICK) for n in (14, 48))
    assert brief.seconds is None and "in the first" not in brief.sentence
    assert longer.error == brief.error and longer.seconds == pytest.approx(13 / 24)
    assert "of the object's size in the first 0.54 s. Measured" in longer.sentence
    assert "What follows, up to 1.96 s, was not measured." in longer.brief
    assert longer.missing == "error after 0.54 s not measured" and not brief.missing
    assert longer.off(3.0).endswith("(3 px) in the first 0.54 s")
    assert check_promise(longer, 0.5).endswith("for the first 0.54 s only; measured here: 50.0%")
    assert check_promise(brief, 0.5).endswith("DOES NOT HOLD")


def test_a_grid_between_two_has_the_error_of_the_coarser(monkeypatch):
    hard = {"violence": 1, "yielding": 0, "nu": 0.4, "damping": 0, "length": 9}
    row = {"errors": {"duck": [0.04, 0.01, None]}, "levels": [16, 32, 48], "from": ["drop"], **hard}
    row["particles_per_axis"] = 2
    known = {"objects": {"duck": 0.5}, "safety": 1.5, "scenes": {"neo_hookean landing": row}}
    monkeypatch.setattr(promises, "table", lambda: known)
    drop = Scene.named("drop")
    for cells, error in ((16, 0.06), (31, 0.06), (32, 0.015), (47, 0.015)):
        said = promise(drop.replaced({"accuracy": {"cells": cells}}), THICK)
        assert said.error == pytest.approx(error)
    assert said.sentence == (
        "Expected error: at most 1.5% of the object's size. Measured at D/32 for neo_hookean "
        "falling or thrown onto something (drop; objects about as thick or thicker: 1)."
    )


@pytest.mark.parametrize("name", ["snow", "sand"])
def test_promise_ignores_the_tint(name):
    scene = Scene.named(name)
    assert scene.material.tint is not None
    assert promise(scene, 0.5).error == promise(scene.replaced({"material.tint": None}), 0.5).error
    assert "tint" not in promise(scene, 0.5).sentence


@pytest.mark.parametrize("finest", [32, 48])
def test_promise_names_the_level_it_was_measured_at(monkeypatch, finest):
    hard = {"violence": 1, "yielding": 0, "nu": 0.4, "damping": 0, "length": 9}
    levels = [level for level in (16, 32, 48) if level <= finest]
    errors = {"duck": [0.06, 0.03, None], "pear": [0.02, 0.01, 0.005]}
    errors = {name: each[: len(levels)] for name, each in errors.items()}
    row = {"errors": errors, "levels": levels, "from": ["drop"], "particles_per_axis": 2, **hard}
    known = {
        "objects": {"duck": 0.5, "pear": 0.5},
        "safety": 1.0,
        "scenes": {"neo_hookean landing": row},
    }
    monkeypatch.setattr(promises, "table", lambda: known)
    drop = Scene.named("drop")
    fine, standard = (promise(drop.replaced({"accuracy": a}), 0.5) for a in ("fine", "standard"))
    assert fine.error == standard.error == 0.03
    assert "Measured at D/32 (D/48 has no smaller expected error yet) for" in fine.sentence
    assert "Measured at D/32 for" in standard.sentence


@pytest.mark.parametrize(
    ("name", "changes", "kind"),
    [
        ("press", {}, "squeezed"),
        ("drop", {}, "landing"),
        ("bounce", {}, "landing"),
        ("drop", {"object.lift": 0.0}, "standing"),
        ("sway", {}, "held"),
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
        {"time.frames": 2, "accuracy": "draft", "view.size": 16, "view.views": ["front"]}
    )
    assert promise(scene, THICK).error is not None
    result = simulate(ball(100), scene, tmp_path)
    told = json.loads((tmp_path / "report.json").read_text())["promise"]
    assert told == result.report["promise"]
    assert told["error"] is None and "torn" in told["why"]
    assert promise(scene, THICK, {"complete": False}).error is None


def test_a_busy_machine_is_less_sure():
    quiet, busy = Load(), Load(2.0, 3.0)
    (low, high), (lower, higher) = quiet.span(10), busy.span(10)
    assert low < 10 < high < 2.5 * low
    assert lower < low < high < higher < 3.5 * lower
    assert Load(20.0, 30.0).span(10) == busy.span(10), "however many there are"
    assert not quiet.busy and busy.busy
    assert Load.measure("cuda:0") == quiet


@pytest.mark.parametrize(
    ("one", "two", "thread", "simulation"),
    [
        (1.0, 0.99, 1.0, 1.0),
        (1.0, 0.7, 1.0, 1.5),  # one other leaves a core to us: there is no second thread
        (0.5, 0.3, 2.0, 3.0),
    ],
)
def test_others_are_seen_by_what_they_leave_of_the_cores(monkeypatch, one, two, thread, simulation):
    monkeypatch.setattr(load, "cores", lambda: 2)
    monkeypatch.setattr(load, "_measure_fraction", {1: one, 2: two}.get)
    assert Load.measure() == Load(thread, simulation)


def test_what_others_did_a_moment_ago_does_not_count(monkeypatch):
    monkeypatch.setattr(load, "_measure_fraction", lambda threads: 1.0)
    monkeypatch.setattr("os.getloadavg", lambda: (8.0, 8.0, 8.0))
    assert not Load.measure().busy


def test_threads_that_spin_do_not_take_the_lock_from_each_other(monkeypatch):
    monkeypatch.setattr(load, "SPIN", 0.02)
    assert all(0 < load._measure_fraction(threads) <= 1.1 for threads in (1, 2))


def test_spans_are_said_in_words():
    assert format_span((0.2, 0.9)) == "1 s"
    assert format_span((8.2, 13.7)) == "8 to 14 s"
    assert format_span((60, 120)) == "1.0 to 2.0 min"
    assert format_span((3600, 9000)) == "1.0 to 2.5 h"


def test_simulate_prints_what_is_promised(tmp_path, capsys):
    from phy124.__main__ import main

    write_ply(tmp_path / "b.ply", ball(100))
    small = ["--frames", "2", "--accuracy", "draft", "--size", "16", "--views", "front"]
    arguments = ["simulate", str(tmp_path / "b.ply"), "--out", str(tmp_path / "o"), *small]
    assert main([*arguments, "--scene", "press", "--device", "cpu"]) == 0
    scene = Scene.named("press").replaced({"accuracy": "draft", "time.frames": 2})
    said = promise(scene, thickness_of(ball(100), scene)).sentence
    assert said in capsys.readouterr().out


def test_no_one_else_words_a_promise():
    """What is said of promised and measured errors stands in one file only."""
    root = Path(promises.__file__).parents[2]
    words = ("can be promised", "Expected error", "Error promised", "error not measured")
    sources = [
        path
        for part in ("phy124", "demo", "bridge")
        for kind in ("py", "js")
        for path in (root / part).rglob(f"*.{kind}")
    ]
    found = {p.name for p in sources if any(word in p.read_text("utf-8") for word in words)}
    assert found == {"promises.py"}
