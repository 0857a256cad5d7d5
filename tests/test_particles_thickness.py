"""Local thickness: what fits inside, on objects whose thickness is known."""

import numpy as np
import pytest

from phy124.particles.solid import Solid, find_interior
from phy124.particles.thickness import compliance, local_thickness, measure_proportions
from phy124.scene import Scene
from phy124.simulation import prepare
from phy124.simulation.bodies import proportions_of
from support.shapes import ball


def box(*sides: int) -> Solid:
    return Solid(np.zeros(3, np.int64), 0.1, np.ones(sides, np.float32))


@pytest.mark.parametrize("voxels", [1, 3, 5, 9])
def test_thickness_of_a_slab_is_its_width(voxels):
    assert local_thickness(box(40, 40, voxels)) == pytest.approx(0.1 * voxels)


def test_thickness_of_a_ball_is_its_diameter():
    centres = np.indices((41, 41, 41)) - 20
    inside = (centres**2).sum(axis=0) <= 18.5**2
    shape = Solid(np.zeros(3, np.int64), 0.1, inside.astype(np.float32))
    assert local_thickness(shape) == pytest.approx(3.7, abs=0.15)


@pytest.mark.parametrize(("length", "thickness"), [(2, 0.9), (60, 0.3)])
def test_a_thin_tenth_of_the_volume_decides(length, thickness):
    """A slab nine voxels thick with a flange of three: less, or more than a tenth of it all."""
    fraction = np.zeros((40, 40 + length, 9), np.float32)
    fraction[:, :40] = 1
    fraction[:, 40:, 3:6] = 1
    shape = Solid(np.zeros(3, np.int64), 0.1, fraction)
    assert local_thickness(shape) == pytest.approx(thickness)


def test_a_sheet_below_a_voxel_counts_as_one():
    sheet = box(20, 20, 1)
    assert local_thickness(Solid(sheet.first, sheet.voxel, 0.2 * sheet.fraction)) == 0.1


def test_proportions_do_not_depend_on_the_size():
    some = ball(2000)
    near, far = (
        measure_proportions(
            (find_interior(some.transform(size, np.zeros(3))), size * np.ptp(some.means[:, 2]))
        )
        for size in (1.0, 1e-3)
    )
    assert near == pytest.approx(far, abs=0.02) and 0.7 < near.thickness < 1.1


def test_compliance_is_that_of_a_cantilever():
    """Mean deflection of a beam under its weight sideways, w(z) of Euler and Bernoulli."""
    width, height = 6, 80
    free = height * (1 - 0.12) * 0.1
    z = np.linspace(0, 1, 201)
    shape = z**2 * (6 - 4 * z + z**2) / 24
    inertia = (0.1 * width) ** 2 / 12
    load = 1 / (0.1 * height)
    deflection = load * free**4 / inertia * np.sqrt((shape**2).mean() * 0.88)
    assert compliance(box(width, width, height)) == pytest.approx(deflection, rel=0.05)
    assert compliance(box(width, 2 * width, height)) == pytest.approx(deflection, rel=0.05)


@pytest.mark.usefixtures("coarse_solids")
def test_hardest_of_several_objects_counts():
    """A thin plate next to a ball decides, relative to the first object's size."""
    plate = {"name": "plate", "shape": "box", "size": 0.5, "sides": [1, 1, 0.1], "place": [2, 0]}
    scene = Scene.named("drop").replaced({"accuracy": {"cells": 8}, "objects": [plate]})
    hardest = proportions_of(ball(200), scene)
    assert hardest.thickness == pytest.approx(0.05, rel=0.3)
    assert prepare(ball(200), scene).proportions == hardest
