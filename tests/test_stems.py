"""The material in thin round parts of objects."""

import math
from dataclasses import replace

import numpy as np
import pytest

from phy124.gaussians import quaternions, rotation_matrices
from phy124.generators.shapes import make_shape
from phy124.particles.solid import find_interior
from support.lattices import integration_points
from support.solids import frame


@pytest.mark.parametrize("turn", [(0, 0), (20, 25)])
@pytest.mark.parametrize("narrow", [0.02, 0.03])
@pytest.mark.parametrize("aspect", [1, 1.5, 2, 2.5, 3])
def test_elliptic_stems_keep_area_and_moments(aspect, narrow, turn):
    """The cross-sections are up to six voxels wide."""
    wide, axes = np.array([aspect * narrow, narrow]), frame(turn)
    made = make_shape("capsule", (1, *wide), (0.5, 0.5, 0.5))
    quats = quaternions(axes @ rotation_matrices(made.quats))
    solid = find_interior(replace(made, means=made.means @ axes.T, quats=quats))
    x, volume = integration_points(solid.resample(1 / 128), 1 / 128)
    place = x @ axes
    inner = np.abs(place[:, 0]) < 0.3
    volume, across = volume[inner], place[inner, 1:]
    area = volume.sum() / 0.6
    second = volume @ (across - volume @ across / volume.sum()) ** 2 / 0.6
    exact = math.pi / 4 * wide.prod()
    assert area == pytest.approx(exact, rel=0.1)
    assert second == pytest.approx(exact * wide**2 / 16, rel=0.25)
