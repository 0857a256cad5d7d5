"""Goals: what is read from a text, in which unit, and what is refused."""

import pytest

from phy124.accuracy.forecast import Forecast
from phy124.accuracy.goal import STAGES, UNIT, Goal, describe_goal, explain_time, format_error
from phy124.accuracy.probe import SubstepCost
from phy124.errors import InputError
from phy124.scene import Scene


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("2px", "pixels", 2),
        (" .5 % ", "fraction", 0.005),
        ("3mm", "metres", 0.003),
        ("1.5cm", "metres", 0.015),
        ("0.1 m", "metres", 0.1),
        ("1e9px", "pixels", 1e9),
        ("1.5E-1mm", "metres", 1.5e-4),
    ],
)
def test_an_error_is_read_with_its_unit(text, kind, value):
    goal = Goal.error(text)
    assert (goal.kind, goal.value) == (kind, pytest.approx(value))


@pytest.mark.parametrize(
    "text", ["", "2", "px", "-1px", "0%", "1e400mm", "e3mm", "2 miles", "nan%"]
)
def test_other_texts_are_refused_with_an_example(text):
    with pytest.raises(InputError, match="2px, 1% or 3mm"):
        Goal.error(text)


@pytest.mark.parametrize("seconds", [0, -1, float("nan"), float("inf")])
def test_a_time_must_be_positive_and_finite(seconds):
    with pytest.raises(InputError, match="positive number of seconds"):
        Goal.time(seconds)


def test_goal_values_have_the_units_of_the_scene():
    scene = Scene.named("drop").replaced({"object.size": 2.0})
    assert UNIT["metres"](scene) == 2.0 and UNIT["fraction"](scene) == 1.0
    assert UNIT["pixels"](scene) > 100
    assert [
        format_error("pixels", 2.04),
        format_error("fraction", 0.012),
        format_error("metres", 0.0034),
    ] == ["2.0 px", "1.2 %", "3.4 mm"]


@pytest.mark.parametrize(
    ("stage", "words", "views"), [("outputs", "outputs", True), ("export", "whole clip", False)]
)
def test_a_time_too_short_names_the_longest_stage(stage, words, views):
    stages = {"simulate": 0.5, stage: 5.0}
    forecast = Forecast(stages, (), 100, 100, 10, {}, SubstepCost(1e-9, 1e-9))
    scene = Scene.named("press").replaced({"view.views": ["front", "left"]})
    refusal = explain_time(Goal.time(1), scene, 8, forecast, 0.0)
    assert f"most of it (5 s) for {STAGES[stage]}" in refusal.limit and words in STAGES[stage]
    assert ("view.views = front" in refusal.remedy) == views


def test_search_names_the_error_of_each_grid():
    goal = {"target": "3%", "unit": "fraction", "cells": 16, "levels": [12, 16, 24]}
    goal |= {"errors": [0.034, 0.021, 0.009], "met": True, "why_not": ""}
    tried = "estimated errors: D/12 3.4 %, D/16 2.1 %, D/24 0.90 %"
    assert describe_goal(goal, 4.0) == (f"asked for an error of at most 3%: D/16 meets it; {tried}")
    missed = {**goal, "met": False, "cells": 24, "why_not": "D/32 would take too long"}
    assert f"D/24 is used, which does NOT meet it: D/32 would take too long; {tried}" in (
        describe_goal(missed, 4.0)
    )
