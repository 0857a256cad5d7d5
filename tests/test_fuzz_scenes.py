"""Random scenes: whatever a scene file may say, the result is finite and its balance adds up."""

import math
import re
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, event, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.materials import LAWS
from phy124.monitor.watchdog import ENERGY_GAIN, PROJECTED
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

pytestmark = pytest.mark.usefixtures("coarse_solids")

UNITS = st.floats(-1, 1)


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers whose logarithm is even between two numbers."""
    return st.floats(math.log10(low), math.log10(high)).map(lambda e: min(max(10**e, low), high))


def vectors(length: st.SearchStrategy[float]) -> st.SearchStrategy[tuple[float, float, float]]:
    """Vectors of any direction and such lengths."""
    return st.builds(lambda a, b, c, s: (a * s, b * s, c * s), UNITS, UNITS, UNITS, length)


def within(field: FieldInfo) -> st.SearchStrategy[float]:
    """Numbers within a field's bounds, by decades where these are far apart, and the bounds."""
    low, high = (
        getattr(limit, name) for limit, name in zip(field.metadata, ("ge", "le"), strict=True)
    )
    if high <= 100 * max(low, 1):
        return st.one_of(st.floats(low, high), st.sampled_from([float(low), float(high)]))
    return decades(low, high) if low else st.one_of(st.just(0.0), decades(1e-3, high))


def is_valid(material: dict[str, Any]) -> bool:
    """Return whether the law takes these values together."""
    try:
        LAWS.by_name[material["law"]].model_validate(material)
    except ValidationError:
        return False
    return True


def materials(law: str) -> st.SearchStrategy[dict[str, Any]]:
    """Materials of a law with any values."""
    fields = LAWS.by_name[law].model_fields.items()
    values = {name: within(field) for name, field in fields if name not in ("law", "tint")}
    values["tint"] = st.sampled_from([None, "none", (0.2, 0.5, 1.0)])
    return st.fixed_dictionaries({"law": st.just(law), **values}).filter(is_valid)


MATERIAL = st.one_of([materials(law) for law in LAWS.by_name])
TIMEOUT = r"^frame \d+ was reached in .*time\.budget: .*particle \d+ of law .* Use "
PROFILE = st.sampled_from(
    [
        {"kind": "constant"},
        {"kind": "sine", "frequency": 30.0},
        {"kind": "ramp", "duration": 0.01, "first": -1.0, "last": 1.0},
    ]
)


def force(kind: str, **options: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """A force of a kind with its own parameters and any profile."""
    return st.fixed_dictionaries({"kind": st.just(kind), "profile": PROFILE, **options})


STRENGTH = decades(1e-3, 1e5)
FORCE = st.one_of(
    force("gravity", g=vectors(decades(1e-2, 1e3))),
    force("acceleration", a=vectors(STRENGTH)),
    force("particle_force", f=vectors(decades(1e-9, 1e3))),
    force("force", f=vectors(STRENGTH)),
    st.fixed_dictionaries({"kind": st.just("impulse"), "p": vectors(decades(1e-3, 1e3))}),
    force("set_velocity", v=vectors(decades(1e-3, 30)), spin=vectors(decades(1e-3, 30))),
    force("wind", v=vectors(decades(1e-3, 100)), rate=decades(1e-3, 1e6)),
    force("attraction", g=decades(1e-2, 1e4), radius=decades(1e-3, 1e3)),
    force("zone", a=vectors(STRENGTH)),
)
CONTACT = {"contact": st.sampled_from(["sticky", "slip", "separate"]), "friction": st.floats(0, 10)}
MOTION = st.one_of(
    st.none(),
    st.fixed_dictionaries(
        {
            "kind": st.just("swing"),
            "amplitude": vectors(decades(1e-3, 10)),
            "frequency": decades(0.1, 1e3),
        }
    ),
)


def wall(kind: str, **options: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """A boundary of a kind with any contact and its own parameters."""
    return st.fixed_dictionaries({"kind": st.just(kind), **CONTACT, **options}).map(
        lambda fields: {key: value for key, value in fields.items() if value is not None}
    )


SIZES = decades(1e-2, 10)
BOUNDARY = st.one_of(
    wall("ground"),
    wall("press", depth=st.floats(0.01, 0.9), down=decades(1e-3, 1)),
    st.fixed_dictionaries({"kind": st.just("foot"), "fraction": st.floats(0.01, 1)}),
    wall("half_space", normal=st.sampled_from([(0, 0, 1), (1, 0, 2), (0, 1, 0)]), motion=MOTION),
    wall("sphere", centre=vectors(SIZES), radius=SIZES, motion=MOTION),
    wall("box", upper=st.builds(lambda s: (s, s, s), SIZES), motion=MOTION),
    st.just({"kind": "container"}),
)


class Cloud(NamedTuple):
    """From one Gaussian to a ball, a sheet, a cloud of needles, all in one point."""

    seed: int
    number: int
    rank: int
    shape: tuple[float, float, float]

    def gaussians(self) -> Gaussians:
        """The Gaussians it stands for."""
        rng, n = np.random.default_rng(self.seed), self.number
        means = rng.normal(size=(n, 3)) * (np.arange(3) < self.rank)
        scales = np.tile(self.shape, (n, 1)) * 10 ** rng.uniform(-1.5, -0.5, (n, 1))
        quats = rng.normal(size=(n, 4))
        if n > 40:
            # A few that a user's file may well hold.
            means[:2], scales[2], quats[3] = [[np.nan, 0, 0], [1e4, 0, 0]], 0, 0
        colours = rng.random((n, 3))
        return Gaussians.from_rgb(means, quats, scales, rng.uniform(0.05, 1, n), colours)


CLOUDS = st.builds(
    Cloud,
    st.integers(0, 10_000),
    st.sampled_from([1, 2, 5, 40, 150]),
    st.integers(0, 3),
    st.sampled_from([(1, 1, 1), (1, 1, 0.01), (1, 1e-4, 1e-4), (1, 0.5, 1e-9)]),
)


PLAIN = st.just(("lattice", None))
"""The default binding and number of particles, with which elastic scenes run on lattices."""
LOOSE = st.tuples(st.sampled_from(["particles", "lattice"]), st.floats(1, 2))
"""How Gaussians are bound, and particles per cell and axis, so that no lattice is possible."""


@st.composite
def scenes(
    draw: st.DrawFn,
    precision: st.SearchStrategy[str],
    particles: st.SearchStrategy[tuple[str, float | None]],
) -> Scene:
    """A whole scene whose time is so short that it takes few substeps."""
    cells, cfl = draw(st.integers(4, 9)), draw(st.floats(0.1, 0.9))
    binding, number = draw(particles)
    data = {
        "material": draw(MATERIAL),
        "forces": draw(st.lists(FORCE, max_size=2)),
        "boundaries": draw(st.lists(BOUNDARY, max_size=2)),
        "binding": binding,
        "accuracy": {
            "cells": cells,
            "particles_per_axis": number,
            "cfl": cfl,
            "precision": draw(precision),
        },
    }
    probe = Scene.from_data(data)
    speed = probe.material.wave_speed()
    count, size = draw(st.integers(2, 30)), draw(decades(1e-3, 1e3))
    # As many substeps as drawn: by the rate of frames, and by the size where that is not enough.
    time = min(count * cfl * size / cells / speed, 1.0)
    if time < 1e-3:
        size, time = min(size * 1e-3 / time, 1e4), 1e-3
    mach = draw(st.one_of(st.just(0.0), decades(1e-3, 5)))
    direction = draw(vectors(st.just(1.0)))
    data["object"] = {
        "size": size,
        "lift": draw(st.sampled_from([0.0, 0.1])) * size,
        "velocity": tuple(np.clip(mach * speed * np.array(direction), -1e5, 1e5).tolist()),
        "spin": draw(vectors(decades(1e-3, 1e2))),
    }
    data["time"] = {"frames": 3, "fps": max(1.0, 1 / time), "budget": 0.4}
    return Scene.from_data(data)


def check(cloud: Cloud, scene: Scene) -> None:
    """Everything that must hold for any scene, whether one thread steps it or two."""
    try:
        run = Simulation(
            prepare(cloud.gaussians(), scene, RunContext(threads=2 if cloud.seed % 4 == 0 else 1))
        )
        clip = run.run()
    except InputError as refusal:
        assert len(str(refusal)) > 40
        event("refused")
        OUTCOMES["refused"] += 1
        return
    report = clip.report
    outcome = "complete"
    if not report["complete"]:
        # No scene may break; one may outlast its time budget, and its frames so far are good.
        assert re.search(TIMEOUT, report["stopped"]), report["stopped"]
        outcome = "out of time"
    OUTCOMES[outcome] += 1
    event(f"{scene.material.law}: {outcome}")
    for name in ("means", "quats", "scales", "opacities", "times"):
        assert np.isfinite(getattr(clip, name)).all(), name
    assert np.abs(np.linalg.norm(clip.quats, axis=2) - 1).max() < 1e-5
    assert (clip.scales >= 0).all()
    for name, array in run.solver.state.arrays().items():
        assert np.isfinite(array.numpy()).all(), name
    balance = report["balance"]
    assert balance["energy_gain"] <= ENERGY_GAIN
    assert balance["momentum_gain"] <= (PROJECTED if scene.projects else 1e-3)
    assert math.isclose(report["mass"], float(np.sum(run.solver.model.mass.numpy())), rel_tol=1e-4)


COMMON = {
    "deadline": None,
    "suppress_health_check": list(HealthCheck),
    "database": None,
    "phases": [Phase.generate],
}
OUTCOMES: Counter[str] = Counter()
"""Number of scenes with each outcome."""


def most_are_complete() -> None:
    """Refused or out of time proves nothing, so most must run to their end."""
    assert OUTCOMES["complete"] > sum(OUTCOMES.values()) / 2, OUTCOMES


@settings(max_examples=2, derandomize=True, **COMMON)
@given(cloud=CLOUDS, scene=scenes(st.just("float32"), PLAIN))
def run_defaults(cloud: Cloud, scene: Scene) -> None:
    check(cloud, scene)


@settings(max_examples=2, derandomize=True, **COMMON)
@given(cloud=CLOUDS, scene=scenes(st.just("float32"), LOOSE))
def run_particles(cloud: Cloud, scene: Scene) -> None:
    check(cloud, scene)


@settings(max_examples=2000, **COMMON)
@given(cloud=CLOUDS, scene=scenes(st.sampled_from(["float32", "float64"]), st.one_of(PLAIN, LOOSE)))
def run_two_thousand(cloud: Cloud, scene: Scene) -> None:
    check(cloud, scene)


def test_random_scenes():
    OUTCOMES.clear()
    run_defaults()
    run_particles()
    most_are_complete()


@pytest.mark.slow
def test_two_thousand_random_scenes():
    OUTCOMES.clear()
    run_two_thousand()
    most_are_complete()
