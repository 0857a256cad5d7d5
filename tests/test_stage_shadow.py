"""The shadow on the floor against the projection of single Gaussians, written out plainly."""

import numpy as np
import pytest

from phy124.gaussians import Frame, Gaussians, rotation_matrices
from phy124.io.clip import Clip
from phy124.kernels.splat.shadow import cover
from phy124.rendering.stage import shadow
from phy124.rendering.stage.build import make_stage
from phy124.rendering.stage.shadow import CELLS, LAMP, SKY, SLOPE, SOFTNESS, Caster
from phy124.scene import View


def gaussian(mean, scales, opacity=0.7, quat=(1.0, 0, 0, 0)) -> Gaussians:
    return Gaussians.from_rgb(
        np.array([mean]), np.array([quat]), np.array([scales]), np.array([opacity]), np.ones((1, 3))
    )


def projected(gaussians: Gaussians, caster: Caster, floor: float) -> np.ndarray:
    """Coverage of the floor by one Gaussian, cast along the lamp's rays, blurred by the lamp."""
    turn = rotation_matrices(gaussians.quats)[0] * gaussians.scales[0].astype(float)
    cast = np.array([[1, 0, SLOPE[0]], [0, 1, SLOPE[1]]])
    sharp = cast @ turn @ turn.T @ cast.T
    height = float(gaussians.means[0, 2]) - floor
    blurred = sharp + (SOFTNESS * height) ** 2 * np.eye(2)
    peak = gaussians.opacities[0] * np.sqrt(np.linalg.det(sharp) / np.linalg.det(blurred))
    x, y = caster.cell_centres
    at = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    away = at - (gaussians.means[0, :2] + height * np.array(SLOPE))
    power = np.einsum("ija,ab,ijb->ij", away, np.linalg.inv(blurred), away)
    return peak * np.exp(-power / 2)


SHAPES = {
    "round, at a layer": gaussian((0.1, -0.1, 0.5), (0.08, 0.08, 0.08)),
    "round, between two layers": gaussian((0.0, 0.1, 0.75), (0.1, 0.1, 0.1)),
    "long and turned": gaussian((0.1, 0.05, 0.48), (0.25, 0.05, 0.1), 0.9, (0.9, 0.2, 0.1, 0.37)),
    "flat on the floor": gaussian((0.0, 0.0, 0.2), (0.2, 0.15, 0.01), 0.99),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_lamps_shadow_of_one_gaussian_is_its_projection(name, monkeypatch):
    monkeypatch.setattr(shadow, "LAMP", 1.0)
    monkeypatch.setattr(shadow, "SKY", 0.0)
    monkeypatch.setattr(shadow, "FAINT", 1e-9)
    caster = Caster((0.05, 0.0), 1.5, 1.2)
    seen = caster.shade(SHAPES[name], 0.2)
    wanted = projected(SHAPES[name], caster, 0.2)
    assert wanted.max() > 0.2
    # Cells blur by 2 %; between two layers the lamp's blur is a mean of theirs.
    within = 0.03 if name in ("round, at a layer", "flat on the floor") else 0.1
    assert np.abs(seen - wanted).max() < within * wanted.max()


def test_the_sky_that_a_thin_disc_hides_is_its_form_factor(monkeypatch):
    """Under a disc of radius R at height h: R^2 / (R^2 + h^2) of the light (Nusselt)."""
    monkeypatch.setattr(shadow, "LAMP", 0.0)
    monkeypatch.setattr(shadow, "SKY", 1.0)
    caster = Caster((0.0, 0.0), 2.5, 1.0)
    side = np.linspace(-0.4, 0.4, 81)
    x, y = (v.ravel() for v in np.meshgrid(side, side))
    disc = np.hypot(x, y) <= 0.4
    height = caster.heights[3]
    means = np.stack([x, y, np.full_like(x, height)], axis=1)[disc]
    n = len(means)
    leaf = Gaussians.from_rgb(
        means,
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.tile([0.01, 0.01, 0.001], (n, 1)),
        np.full(n, 0.99),
        np.ones((n, 3)),
    )
    middle = caster.shade(leaf, 0.0)[CELLS // 2, CELLS // 2]
    assert middle == pytest.approx(0.4**2 / (0.4**2 + height**2), rel=0.05)


def test_small_gaussians_cast_the_shadow_of_their_disc(rng):
    """Points between cells, and one of several standing for the others, make no difference."""
    n = 3 * shadow.SAMPLE
    angle, radius = rng.uniform(0, 2 * np.pi, n), 0.4 * np.sqrt(rng.uniform(0, 1, n))
    means = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, 0.25)], axis=1)
    quats, scales = np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.006)
    dense = Gaussians.from_rgb(means, quats, scales, np.full(n, 0.9), np.ones((n, 3)))
    caster = Caster((0.0, 0.0), 1.5, 0.25)
    shade = caster.shade(dense, 0.0)
    x, y = caster.cell_centres
    away = np.hypot(x[:, None] - 0.25 * SLOPE[0], y[None] - 0.25 * SLOPE[1])
    assert shade[away < 0.1].min() > 0.8 * LAMP
    assert shade[away > 0.8].max() < 0.05
    assert shade.max() <= LAMP + SKY


def test_one_that_stands_for_others_is_as_much_wider(rng, monkeypatch):
    """Lying on the floor, where nothing blurs it, a thinned disc has no gaps."""
    n = 24_000
    angle, radius = rng.uniform(0, 2 * np.pi, n), 0.4 * np.sqrt(rng.uniform(0, 1, n))
    means = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)], axis=1)
    quats, scales = np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.006)
    disc = Gaussians.from_rgb(means, quats, scales, np.full(n, 0.9), np.ones((n, 3)))
    caster = Caster((0.0, 0.0), 1.0, 0.25)
    whole = caster.shade(disc, 0.0)
    monkeypatch.setattr(shadow, "SAMPLE", n // 6)
    x, y = caster.cell_centres
    inside = np.hypot(x[:, None], y[None]) < 0.35
    assert caster.shade(disc, 0.0)[inside].min() > 0.95 * whole[inside].min()


def test_the_shade_ends_before_the_map_does(rng, monkeypatch):
    """Water that stands up along four walls in the last frame only, a heap before."""
    monkeypatch.setattr(shadow, "EDGE", 1e-9)  # nothing fades because of the border
    n, quiet = 2000, 12
    along, height = rng.uniform(-0.9, 0.9, n), rng.uniform(0, 1, n)
    side = np.where(rng.integers(0, 2, n), 0.9, -0.9)
    across = rng.integers(0, 2, n)
    walls = np.stack([np.where(across, along, side), np.where(across, side, along), height], axis=1)
    places = [*[walls * [0.3, 0.3, 0.2]] * quiet, walls]
    quats, scales = np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.04)
    frames = [
        Frame(i, i / 24, Gaussians.from_rgb(at, quats, scales, np.full(n, 0.9), np.ones((n, 3))))
        for i, at in enumerate(places)
    ]
    stage = make_stage(Clip.from_frames(frames), View(stage="studio"))
    shade = stage.at(frames[-1]).floor.shade
    border = np.concatenate([shade[[0, -1]].ravel(), shade[:, [0, -1]].ravel()])
    # The rest fades over a tenth of the map, a quarter of a level of a picture per cell.
    assert shade.max() > 0.4 and border.max() < 3 / 255


def test_both_forms_of_the_kernel_cover_the_same_cells(rng, monkeypatch):
    """Sixteen at a time and one by one: points, discs, needles, at the border and unusable ones."""
    n = 203
    means, scales = rng.uniform(-1.6, 1.6, (n, 3)), np.exp(rng.uniform(-9, -1, (n, 3)))
    means[5], scales[7], scales[20] = np.nan, np.inf, 1e30
    opacities = rng.uniform(0, 1, n)
    opacities[9] = np.nan
    quats = rng.normal(size=(n, 4))
    means[11:13], scales[11:13], opacities[11:13] = (0, 0, 0.5), 0.1, 0.7
    quats[11, 1], quats[12, 0] = np.nan, np.inf
    cloud = Gaussians.from_rgb(means, quats, scales, opacities, np.ones((n, 3)))
    caster = Caster((0.0, 0.0), 1.5, 1.0)
    fast = caster._depth(cloud, 0.0)
    monkeypatch.setattr(shadow, "covering", lambda device: (cover, 1))
    slow = caster._depth(cloud, 0.0)
    assert (slow > 0.01).sum() > 1000
    np.testing.assert_allclose(fast, slow, atol=2e-5)


@pytest.mark.parametrize(
    "broken",
    [
        gaussian((np.nan, 0, 0), (0.1, 0.1, 0.1)),
        gaussian((0, 0, 1), (np.inf, 0.1, 0.1)),
        gaussian((0, 0, 1), (1e30, 0.1, 0.1)),
        gaussian((1e20, 0, 1), (0.1, 0.1, 0.1)),
        gaussian((0, 0, 1), (0.1, 0.1, 0.1), np.nan),
        gaussian((0, 0, 1), (0.0, 0.0, 0.0)),
        gaussian((0, 0, 1), (1e4, 1e4, 1e4)),
        gaussian((0, 0, 1), (0.1, 0.1, 0.1), 1.0, (0.0, 0, 0, 0)),
    ],
)
def test_no_gaussian_breaks_the_map(broken):
    shade = Caster((0.0, 0.0), 1.5, 1.0).shade(broken, 0.0)
    assert np.isfinite(shade).all() and shade.min() >= 0 and shade.max() <= LAMP + SKY
