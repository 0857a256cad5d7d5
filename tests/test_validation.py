"""Whole bodies against experiment and theory: sand column, dam break, cantilever, loose sand."""

import numpy as np
import pytest

from phy124.boundaries import Container, Ground, Held
from phy124.forces import Gravity
from phy124.materials import Fluid, Material, NeoHookean, Rigid, Sand
from phy124.mpm import Solver
from phy124.schema.region import Region
from phy124.studies.validation.bodies import lattice, make_solver
from reference.material_point import KINDS, evaluate

G = 9.81
MARTIN_MOYCE = {1.19: 1.44, 1.63: 1.89, 1.98: 2.33, 2.32: 2.78, 2.65: 3.22}
"""Front of a column twice as high as wide, x / a at the time t sqrt(2 g / a) (1952, table 2)."""


def channel(material: Material, width: float, height: float, dx: float, friction: float) -> Solver:
    """A column in the corner of a channel four cells wide with smooth sides."""
    x = lattice((round(2 * width / dx), 8, round(2 * height / dx)), dx / 2)
    sides = Region(lower=(0.0, 0.0, -1e9), upper=(1e9, 4 * dx, 1e9))
    walls = [Container(inside=sides, contact="slip"), Ground(friction=friction)]
    return make_solver(
        x,
        np.full(len(x), (dx / 2) ** 3),
        [material],
        dx=dx,
        boundaries=walls,
        forces=[Gravity()],
        origin=(0.25 * dx, 0.25 * dx, 0.25 * dx),
    )


def front(solver: Solver) -> float:
    """Return the position that 99.5 % of the grains have not passed [m]; single grains fly
    further."""
    return float(np.quantile(solver.state.x.numpy()[:, 0], 0.995))


def slope(solver: Solver, width: float) -> float:
    """Angle of the free surface of a heap between the wall and its toe [degrees]."""
    x, dx = solver.state.x.numpy(), solver.model.dx
    edges = np.arange(0.3 * front(solver), 0.9 * front(solver), dx)
    tops = [x[(x[:, 0] >= a) & (x[:, 0] < a + dx), 2].max() for a in edges]
    return float(-np.degrees(np.arctan(np.polyfit(edges, tops, 1)[0])))


def run_out(friction_angle: float, cells: int) -> tuple[float, float]:
    """Return the run-out of 98 % of a square column, in widths, and the slope of its heap
    [degrees]."""
    width = 0.4
    s = channel(Sand(friction_angle=friction_angle), width, width, width / cells, friction=0.6)
    s.advance(1.0)
    x = s.state.x.numpy()
    assert x[:, 2].min() > -0.2 * s.model.dx  # what docs/design/laws.md promises
    assert np.quantile(np.abs(s.state.v.numpy()), 0.99) < 0.015  # 0.001 half a second later
    return float(np.quantile(x[:, 0], 0.98)) / width - 1, slope(s, width)


@pytest.mark.parametrize("cells", [12, pytest.param(16, marks=pytest.mark.slow)])
def test_a_sand_column_runs_out_and_heaps_as_its_friction_says(cells):
    """Experiments: 1.2 widths to the last grain (Lube et al. 2005); grids stop the thin toe early.

    Friction wrong by 30 or 40 % would be seen: 1.30 and 0.45 widths, 15 and 31 degrees.
    """
    out, angle = run_out(25.0, cells)
    assert 0.65 < out < 1.0
    assert 25 - 6 < angle < 25 + 1


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_wrong_friction_shows_in_a_sand_column(factor):
    out, angle = run_out(25.0 * factor, 12)
    assert not 0.65 < out < 1.0
    assert not 25 - 6 < angle < 25 + 1


@pytest.mark.slow
@pytest.mark.parametrize("cells", [8, 16])
def test_sand_of_more_friction_heaps_steeper(cells):
    width, result = 0.4, []
    for angle in (20.0, 35.0):
        s = channel(Sand(friction_angle=angle), width, width, width / cells, friction=0.6)
        s.advance(1.0)
        result.append(slope(s, width))
        assert angle - 8 < result[-1] < angle + 2
    assert result[1] > result[0] + 7


@pytest.mark.parametrize("cells", [8, pytest.param(16, marks=pytest.mark.slow)])
def test_a_breaking_dam_advances_as_measured(cells):
    """Martin and Moyce (1952); without gate and bottom friction a tenth faster."""
    width = 0.2
    s = channel(Fluid(bulk_modulus=1e5), width, 2 * width, width / cells, friction=0.0)
    for time, place in MARTIN_MOYCE.items():
        s.advance(time * np.sqrt(width / (2 * G)))
        assert front(s) / width == pytest.approx(place, rel=0.12)


def test_water_comes_to_its_hydrostatic_pressure():
    """Gravity sets in at once; the sound that makes is gone in a second (it rang on for many)."""
    dx, height, water = 0.1, 0.4, Fluid()
    x = lattice((8,) * 3, dx / 2)
    tank = Region(lower=(0.0, 0.0, 0.0), upper=(height, height, 1e4))
    s = make_solver(
        x,
        np.full(len(x), (dx / 2) ** 3),
        [water],
        dx=dx,
        forces=[Gravity()],
        boundaries=[Container(inside=tank, friction=0.0)],
        origin=(0.25 * dx,) * 3,
    )
    s.advance(1.0)
    off = []
    for _ in range(6):
        s.advance(s.clock.time + 0.03)
        z = s.state.x.numpy()[:, 2]
        J = np.linalg.det(s.state.F.numpy().astype(float))
        pressure = water.bulk_modulus / water.gamma * (J**-water.gamma - 1)
        layers = [(z >= a) & (z < a + dx) for a in (0.0, dx, 2 * dx)]
        wanted = [1000 * G * (height - z[layer].mean()) for layer in layers]
        off.append([pressure[layer].mean() - p for layer, p in zip(layers, wanted, strict=True)])
    assert np.abs(off).max() < 0.05 * 1000 * G * height


def sag(cells: int, height: float = 0.1, length: float = 0.5) -> float:
    """Sag of the tip of a clamped beam, over that of slender-beam theory (3 % of its length)."""
    dx, theory = height / cells, 0.03 * length
    E = 1.5 * 1000 * G * length**4 / height**2 / theory
    clamped = 2 * cells
    x = lattice((round(2 * length / dx) + clamped, 2 * cells, 2 * cells), dx / 2)
    x[:, 0] -= clamped * dx / 2
    s = make_solver(
        x,
        np.full(len(x), (dx / 2) ** 3),
        [NeoHookean(E=E, nu=0.0)],
        dx=dx,
        forces=[Gravity()],
        boundaries=[Held(lower=(-1, -1, -1), upper=(1e-9, 1, 1))],
        origin=(0, 0.25 * dx, 0.25 * dx),
    )
    while s.clock.time < 0.4:
        s.advance(s.clock.time + 0.005)
        s.state.v.assign(s.state.v.numpy() * np.exp(-0.3))
    tip = s.model.rest[:, 0] > length - dx
    return float((s.model.rest - s.state.x.numpy())[tip, 2].mean()) / theory


@pytest.mark.parametrize(
    ("coarse", "fine", "close"), [(3, 4, 0.03), pytest.param(4, 6, 0.01, marks=pytest.mark.slow)]
)
def test_a_cantilever_sags_as_beam_theory_says(coarse, fine, close):
    """The error is proportional to dx; without it the sag is Timoshenko's (shear adds 3 %)."""
    shear = 1 + 0.8 * 1.2 * (0.1 / 0.5) ** 2
    rough, better = sag(coarse), sag(fine)
    limit = better - (rough - better) * coarse / (fine - coarse)
    assert limit == pytest.approx(shear, rel=close)
    assert 0.93 * shear < rough < better < limit


@pytest.mark.slow
def test_loose_sand_flies_apart_without_a_force():
    """Thrown up and expanding: no stress, so it moves as if it had no stiffness at all."""
    dx, k, rise, time = 0.1, 2.0, 3.0, 0.2
    x = lattice((8,) * 3, dx / 2)
    middle = x.mean(axis=0)
    v = k * (x - middle) + [0, 0, rise]
    C = np.tile(k * np.eye(3), (len(x), 1, 1))
    places = []
    for E in (1e6, 1.0):
        s = make_solver(
            x,
            np.full(len(x), (dx / 2) ** 3),
            [Sand(E=E)],
            dx=dx,
            v=v,
            C=C,
            forces=[Gravity()],
            precision="float64",
            ceiling=5e-4,
        )
        s.advance(time)
        places.append(s.state.x.numpy())
        volume = 3 * np.log(1 + k * time)
        np.testing.assert_allclose(s.state.history.numpy()[:, 0], volume, rtol=0.03)
    np.testing.assert_allclose(places[0], places[1], atol=1e-6)
    expected = x + k * time * (x - middle) + [0, 0, rise * time - G * time**2 / 2]
    np.testing.assert_allclose(places[0], expected, atol=2e-3)


def test_materials_side_by_side_each_obey_their_own_law():
    """A stiff block on a soft one: momentum is kept, the soft one is squeezed, F_total is told."""
    dx = 0.1
    x = lattice((8,) * 3, dx / 2)
    upper = (x[:, 2] > 0.2).astype(int)
    order = np.argsort(upper, kind="stable")
    soft, sand = NeoHookean(E=2e4, density=500.0), Sand(density=2000.0)
    s = make_solver(
        x[order],
        np.full(len(x), (dx / 2) ** 3),
        [soft, sand],
        dx=dx,
        material=upper[order],
        boundaries=[Ground()],
        forces=[Gravity()],
        origin=(0, 0, 0.25 * dx),
    )
    s.advance(0.2)
    below = upper[order] == 0
    assert s.state.x.numpy()[below, 2].mean() > 0.4 * dx
    mass = s.model.mass.numpy()
    assert mass[~below].sum() == pytest.approx(4 * mass[below].sum(), rel=1e-5)
    F, total = s.state.F.numpy(), s.state.deformation.numpy()
    np.testing.assert_array_equal(total[below], F[below])
    assert np.linalg.det(F[below]).mean() < 0.95
    assert np.abs(total[~below] - F[~below]).max() > 0.01


def test_varying_stiffness_agrees_on_two_threads():
    """Two materials of one law: each particle keeps its own row of parameters."""
    dx, places = 0.1, []
    x = lattice((12, 6, 6), dx / 2)
    stiff = (x[:, 0] > 0.3).astype(int)
    for threads in (1, 2):
        s = make_solver(
            x,
            np.full(len(x), (dx / 2) ** 3),
            [NeoHookean(E=5e3), NeoHookean(E=3e5)],
            dx=dx,
            material=stiff,
            boundaries=[Ground()],
            forces=[Gravity()],
            threads=threads,
        )
        s.advance(0.25)
        places.append(s.state.x.numpy())
    np.testing.assert_allclose(places[0], places[1], atol=1e-5)
    heights = [np.ptp(places[0][stiff == part, 2]) for part in (0, 1)]
    assert heights[0] < heights[1] - 0.005


def energy(s: Solver, material: Material) -> float:
    """Elastic, kinetic (with what APIC keeps in C) and potential energy [J]."""
    history = s.state.history.numpy() if len(s.state.history) else None
    elastic = evaluate(material, s.state.F.numpy().astype(np.float64), h=history).energy
    mass, v, C = s.model.mass.numpy(), s.state.v.numpy(), s.state.C.numpy()
    kinetic = mass * ((v**2).sum(1) + s.model.dx**2 / 4 * (C**2).sum((1, 2))) / 2
    height = s.state.x.numpy()[:, 2]
    return float((elastic * s.model.volume.numpy() + kinetic + mass * G * height).sum())


@pytest.mark.parametrize("mach", [0.3, 1.5])
@pytest.mark.parametrize(
    "material",
    [Rigid(E=1e7), *[kind() for kind in KINDS.values() if kind is not Rigid]],
    ids=lambda material: material.law,
)
def test_every_law_lands_hard_without_making_energy(material, mach):
    """A block hits the floor at 0.3 and 1.5 times its speed of sound (at most 60 m/s)."""
    dx, sound = 0.1, material.wave_speed()
    x = lattice((8,) * 3, dx / 2, (0, 0, 0.05))
    v = np.tile([0, 0, -min(mach * sound, 60.0)], (len(x), 1))
    s = make_solver(
        x,
        np.full(len(x), (dx / 2) ** 3),
        [material],
        dx=dx,
        v=v,
        boundaries=[Ground()],
        forces=[Gravity()],
        origin=(0, 0, 0.25 * dx),
    )
    before = energy(s, material)
    for part in range(1, 9):
        s.advance(part / 8 * 2.4 / sound)
        assert energy(s, material) < 1.001 * before
    J = np.linalg.det(s.state.F.numpy())
    if mach < 1 or not material.may_collapse:
        assert J.min() > 0.4
    assert np.all(np.isfinite(s.state.x.numpy()))
