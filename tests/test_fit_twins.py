"""Fits of twins: truth from a finer grid, other Gaussians, other particles, errors of a pixel."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.fit import Fit, fit
from phy124.io.ply import write_ply
from phy124.pipeline import static
from phy124.scene import Scene
from support.twins import twin, write_forces, write_points

DUCK, SUNFLOWER = "demo/examples/duck.png", "demo/examples/sunflower.png"


def declared(tmp_path, picture, scene, cells, **more):
    """The points of a twin, and a fit of them with another number of Gaussians."""
    # As long as the presets once were; the fit follows the points.
    brief = {"time.frames": 14, "time.fps": 24.0 if scene == "press" else 20.0}
    found = Scene.named(scene).replaced(brief)
    clip = twin(static(picture, Scene(), count=3000).gaussians, found, cells)
    write_points(tmp_path / "points.csv", clip, seed=1)
    write_forces(tmp_path / "forces.csv", clip, seed=1)
    write_ply(tmp_path / "object.ply", static(picture, Scene(), count=2000).gaussians)
    data = {
        "target": str(tmp_path / "points.csv"), "object": str(tmp_path / "object.ply"),
        "scene": scene, "set": {"accuracy.cells": cells}, "seconds": 1e5, **more,
    }  # fmt: skip
    return Fit.from_data(data), found.material


@pytest.mark.slow
@pytest.mark.parametrize(
    ("picture", "scene", "cells", "find"),
    [
        (DUCK, "press", 32, "1e4..2e5"),
        (SUNFLOWER, "sway", 40, "3e4..1e6"),
    ],
)
def test_stiffness_within_a_tenth(tmp_path, picture, scene, cells, find):
    asked, material = declared(tmp_path, picture, scene, cells, find={"material.E": find})
    found = fit(asked, tmp_path / "out", workers=2)
    told = found.report["found"]["material.E"]
    low, high = told["interval"]
    assert told["value"] == pytest.approx(material.E, rel=0.1)
    assert low < material.E < high
    assert told["value"] == found.scene.material.E
    again = fit(asked, tmp_path / "out")
    assert again.report["runs"] == [0, 0], "all runs were kept"
    assert again.report["found"] == found.report["found"]


@pytest.mark.slow
def test_density_needs_a_force(tmp_path):
    both = {"material.E": "1e4..2e5", "material.density": "300..3000"}
    asked, material = declared(tmp_path, DUCK, "press", 32, find=both, grids=[16])
    with pytest.raises(InputError, match=r"in the same way.*--forces"):
        fit(asked, tmp_path / "out", workers=2)
    forces = asked.model_copy(update={"forces": str(tmp_path / "forces.csv")})
    found = fit(forces, tmp_path / "out", workers=2).report["found"]
    assert found["material.E"]["value"] == pytest.approx(material.E, rel=0.1)
    assert np.isclose(found["material.density"]["value"], material.density, rtol=0.1)
