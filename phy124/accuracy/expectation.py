"""Predicts the error of a scene before it runs, from a model fitted to measured errors.

The logarithm of the error bound is linear in the logarithms of a few `properties`. Each coefficient
is a sum with one term per group of scenes (`groups`). tests/benchmarks/zoo.py measures the errors,
and tests/benchmarks/expectations.py fits the model and writes measured.json.
"""

import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

from phy124.accuracy.severity import (
    Motion,
    damping,
    find_difference,
    length,
    motion_of,
    poisson,
    violence,
    yielding,
)
from phy124.materials.elastic import Springy
from phy124.particles.thickness import Proportions
from phy124.scene import Scene

WORDS: dict[Motion, str] = {
    "squeezed": "pressed or gripped",
    "landing": "falling or thrown onto something",
    "standing": "standing on something",
    "held": "held at a part of it",
    "free": "touching nothing",
}
ON_LATTICE = ", on a lattice"
MARGIN = 1.25
"""Factor by which a property may exceed the largest measured value."""
NEARBY = 0.02
"""Amount by which Poisson's ratio may exceed the measured range."""
HARDER = {
    "violence": "with so fast a motion or so soft a material",
    "yielding": "with so large a plastic deformation",
}
"""Descriptions of properties above the measured range."""
THINNEST = 0.7
"""Thickness [cells] below which the error no longer depends on the thickness."""
SOLID = Proportions(thickness=1.0, compliance=0.1)
"""Proportions of a thick object."""
UNKNOWN = "an object of unknown proportions"
"""Kind of a scene whose object does not exist yet."""
SEPARATE = "an object of several separate pieces"
STIFFEST, SOFTEST = 0.02, 100.0
"""Smallest and largest compliance between which the error depends on the compliance."""


class Expectation(NamedTuple):
    """The predicted error of a scene, or the reason why there is none."""

    error: float | None
    """Bound on the RMS distance from the exact motion, relative to the object's size."""
    unmeasured: str = ""
    """Kind of the scene if no such scene was measured; otherwise empty."""
    such: str = ""
    """Law and kind of motion of the measured objects."""
    objects: int = 0
    """Number of measured objects."""
    length: float = math.inf
    """Longest measured scene, in units of sqrt(size / 9.81 m/s^2)."""


def law_of(scene: Scene) -> str:
    """Return a scene's law, or "elastic" for laws without plastic or viscous flow."""
    sections = scene.materials
    laws = {"elastic" if isinstance(each, Springy) else each.law for each in sections}
    return " and ".join(sorted(laws))


def kind_of(scene: Scene) -> str:
    """Return law and kind of motion, such as "elastic landing" or "lattice elastic landing"."""
    kind = f"{law_of(scene)} {motion_of(scene)}"
    return f"lattice {kind}" if scene.on_lattice else kind


def groups(scene: Scene) -> list[str]:
    """Return the groups to which a scene belongs; the model adds up one coefficient for each."""
    motion, law = motion_of(scene), law_of(scene)
    names = ["all", motion, law, f"{law} {motion}", *features(scene)]
    return [*names, "lattice", kind_of(scene)] if scene.on_lattice else names


def name_features(scene: Scene) -> list[str]:
    """Return the scene's special features; on lattices, the names also mention the solver."""
    names = features(scene)
    return [f"{name}{ON_LATTICE}" for name in names] if scene.on_lattice else names


def features(scene: Scene) -> list[str]:
    """Return the special features of a scene, such as moving walls."""
    forces = [force for force in scene.acting if force.kind not in ("gravity", "acceleration")]
    names = {f"a force of the kind {force.kind}" for force in forces}
    if any(force.region is not None for force in scene.acting):
        names.add("a force on a region")
    for wall in scene.boundaries:
        if wall.moves and wall.kind != "press":
            names.add("a clamp that moves" if wall.holds else "a wall that moves")
    if scene.projects:
        names.add("a liquid by projection")
        if len({section.density for section in scene.materials if section.law == "fluid"}) > 1:
            names.add("liquids of different densities")
    if scene.binding == "particles":
        names.add("binding = particles")
    if scene.objects:
        names.add("several objects")
    return sorted(names)


def properties(scene: Scene, proportions: Proportions) -> dict[str, float]:
    """Return the properties that determine the error of a scene."""
    cells, thickness = scene.resolution.cells, proportions.thickness
    return {
        "cells": float(cells),
        "thickness": max(thickness * cells, THINNEST),
        "compliance": min(max(proportions.compliance, STIFFEST), SOFTEST),
        "violence": violence(scene, thickness),
        "yielding": yielding(scene, thickness),
        "damping": damping(scene),
        "nu": poisson(scene),
        "length": length(scene),
    }


def regressors(values: Mapping[str, float]) -> dict[str, float]:
    """Return the terms of the linear model."""
    return {
        "one": 1.0,
        "cells": math.log(values["cells"] / 32),
        "coarse": max(0.0, math.log(32 / values["cells"])),
        "thickness": math.log(values["thickness"] / 5),
        "compliance": math.log(values["compliance"] / 0.5),
        "violence": math.log(max(values["violence"], 1e-4) / 0.1),
        "yielding": math.log1p(values["yielding"]),
        "damping": math.log1p(values["damping"] / 0.01),
        "nu": -math.log1p(-2 * min(values["nu"], 0.495)),
        "length": math.log(values["length"] / 2),
    }


def expect(
    scene: Scene, proportions: Proportions | None, model: Mapping[str, Any] | None = None
) -> Expectation:
    """Predict the error bound of a scene; the default `model` is in measured.json."""
    model = model or table()
    law, motion = law_of(scene), motion_of(scene)
    solver = ON_LATTICE if scene.on_lattice else ", by MPM" if "elastic" in law else ""
    such, measured = f"{law} {WORDS[motion]}{solver}", model["kinds"].get(kind_of(scene))
    unknown = _describe_beyond(scene, model["features"])
    if unknown or measured is None:
        return Expectation(None, unknown or such)
    values = properties(scene, proportions or SOLID)
    outside = _describe_outside(scene, values, measured)
    if outside:
        return Expectation(None, f"{such} {outside}")
    if proportions is None:
        return Expectation(None, UNKNOWN)
    if proportions.pieces > 1:
        return Expectation(None, SEPARATE)
    # The predicted error is never smaller than on the finest measured grid.
    finest = measured["cells"][1]
    grids = [
        values | {"cells": cells, "thickness": max(proportions.thickness * cells, THINNEST)}
        for cells in (min(values["cells"], finest), finest)
    ]
    names = groups(scene)
    error = max(predict(model["coefficients"], names, _clamp(each, measured)) for each in grids)
    return Expectation(error, "", such, measured["objects"], measured["length"][1])


def predict(
    coefficients: Mapping[str, Mapping[str, float]], names: list[str], values: Mapping[str, float]
) -> float:
    """Return the error bound, relative to the object's size."""
    terms = regressors(values)
    each = (coefficients.get(name, {}) for name in names)
    return math.exp(sum(c * terms[term] for group in each for term, c in group.items()))


def _clamp(values: Mapping[str, float], measured: Mapping[str, Any]) -> dict[str, float]:
    """Limit properties to the measured ranges, because the model must never extrapolate."""
    return {
        name: min(max(value, measured[name][0]), measured[name][1])
        for name, value in values.items()
    }


def _describe_beyond(scene: Scene, known: Sequence[str]) -> str:
    """Describe a feature without measured errors, or return ""."""
    if scene.stiffness is not None or scene.properties is not None:
        return "materials that vary from point to point"
    accuracy = scene.resolution
    if accuracy.rpic_damping > 0:
        return "motion that accuracy.rpic_damping damps"
    if accuracy.gradient != type(accuracy).model_fields["gradient"].default:
        return f"accuracy.gradient = {accuracy.gradient}"
    new = [name for name in name_features(scene) if name not in known]
    return new[0] if new else find_difference(scene)


def _describe_outside(
    scene: Scene, values: Mapping[str, float], measured: Mapping[str, Any]
) -> str:
    """Describe a property outside the measured range, or return "". Values that make the error
    smaller are not reported.
    """
    for name, words in HARDER.items():
        if values[name] > MARGIN * measured[name][1]:
            return words
    if values["damping"] * MARGIN < measured["damping"][0]:
        return "with so little damping"
    if values["nu"] > measured["nu"][1] + NEARBY:
        return f"with Poisson's ratio above {measured['nu'][1]:g}"
    if scene.particles_per_axis < measured["particles_per_axis"]:
        least = measured["particles_per_axis"]
        return f"with fewer than {least:g} particles per cell and axis"
    if values["cells"] < measured["cells"][0]:
        return "on so coarse a grid"
    if values["thickness"] * MARGIN < measured["thickness"][0]:
        return f"with an object only {values['thickness']:.1f} grid cells thick"
    return ""


@cache
def table() -> dict[str, Any]:
    """Return the content of measured.json."""
    file = resources.files("phy124") / "accuracy" / "measured.json"
    return json.loads(file.read_text("utf-8"))
