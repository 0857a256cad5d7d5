"""Boundaries: contact, friction, motion, and what each launches."""

from functools import cache

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from phy124.boundaries import (
    AnyBoundary,
    Box,
    Capsule,
    Container,
    Foot,
    Gripper,
    Ground,
    HalfSpace,
    Held,
    Path,
    Press,
    Sphere,
    Swing,
)
from phy124.errors import InputError
from phy124.forces import Gravity
from phy124.materials import Fluid, Foam, NeoHookean, Plasticine, Sand, Snow
from phy124.mpm import Solver
from phy124.schema.region import Region
from phy124.studies.validation.bodies import lattice, make_solver
from support.device_functions import distances

DX = 0.1
EYE = np.eye(3)


def block(size=(0.4, 0.4, 0.4), low=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Eight particles per cell, from a corner on [m]."""
    return lattice([round(2 * side / DX) for side in size], DX / 2, low)


def solver(x: np.ndarray, *walls, material=None, **options) -> Solver:
    """Particles under gravity, the floor plane 0.75 cells above a layer of nodes."""
    options.setdefault("origin", (0.0, 0.0, 0.25 * DX))
    options.setdefault("forces", [Gravity()])
    volume = np.full(len(x), (DX / 2) ** 3)
    return make_solver(
        x, volume, [material or NeoHookean(E=5e4)], dx=DX, boundaries=walls, **options
    )


def settle(s: Solver, time: float, rate: float = 20.0) -> None:
    """Run while something outside draws the motion away: velocities fade at a rate [1/s]."""
    while s.clock.time < time:
        s.advance(s.clock.time + 0.01)
        s.state.v.assign(s.state.v.numpy() * np.exp(-rate * 0.01))


@pytest.mark.parametrize(
    "wall",
    [
        Ground(height=0.0),
        Ground(contact="sticky"),
        Ground(contact="slip"),
        HalfSpace(),
        Box(lower=(-1.0, -1.0, -0.5), upper=(1.0, 1.0, 0.0)),
        Container(inside=Region(lower=(-0.2, -0.2, 0.0), upper=(0.6, 0.6, 1.0))),
    ],
    ids=lambda wall: f"{wall.kind} {wall.contact}",
)
def test_a_settled_block_rests_on_the_wall(wall):
    """Gap of at most 0.2 cells (a particle's half spacing taken off), none deep inside."""
    s = solver(block(low=(0, 0, 0.05)), wall)
    settle(s, 0.6)
    bottom = s.state.x.numpy()[:, 2].reshape(8, 8, 8)[:, :, 0] - DX / 4
    assert abs(bottom.mean()) < 0.2 * DX
    assert bottom.min() > -0.5 * DX


def test_a_light_body_does_not_sink_under_a_heavy_one():
    """The masses of the nodes at a wall then do not stand in the ratio of one material."""
    x = block(size=(0.4, 0.4, 0.6))
    heavy = (x[:, 2] > 0.2).astype(int)
    order = np.argsort(heavy, kind="stable")
    both = [NeoHookean(E=1e5, density=100.0), NeoHookean(E=1e5, density=1000.0)]
    volume = np.full(len(x), (DX / 2) ** 3)
    s = make_solver(
        x[order],
        volume,
        both,
        dx=DX,
        material=heavy[order],
        boundaries=[Ground()],
        forces=[Gravity()],
        origin=(0, 0, 0.25 * DX),
    )
    settle(s, 0.4)
    assert abs(s.state.x.numpy()[:, 2].min() - DX / 4) < 0.2 * DX


@pytest.mark.parametrize(
    ("material", "deepest"),
    [(Sand(), 0.12), (Foam(), 0.05), pytest.param(Plasticine(), 0.05, marks=pytest.mark.slow)],
)
def test_crowded_fluid_particles_do_not_sink(material, deepest):
    """Two bodies in one place, as the middle of a heap has them, above a layer of one."""
    x = block(size=(0.6, 0.6, 0.4))
    crowd = x[x[:, 2] > 0.8 * DX] + [DX / 8, DX / 8, 0]
    s = solver(np.concatenate([x, crowd]), Ground(friction=0.6), material=material)
    s.advance(0.3)
    assert np.quantile(s.state.x.numpy()[:, 2], 0.005) > -deepest * DX


@pytest.mark.parametrize(
    "material", [Sand(E=2e5), Snow(), Foam(), Plasticine()], ids=lambda m: m.law
)
@pytest.mark.parametrize("layer", [0.25, 0.6])
def test_plastic_material_does_not_sink_through_the_floor(material, layer):
    """Wherever the nodes are: with single nodes heaps of sand ended 0.7 cells below it."""
    s = solver(block(low=(0, 0, 0.1)), Ground(), material=material, origin=(0, 0, layer * DX))
    s.advance(0.5)
    assert s.state.x.numpy()[:, 2].min() > -0.2 * DX


def test_round_obstacles_carry_what_falls_on_them():
    for wall in (
        Sphere(centre=(0.2, 0.2, -0.5), radius=0.5),
        Capsule(start=(0.2, -1.0, -0.4), end=(0.2, 1.5, -0.4), radius=0.4),
    ):
        s = solver(block(), wall, Held(lower=(-9, -9, -9), upper=(9, 9, -2)))
        settle(s, 0.3)
        middle = s.state.x.numpy() - [0.2, 0.2, 0.0]
        over = np.linalg.norm(middle[:, :2], axis=1) < 0.1
        assert -0.5 * DX < middle[over, 2].min() - DX / 4 < 0.5 * DX
        _, signed = distances(wall.shape, wall.geometry(s), s.state.x.numpy())
        assert signed.min() > -0.6 * DX


def test_slip_keeps_the_tangential_velocity_and_sticky_does_not():
    for contact, kept in (("slip", True), ("sticky", False)):
        s = solver(block(), Ground(contact=contact), v=np.tile([1.0, 0.5, 0], (512, 1)))
        s.advance(0.2)
        if kept:
            np.testing.assert_allclose(s.state.v.numpy().mean(axis=0)[:2], [1.0, 0.5], rtol=1e-5)
        else:
            bottom = s.model.rest[:, 2] < 0.05
            assert np.abs(s.state.x.numpy()[bottom] - s.model.rest[bottom]).max() < 0.1


@pytest.mark.parametrize(("slope", "mu"), [(0.3, 0.5), (0.5, 0.3), (0.4, 0.0)])
def test_block_slides_only_on_inclines_steeper_than_mu(slope, mu):
    """Gravity is tilted: a = g (sin - mu cos), or nothing where mu exceeds the slope."""
    angle = np.arctan(slope)
    g = 9.81 * np.array([np.sin(angle), 0, -np.cos(angle)])
    tilted, body = Gravity(g=tuple(g)), NeoHookean(E=2e5)
    s = solver(block(), Ground(friction=mu), forces=[tilted], material=body)
    expected, free = (max(0.0, a) * 0.25**2 / 2 for a in (g[0] + mu * g[2], g[0]))
    assert slide(s, EYE[0]) == pytest.approx(expected, abs=0.08 * free)


def slide(s: Solver, along: np.ndarray) -> float:
    """Way in 0.25 s from rest, after the weight has settled [m]."""
    settle(s, 0.4)
    s.state.v.zero_()
    s.state.C.zero_()
    before = (s.state.x.numpy() @ along).mean()
    s.advance(s.clock.time + 0.25)
    return float((s.state.x.numpy() @ along).mean() - before)


@pytest.mark.slow
@pytest.mark.parametrize(("slope", "mu"), [(0.3, 0.5), (0.5, 0.3)])
def test_an_incline_across_the_grid_does_the_same(slope, mu):
    angle = np.arctan(slope)
    along = np.array([np.cos(angle), 0, -np.sin(angle)])
    up = np.array([np.sin(angle), 0, np.cos(angle)])
    x = (block() - [0.2, 0.2, 0]) @ np.array([along, [0, 1, 0], up])
    s = solver(x, HalfSpace(normal=tuple(up), friction=mu), material=NeoHookean(E=2e5))
    expected = max(0.0, 9.81 * (np.sin(angle) - mu * np.cos(angle))) * 0.25**2 / 2
    free = 9.81 * np.sin(angle) * 0.25**2 / 2
    assert slide(s, along) == pytest.approx(expected, abs=0.25 * free)


def test_press_moves_particles_and_wall_follows_its_path():
    press = Press(depth=0.3, down=0.2, hold=0.1, up=0.2, friction=0.0)
    s = solver(block(), Ground(), press, forces=[])
    s.advance(0.25)
    top = s.state.x.numpy()[:, 2].max() + DX / 4
    assert top == pytest.approx(0.4 - 0.3 * 0.35, abs=0.3 * DX)
    path = Path(times=(0.0, 0.2), points=((0.0, 0.0, 0.0), (0.3, 0.0, 0.0)))
    pushed = solver(
        block(low=(0.0, 0, 0)),
        HalfSpace(normal=(1, 0, 0), contact="sticky", motion=path),
        forces=[],
        origin=(0.25 * DX, 0, 0),
    )
    settle(pushed, 0.6)
    assert pushed.state.x.numpy()[:, 0].min() - DX / 4 == pytest.approx(0.3, abs=0.5 * DX)


def test_a_shaking_base_carries_what_sticks_to_it():
    swing = Swing(amplitude=(0.05, 0.0, 0.0), frequency=2.0, start=0.1)
    s = solver(block(), Ground(contact="sticky", motion=swing), material=NeoHookean(E=1e6))
    s.advance(0.1)
    before = s.state.x.numpy()[:, 0].mean()
    s.advance(0.225)
    assert s.state.x.numpy()[:, 0].mean() - before == pytest.approx(0.05, abs=0.01)
    s.advance(0.475)
    assert s.state.x.numpy()[:, 0].mean() - before == pytest.approx(-0.05, abs=0.01)


def test_a_gripper_lifts_a_block():
    gripper = Gripper(
        axis="x",
        centre=(0.2, 0.2, 0.2),
        opening=0.6,
        closed=0.3,
        width=0.5,
        thick=0.4,
        close=0.15,
        lift=0.2,
        rise=0.3,
        friction=2.0,
    )
    s, heights = solver(block(), Ground(), gripper, material=NeoHookean(E=1e5)), []
    for time in (0.15, 0.6, 0.75):
        s.advance(time)
        heights.append(s.state.x.numpy()[:, 2].mean())
    assert heights[1] - heights[0] == pytest.approx(0.2, abs=0.03)
    assert heights[2] == pytest.approx(heights[1], abs=0.005)


@pytest.mark.slow
def test_a_container_keeps_a_fluid():
    tank = Region(lower=(0.0, 0.0, 0.0), upper=(0.8, 0.4, 1e9))
    water = Fluid(bulk_modulus=2e4)
    s = solver(block(), Container(inside=tank, friction=0.0), material=water)
    s.advance(0.8)
    x = s.state.x.numpy()
    # The layer of nodes that stops it lies up to 1.15 cells inside a wall; a fluid nears it.
    assert np.all(x >= np.array(tank.lower) - 1.1 * DX)
    assert np.all(x[:, :2] <= np.array(tank.upper)[:2] + 1.1 * DX)
    assert x[:, 0].max() > 0.7
    assert np.median(x[:, 2]) < 0.15


def test_foot_and_held_hold_their_part(rng):
    for wall in (Foot(fraction=0.3), Held(lower=(-1, -1, -1), upper=(1, 1, 0.12))):
        s = solver(block(), wall, forces=[Gravity(g=(9.81, 0, 0))])
        s.advance(0.1)
        moved = np.abs(s.state.x.numpy() - s.model.rest)[:, 0]
        assert moved[s.model.rest[:, 2] < 0.05].max() < 0.1 * moved[s.model.rest[:, 2] > 0.35].min()


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("offset", [0.0, 0.3, 0.45, 0.55, 0.8])
def test_held_material_ends_at_the_surface_of_its_region(axis, offset):
    """A pulled bar is as long as its free part, wherever the clamp ends between the nodes."""
    along, free = EYE[axis], 0.6
    x = block(size=tuple(0.2 + 0.6 * along), low=tuple(-0.2 * along))
    g, E = 2.0, 2e4
    clamp = Held(lower=(-1, -1, -1), upper=tuple(np.where(along, 0.0, 1.0)))
    s = solver(
        x,
        clamp,
        forces=[Gravity(g=tuple(g * along))],
        material=NeoHookean(E=E, nu=0.0),
        origin=tuple(offset * DX * along),
    )
    settle(s, 1.0, rate=10.0)
    wanted = 1000 * g / E * (free * s.model.rest[:, axis] - s.model.rest[:, axis] ** 2 / 2)
    moved = (s.state.x.numpy() - s.model.rest)[:, axis]
    slope = 1000 * g * free / E
    end = s.model.rest[:, axis] > free - DX
    assert abs((moved - wanted)[end].mean()) < 0.27 * DX * slope
    assert np.abs(moved[s.model.rest[:, axis] < -DX]).max() < 0.08 * DX * slope


def test_a_clamp_lets_go_and_moves_what_it_holds():
    """Until its end; a cylinder holds what is in it."""
    disk = {"lower": (0.05, 0.05, -1.0), "upper": (0.35, 0.35, 1.0), "cylinder": "z"}
    up = Path(times=(0.0, 0.1), points=((0, 0, 0), (0, 0, 0.1)))
    s = solver(block(), Held(**disk, motion=up, end=0.15), material=NeoHookean(E=1e6))
    held = np.hypot(*(s.model.rest[:, :2] - 0.2).T) < 0.05
    s.advance(0.15)
    assert (s.state.x.numpy() - s.model.rest)[held, 2].mean() == pytest.approx(0.1, abs=0.005)
    s.advance(0.25)
    assert s.state.v.numpy()[:, 2].mean() == pytest.approx(-9.81 * 0.1, rel=0.2)
    with pytest.raises(ValidationError, match="swap them"):
        Held(lower=(1, 0, 0), upper=(0, 1, 1))
    with pytest.raises(ValidationError, match="remove `inside"):
        Container(inside=Region(lower=(0, 0, 0), upper=(1, 1, 1), cylinder="z"))


def stages(*walls) -> list[str]:
    """Names of the collider stages that are launched in a substep."""
    s = solver(block(), *walls)
    s.step(1e-4, 1e-4)
    known = {"clear", "grid", "p2g neo_hookean", "g2p neo_hookean"}
    return [name for phase in s.workers[0].phases for name, _ in phase if name not in known]


def test_each_boundary_launches_its_kernels():
    assert stages() == []
    assert stages(Ground()) == ["ground"]
    assert stages(Ground(), Press()) == ["ground", "press"]
    # Columns at those that are not flat respond twice, and then settle.
    solids = [name for name in ("sphere", "box", "capsule") for _ in range(4)]
    assert stages(Sphere(), Box(), Capsule()) == solids
    assert stages(Container(inside=Region(lower=(-0.1, -0.1, -0.1)))) == ["container"] * 3
    assert (
        stages(Gripper(centre=(0.2, 0.2, 0.2), opening=0.5, closed=0.3, thick=0.3))
        == ["gripper"] * 8
    )
    assert stages(Sphere(centre=(50.0, 0, 0)), Ground(height=-70.0)) == []


def test_thin_obstacles_are_refused_with_a_reason():
    with pytest.raises(InputError, match="thinner than two grid cells") as refused:
        solver(block(), Box(lower=(0, 0, 0), upper=(1, 1, 0.05)))
    assert "Make the solid thicker, or use a finer grid" in str(refused.value)
    with pytest.raises(InputError, match=r"boundaries\.gripper.*each pad"):
        solver(block(), Gripper(thick=0.1))


def test_boundaries_are_named_by_their_kind_and_refuse_nonsense():
    adapter = TypeAdapter(AnyBoundary)
    moving = Sphere(motion=Swing())
    for wall in (Ground(), moving, Box(motion=Path()), Capsule(), Container(), Gripper(), Foot()):
        assert adapter.validate_python(wall.model_dump()) == wall
        assert adapter.validate_json(wall.model_dump_json()) == wall
    with pytest.raises(ValidationError, match="swap them"):
        Box(lower=(1, 0, 0), upper=(0, 1, 1))
    with pytest.raises(ValidationError, match="use a sphere"):
        Capsule(start=(0, 0, 0), end=(0, 0, 0))
    with pytest.raises(ValidationError, match="the normal is zero"):
        HalfSpace(normal=(0, 0, 0))
    with pytest.raises(ValidationError, match="must end where it begins"):
        Path(times=(0, 1), points=((0, 0, 0), (1, 0, 0)), repeat=True)
    with pytest.raises(ValidationError, match="must be less than opening"):
        Gripper(opening=0.3, closed=0.4)
    with pytest.raises(ValidationError, match="Extra inputs"):
        Press(motion=Swing())


@cache
def squeezed(axis: int, offset: float) -> float:
    """Strain of a block between two plates, less that of the gap, in cells; nu is 0."""
    across, depth = EYE[axis], 0.08 + offset * DX
    x = block(size=tuple(0.4 + 0.4 * across), low=tuple(0.013 * across))
    path = Path(times=(0.0, 0.15), points=((0, 0, 0), tuple(-depth * across)))
    walls = [
        HalfSpace(point=tuple(0.013 * across), normal=tuple(across), contact="slip"),
        HalfSpace(point=tuple(0.813 * across), normal=tuple(-across), contact="slip", motion=path),
    ]
    s = solver(x, *walls, forces=[], material=NeoHookean(E=5e4, nu=0.0), origin=(0, 0, 0))
    s.advance(0.2)
    strains = []
    while s.clock.time < 0.35:
        s.advance(s.clock.time + 0.01)
        inner = np.abs(s.model.rest[:, axis] - 0.413) < 0.2
        strains.append(s.state.F.numpy()[inner, axis, axis].mean())
    return (np.mean(strains) * 0.8 - (0.8 - depth)) / DX


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("offset", [0.0, 0.3, 0.6])
def test_plates_squeeze_by_the_way_they_went(axis, offset):
    """Wherever they stand between the nodes: a tenth of a cell, where single nodes miss one."""
    assert abs(squeezed(axis, offset)) < 0.12


WALLS_ACROSS = {
    "tank": [Container(inside=Region(lower=(-0.02, -0.02, 0.0), upper=(0.22, 0.22, 1e9)))],
    "plane": [HalfSpace(point=(0.22, 0, 0), normal=(-1, 0, 0)), Ground()],
    "ball": [Sphere(centre=(0.1, 0.1, -0.05), radius=0.12), Ground(height=-0.05)],
    "slope": [HalfSpace(point=(0.2, 0, 0.05), normal=(-1, 0, 0.3))],
    "box": [Box(lower=(-0.1, -0.1, -0.3), upper=(0.15, 0.15, 0.03))],
    "held": [Held(lower=(0.0, 0.0, 0.0), upper=(0.1, 0.2, 0.1))],
}


@pytest.mark.parametrize(
    "walls",
    [
        pytest.param(
            walls, id=name, marks=[] if name in ("tank", "plane", "ball") else [pytest.mark.slow]
        )
        for name, walls in WALLS_ACROSS.items()
    ],
)
def test_walls_do_not_depend_on_where_the_threads_part(walls):
    """Their columns lead from the layers of one thread to those of the next."""
    x = block(size=(0.2, 0.2, 0.2))
    v = np.tile([0.5, 0.1, -0.5], (len(x), 1))

    def run(threads: int) -> np.ndarray:
        # In float64, since rounding may decide in which substep a wall begins to act.
        s = solver(x, *walls, v=v, threads=threads, precision="float64")
        s.advance(0.03)
        return s.state.x.numpy()

    single, several = run(1), run(5)
    np.testing.assert_allclose(several, single, rtol=0, atol=1e-13)
    assert np.array_equal(several, run(5))


def test_a_pad_does_not_magnify_rounding(rng):
    """A node that is hardly pushed must not count suddenly; otherwise results depend on the thread
    order."""
    pads = Gripper(centre=(0.2, 0.2, 0.2), opening=0.5, closed=0.3, thick=0.3, close=0.05)
    x = block()
    ends = []
    for start in (x, x + 1e-8 * rng.standard_normal(x.shape)):
        (s := solver(start, pads)).advance(0.1)
        ends.append(s.state.x.numpy())
    assert 0 < np.abs(ends[0] - ends[1]).max() < 1e-5
