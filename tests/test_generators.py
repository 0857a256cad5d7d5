"""The table of generators, and the generator that reads a PLY."""

import sys

import numpy as np
import pytest

from phy124 import generators
from phy124.errors import InputError
from phy124.gaussians import Gaussians, join
from phy124.generators import neural
from phy124.generators.ply_file import PlyFile, Reading, normalise_size, robust_bounds
from phy124.io.ply import write_ply
from phy124.weights.store import KNOWN


def box(rng, count=2000, opacity=0.9):
    """Gaussians filling a box of 4 x 2 x 1 m about (10, 0, 3)."""
    means = rng.uniform(-0.5, 0.5, (count, 3)) * [4, 2, 1] + [10, 0, 3]
    quats, scales = np.tile([1, 0, 0, 0], (count, 1)), np.full((count, 3), 0.04)
    return Gaussians(means, quats, scales, np.full(count, opacity), np.zeros((count, 1, 3)))


def test_neural_generator_is_one_package(tmp_path, monkeypatch):
    (tmp_path / "cube").mkdir()
    code = 'GENERATORS = {"cube": lambda: "made"}\nWEIGHTS = ("u2net",)\n'
    (tmp_path / "cube/__init__.py").write_text(code)
    monkeypatch.setattr(neural, "__path__", [*neural.__path__, str(tmp_path)])
    *_, last = generators.find_neural_packages()
    monkeypatch.delitem(sys.modules, last.__name__)
    names = {name for package in generators.find_neural_packages() for name in package.GENERATORS}
    assert names == {"lgm", "lgm-aligned", "dreamgaussian", "triposr", "cube"}


def test_weights_of_generators_are_known():
    assert set(generators.WEIGHTS) == {"lgm", "lgm-aligned", "dreamgaussian", "triposr"}
    assert {name for names in generators.WEIGHTS.values() for name in names} <= set(KNOWN)


def test_missing_packages_are_named(monkeypatch):
    def needs_more():
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setitem(generators.GENERATORS, "lgm", needs_more)
    with pytest.raises(InputError, match=r"package torch.*pip install .*\[lgm\]"):
        generators.make("lgm")


def test_objects_pass_through_and_unknown_names_are_refused():
    assert generators.make(box) is box
    assert generators.needs_image("relief")
    assert generators.needs_image(box)
    assert not generators.needs_image("x.PLY")
    with pytest.raises(InputError, match=r"no such generator.*relief.*such as .ply"):
        generators.make("magic")


def test_ply_is_brought_to_the_default_place(tmp_path, rng):
    gaussians = box(rng)
    write_ply(tmp_path / "a.ply", gaussians)
    steps = []
    make = generators.make(str(tmp_path / "a.ply"))
    placed = make(None, seed=0, progress=lambda *step: steps.append(step))
    extent = placed.means.max(axis=0) - placed.means.min(axis=0)
    np.testing.assert_allclose(extent, [1, 0.5, 0.25], atol=0.003)
    np.testing.assert_allclose(placed.means.max(axis=0), extent / 2, atol=1e-6)
    np.testing.assert_allclose(placed.scales, 0.01, rtol=2e-3)
    assert steps == [("read", 0, 1), ("read", 1, 1)]


def test_outliers_and_faint_gaussians_do_not_count(tmp_path, rng):
    far = Gaussians([[90, 9, 9]], [[1, 0, 0, 0]], [[1, 1, 1]], [0.5], np.zeros((1, 1, 3)))
    faint = box(rng, 100, opacity=0.004)
    gaussians = join([box(rng), far, faint])
    clean = robust_bounds(box(np.random.default_rng(0)))
    np.testing.assert_allclose(robust_bounds(gaussians), clean, atol=0.02)
    write_ply(tmp_path / "a.ply", gaussians)
    assert len(PlyFile(str(tmp_path / "a.ply"))()) == 2001


def test_axes_can_be_set(tmp_path, rng):
    write_ply(tmp_path / "a.ply", box(rng))
    standing = PlyFile(str(tmp_path / "a.ply"), Reading(up="x", front="z"))()
    extent = standing.means.max(axis=0) - standing.means.min(axis=0)
    # In the file x is our y (2 m), y our -z (1 m), z our -x (4 m).
    np.testing.assert_allclose(extent, [1, 0.25, 0.5], atol=0.003)


def test_ply_without_an_object_is_refused(tmp_path, rng):
    write_ply(tmp_path / "faint.ply", box(rng, opacity=0.001))
    with pytest.raises(InputError, match=r"below 0.005.*visible object"):
        PlyFile(str(tmp_path / "faint.ply"))()
    with pytest.raises(InputError, match="at a single point"):
        normalise_size(box(rng, 1))
