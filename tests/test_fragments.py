import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from phy124 import Scene, Simulation, prepare
from phy124.rendering.fragments import BROKEN, Fragments
from phy124.rendering.shine import add_gloss, make_shine
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

TURN = Rotation.from_rotvec([0.3, -0.5, 0.4]).as_matrix()


@pytest.fixture(scope="module")
def snow():
    x = np.random.default_rng(1).uniform(-0.5, 0.5, (8000, 3)).astype(np.float32)
    return x, Fragments(np.arange(len(x)), x)


def distances(x, pairs):
    return np.linalg.norm(x[pairs[0]] - x[pairs[1]], axis=1)


@pytest.fixture(scope="module")
def pairs(snow):
    """Pairs of neighbours in one fragment, and pairs on both sides of a gap."""
    x, fragments = snow
    pairs = KDTree(x).query_pairs(0.03, output_type="ndarray").T
    together = fragments._fragment[pairs[0]] == fragments._fragment[pairs[1]]
    return pairs[:, together], pairs[:, ~together]


def test_whole_and_packed_material_does_not_change(snow):
    x, fragments = snow
    turned = x @ TURN.T + [3, 0, 1]
    for moved in (x, turned, 0.8 * turned, turned * [1, 1, 0.6]):
        moved = np.float32(moved)
        np.testing.assert_array_equal(fragments.shape(moved), moved)


def test_stretched_material_breaks_into_fragments_that_keep_their_shape(snow, pairs):
    x, fragments = snow
    within, across = pairs
    F = TURN @ np.diag([1.6, 1.6, 1.6])
    drawn = fragments.shape(np.float32(x @ F.T))
    np.testing.assert_allclose(distances(drawn, within), distances(x, within), atol=2e-3)
    assert np.median(distances(drawn, across) / distances(x, across)) > 1.6
    np.testing.assert_allclose(drawn.mean(axis=0), (x @ F.T).mean(axis=0), atol=1e-3)


def test_gaps_open_gradually(snow):
    x, fragments = snow
    shifts = []
    for stretch in np.linspace(1, BROKEN + 0.1, 30):
        moved = np.float32(x * [stretch, 1, 1])
        shifts.append(np.linalg.norm(fragments.shape(moved) - moved, axis=1).max())
    assert shifts[0] == 0 and shifts[-1] > 0.01
    assert np.diff(shifts).max() < 0.2 * shifts[-1]


def test_fragments_of_few_or_coplanar_gaussians_stay_finite():
    rng = np.random.default_rng(0)
    for x in (np.zeros((1, 3)), np.zeros((5, 3)), rng.uniform(size=(50, 3)) * [1, 1, 0]):
        x = x.astype(np.float32)
        drawn = Fragments(np.arange(len(x)), x).shape(3 * x)
        assert drawn.shape == x.shape and np.isfinite(drawn).all()


def test_clips_of_snow_are_drawn_as_fragments_and_others_are_not():
    changes = {"accuracy": {"cells": 8}, "time.frames": 3}
    scene = Scene.named("snow").replaced(changes)
    clip = Simulation(prepare(ball(300), scene)).run()
    (runs,) = clip.report["fragments"]
    assert runs[0][0] == 0 and runs[-1][1] == len(clip.opacities)
    clip.means[2][:, 2] *= 2
    shine = make_shine(clip, scene.view)
    assert shine is not None
    drawn = shine.shape(clip.frame(2)).gaussians.means
    assert np.abs(drawn - clip.means[2]).max() > 0.01
    packed, _ = add_gloss(clip, scene.view)
    np.testing.assert_allclose(packed.means[2], drawn, atol=1e-6)
    hollow = Simulation(prepare(ball(300), scene.replaced({"grains": False}))).run()
    sand = Simulation(prepare(ball(300), Scene.named("sand").replaced(changes))).run()
    assert hollow.report["fragments"] == sand.report["fragments"] == []
