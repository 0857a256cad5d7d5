"""The material of voxels at the surface of an object."""

import numpy as np
import pytest

from phy124.gaussians import Gaussians, quaternions
from phy124.particles.solid import find_interior
from phy124.particles.surface import THINNEST
from support.lattices import DX, integration_points
from support.solids import STEM, box_of_discs, frame, stem_of_discs

SIDES = np.array([14.0, 4.0, 1.0]) * DX
APART = 0.2 * DX
MIDDLE = np.array([0.01, 0.02, 0.03])


def plate(thick, turn=(0, 0), **options):
    return box_of_discs(SIDES * [1, 1, thick], frame(turn), MIDDLE, APART, **options)


def join(*objects):
    names = ("means", "quats", "scales", "opacities", "sh")
    return Gaussians(*(np.concatenate([getattr(each, name) for each in objects]) for name in names))


@pytest.mark.parametrize("turn", [(0, 0), (20, 25), (35, 45)])
@pytest.mark.parametrize("thick", [0.3, 0.5, 1, 2])
def test_plates_keep_their_volume_and_moments(thick, turn):
    solid = find_interior(plate(thick, turn)).resample(DX / 2, per_cell=2)
    assert solid.volume == pytest.approx(SIDES.prod() * thick, rel=0.02)
    x, volume = integration_points(solid, DX)
    along, _, out = ((x - MIDDLE) @ frame(turn)).T
    inner = np.abs(along) < 5 * DX
    share = volume[inner] / volume[inner].sum()
    second = share @ (out[inner] - share @ out[inner]) ** 2
    assert second == pytest.approx((thick * DX) ** 2 / 12, rel=0.04)


def test_rim_of_a_plate_encloses_nothing():
    """Discs at the rim stick out, so they are a low wall around both faces."""
    sides = np.array([1.0, 0.7, 0.03])
    plates, rim = (
        box_of_discs(sides, np.eye(3), np.zeros(3), 0.012, faces=faces)
        for faces in (range(4, 6), range(4))
    )
    rim = Gaussians(rim.means, rim.quats, 3 * rim.scales, rim.opacities, rim.sh)
    solid = find_interior(join(plates, rim))
    assert solid.volume == pytest.approx(sides.prod(), rel=0.1)


@pytest.mark.parametrize("turn", [(0, 0), (20, 25)])
def test_sheet_is_as_thick_as_its_gaussians(turn):
    sheet = plate(1, turn, faces=range(4, 5))
    solid = find_interior(sheet)
    thick = THINNEST * solid.voxel
    assert solid.volume == pytest.approx(SIDES[0] * SIDES[1] * thick, rel=0.15)
    soft = Gaussians(sheet.means, sheet.quats, sheet.scales * [1, 1, 8], sheet.opacities, sheet.sh)
    thick = 2 * soft.scales.min()
    assert thick > THINNEST * solid.voxel
    assert find_interior(soft).volume == pytest.approx(SIDES[0] * SIDES[1] * thick, rel=0.15)


@pytest.mark.parametrize("turn", [(0, 0), (20, 25)])
def test_comb_with_concave_edges_keeps_its_volume(turn):
    corners = np.array([[0, 0, 0], *([x, 0, 0] for x in range(0, 14, 3))])
    sides, axes = np.array([[14, 4, 1]] + 5 * [[1, 4, 4]]), frame(turn)
    parts = [
        box_of_discs(side * DX, axes, (corner + side / 2) * DX @ axes.T, APART)
        for corner, side in zip(corners, sides, strict=True)
    ]
    exact = (14 * 4 + 5 * 4 * 3) * DX**3
    assert find_interior(join(*parts)).volume == pytest.approx(exact, rel=0.04)


def test_plate_follows_its_flat_gaussians_and_not_the_round_ones():
    """Round Gaussians below the faces do not make the plate thinner."""
    thin = plate(1)
    rng = np.random.default_rng(0)
    place = (rng.random((20000, 3)) - 0.5) * SIDES * 0.9
    place[:, 2] = np.sign(place[:, 2]) * (SIDES[2] / 2 - rng.random(len(place)) * 0.02)
    place += MIDDLE
    count = len(place)
    dust = Gaussians(
        place,
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full((count, 3), 1e-4),
        np.full(count, 0.9),
        np.zeros((count, 1, 3)),
    )
    assert find_interior(join(thin, dust)).volume == pytest.approx(SIDES.prod(), rel=0.02)


@pytest.mark.parametrize("radius", [0.4, 0.5, 0.7])
def test_captured_stem_has_no_hinges(radius):
    solid = find_interior(stem_of_discs(radius, (0, 0, 1)))
    x, volume = integration_points(solid.resample(1 / 64), 1 / 64)
    x, volume = 64 * x - STEM, 64**3 * volume
    layer = np.floor(x[:, 2]).astype(int)
    inner = (layer >= 2) & (layer < 60)
    layer, arms, volume = layer[inner] - 2, x[inner, :2], volume[inner]
    assert np.bincount(layer, volume) == pytest.approx(np.full(58, np.pi * radius**2), rel=0.5)
    second = np.bincount(layer, volume * (arms**2).mean(axis=1))
    assert second == pytest.approx(np.full(58, np.pi * radius**4 / 4), rel=1)


def test_disc_at_the_rim_of_a_blade_cuts_no_notch():
    """The disc has no opposite face, so it is no thin sheet across the blade."""
    sides, middle = np.array([0.18, 3.6, 60]), np.array([0.66, 1, 30])
    blade = box_of_discs(sides / 64, np.eye(3), middle / 64, 0.3 / 64, faces=range(2))
    normal, up = np.array([-0.66, -0.75, 0]), np.array([0, 0, 1])
    quats = quaternions(np.stack([np.cross(up, normal), up, normal], axis=1)[None])
    place, scales = np.array([[0.66, -0.78, 30.4]]) / 64, np.array([[0.15, 0.15, 0.01]]) / 64
    disc = Gaussians(place, quats, scales, np.array([0.9]), np.zeros((1, 1, 3)))
    area = find_interior(join(blade, disc)).fraction.sum(axis=(0, 1))
    area = area[area > 0][3:-3]
    assert area.min() > 0.9 * area.max()
