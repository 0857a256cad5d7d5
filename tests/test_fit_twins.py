"""Fits of twins: truth from a finer grid, other Gaussians, other particles, errors of a pixel."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.generators.shapes import make_shape
from phy124.io.ply import write_ply
from phy124.pipeline import make_gaussians
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.fit import Fit, fit
from support.twins import twin, write_forces, write_points

DUCK, SUNFLOWER = "demo/examples/duck.png", "demo/examples/sunflower.png"


def declared(tmp_path, picture, scene, cells, **more):
    """The points of a twin, and a fit of them with another number of Gaussians."""
    # As long as the presets once were; the fit follows the points.
    brief = {"time.frames": 14, "time.fps": 24.0 if scene == "press" else 20.0}
    result = Scene.named(scene).replaced(brief)
    clip = twin(make_gaussians(picture, Scene(), count=3000).gaussians, result, cells)
    write_points(tmp_path / "points.csv", clip, seed=1)
    write_forces(tmp_path / "forces.csv", clip, seed=1)
    write_ply(tmp_path / "object.ply", make_gaussians(picture, Scene(), count=2000).gaussians)
    data = {
        "target": str(tmp_path / "points.csv"),
        "object": str(tmp_path / "object.ply"),
        "scene": scene,
        "set": {"accuracy.cells": cells},
        "seconds": 1e5,
        **more,
    }
    return Fit.from_data(data), result.material


@pytest.mark.slow
@pytest.mark.parametrize(
    ("picture", "scene", "cells", "find"),
    [(DUCK, "press", 32, "1e4..2e5"), (SUNFLOWER, "sway", 40, "3e4..1e6")],
)
def test_stiffness_within_a_tenth(tmp_path, picture, scene, cells, find):
    asked, material = declared(tmp_path, picture, scene, cells, find={"material.E": find})
    result = fit(asked, tmp_path / "out", workers=2)
    entry = result.report["found"]["material.E"]
    low, high = entry["interval"]
    assert entry["value"] == pytest.approx(material.E, rel=0.1)
    assert low < material.E < high
    assert entry["value"] == result.scene.material.E
    again = fit(asked, tmp_path / "out")
    assert again.report["runs"] == [0, 0], "all runs were kept"
    assert again.report["found"] == result.report["found"]


@pytest.mark.slow
def test_density_needs_a_force(tmp_path):
    both = {"material.E": "1e4..2e5", "material.density": "300..3000"}
    asked, material = declared(tmp_path, DUCK, "press", 32, find=both, grids=[16])
    with pytest.raises(InputError, match=r"in the same way.*--forces"):
        fit(asked, tmp_path / "out", workers=2)
    forces = asked.model_copy(update={"forces": str(tmp_path / "forces.csv")})
    result = fit(forces, tmp_path / "out", workers=2).report["found"]
    assert result["material.E"]["value"] == pytest.approx(material.E, rel=0.1)
    assert np.isclose(result["material.density"]["value"], material.density, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seen", ["points", "clip"])
def test_a_pressed_duck_does_not_tell_its_poissons_ratio(tmp_path, seen):
    """The grid moves what is seen as much as nu does; E is found from the very same clip."""
    nu = {"material.nu": "0.1..0.45"}
    asked, _ = declared(tmp_path, DUCK, "press", 24, find=nu, grids=[12, 16])
    if seen == "clip":
        scene = Scene.named("press").replaced({"accuracy.cells": 24, "time.frames": 14})
        duck = make_gaussians(DUCK, Scene(), count=2000).gaussians
        Simulation(prepare(duck, scene, RunContext(threads=1))).run().save(
            tmp_path / "clip.safetensors"
        )
        clip = {"target": str(tmp_path / "clip.safetensors"), "object": None, "scene": None}
        asked = asked.model_copy(update=clip)
    with pytest.raises(InputError, match=r"nu: the error of the grid .* slippery plates"):
        fit(asked, tmp_path / "out", workers=2)
    asked = Fit.from_data({**asked.model_dump(), "find": {"material.E": "1e4..2e5"}})
    entry = fit(asked, tmp_path / "out", workers=2).report["found"]["material.E"]
    assert entry["value"] == pytest.approx(4e4, rel=0.1)
    assert entry["interval"][0] < 4e4 < entry["interval"][1]


SLIDING = {
    "object": {"velocity": [2.0, 0, 0]},
    "material": {"law": "neo_hookean", "E": 2e5, "damping": 100.0},
    "boundaries": [{"kind": "ground", "friction": 0.3}],
}
PLATE = {"kind": "press", "friction": 0.0, "depth": 0.2, "down": 0.3, "hold": 0.04, "up": 0.2}
SQUEEZED = {
    "forces": [],
    "material": {"law": "neo_hookean", "E": 4e4, "damping": 50.0, "nu": 0.3},
    "boundaries": [{"kind": "ground", "friction": 0.0}, PLATE],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "sides", "path", "least", "most"),
    [
        (SLIDING, (1, 0.6, 0.4), "boundaries.0.friction", 0.05, 0.8),
        (SQUEEZED, (1, 0.8, 0.9), "material.nu", 0.1, 0.45),
    ],
    ids=["friction of a sliding box", "Poisson's ratio of a block between slippery plates"],
)
def test_a_motion_that_tells_a_value_gives_it_on_draft_grids(
    tmp_path, data, sides, path, least, most
):
    """Truth 0.3 on 24 cells, fitted on 12 and 16."""
    scene = Scene.from_data({**data, "time": {"frames": 14, "fps": 24.0}})
    box = make_shape("box", sides, (0.5, 0.5, 0.5))
    write_points(tmp_path / "points.csv", twin(box, scene, 24), seed=1)
    write_ply(tmp_path / "object.ply", box)
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    asked = {
        "target": str(tmp_path / "points.csv"),
        "object": str(tmp_path / "object.ply"),
        "scene": str(tmp_path / "scene.toml"),
        "set": {"accuracy.cells": 24},
        "grids": [12, 16],
        "seconds": 1e5,
        "find": {path: f"{least}..{most}"},
    }
    entry = fit(Fit.from_data(asked), tmp_path / "out", workers=2).report["found"][path]
    low, high = entry["interval"]
    assert entry["value"] == pytest.approx(0.3, rel=0.05)
    assert low < 0.3 < high
    assert high - low < 0.1
