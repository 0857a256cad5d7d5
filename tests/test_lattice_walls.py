"""Lattices at walls, against analytic cases."""

import math

import numpy as np
import pytest

from phy124.boundaries import Ground, HalfSpace, Held
from phy124.boundaries.motion import Path
from phy124.forces import Gravity
from phy124.generators.shapes import make_shape
from phy124.kernels.free.numbers import VELOCITY
from phy124.kernels.lattice.contact import MOMENT
from phy124.kernels.work import IMPULSE, MOVED, WORK
from phy124.lattice.walls import TOUCHING
from phy124.materials import NeoHookean
from phy124.monitor.lattice import LatticeTotals
from phy124.mpm import FreeBody, Pair
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import fill_solid, surface_of_ball
from phy124.studies.validation.experiments.pressed_block import stress
from support.lattices import DAMPED, DX, SOFT, block, make, make_bodies


@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_block_on_a_slope_obeys_friction(friction):
    angle = math.radians(20)
    g = 0.5
    pull = Gravity(g=(g * math.sin(angle), 0, -g * math.cos(angle)))
    damped = NeoHookean(E=1e5, nu=0.3, density=1000, damping=300.0)
    ground = Ground(friction=friction)
    solver = make(block((0.4, 0.3, 0.3)), damped, forces=[pull], boundaries=[ground])
    totals = LatticeTotals(solver)
    solver.advance(1.0)
    before = totals.read(solver.clock)
    solver.advance(2.0)
    gained = totals.read(solver.clock).momentum[0] - before.momentum[0]
    slides = math.sin(angle) - friction * math.cos(angle)
    expected = max(slides, 0.0) if friction < math.tan(angle) else 0.0
    assert gained / 36 / g == pytest.approx(expected, abs=2e-3)
    assert solver.state.x.numpy()[:, 2].min() > 0.015


@pytest.mark.parametrize("contact", ["separate", "sticky", "slip"])
def test_undamped_block_stands_still_at_a_wall(contact):
    """Gravity acts at once; a slip wall holds the block against it."""
    up = -1.0 if contact == "slip" else 1.0
    floor = HalfSpace(contact=contact)
    solver = make(block((0.6, 0.6, 0.6)), forces=[Gravity(g=(0, 0, -9.0 * up))], boundaries=[floor])
    solver.advance(2.0)
    bottom = solver.model.rest[:, 2] < DX
    moved = (solver.state.x.numpy() - solver.model.rest)[bottom].mean(axis=0)
    assert abs(moved[2]) < 0.2 * DX
    assert contact == "slip" or np.abs(moved[:2]).max() < 0.1 * DX
    assert np.abs(solver.state.v.numpy()).max() < 0.6


@pytest.mark.parametrize("contact", ["separate", "slip", "sticky"])
def test_wall_leaves_a_body_at_rest_that_starts_inside_it(contact):
    solver = make(block((0.4, 0.4, 0.4), (0, 0, -0.05)), boundaries=[HalfSpace(contact=contact)])
    solver.advance(0.1)
    assert np.abs(solver.state.v.numpy()).max() < 1e-12


def test_block_lands_at_the_surface_of_a_wall_inside_which_it_started():
    pull, wall = Gravity(g=(0, 0, -2.0)), HalfSpace()
    solid = block((0.4, 0.4, 0.4), (0, 0, -0.05))
    solver = make(solid, DAMPED, v=(0, 0, 0.5), forces=[pull], boundaries=[wall])
    for until in (0.2, 1.5):
        solver.advance(until)
        saved = solver.snapshot()
        solver.bind(forces=[pull], boundaries=[wall])
        solver.restore(saved)
    risen = (solver.state.x.numpy() - solver.model.rest)[:, 2].mean()
    assert risen == pytest.approx(0.05, abs=0.05 * DX)


@pytest.mark.parametrize("contact", ["sticky", "slip"])
@pytest.mark.parametrize("gap", [0.0, 0.4, 0.7])
def test_block_hangs_from_a_ceiling_near_which_it_starts(contact, gap):
    ceiling = HalfSpace(point=(0, 0, 0.4 + gap * DX), normal=(0, 0, -1), contact=contact)
    pull = Gravity(g=(0, 0, -2.0))
    solver = make(block((0.4, 0.4, 0.4)), DAMPED, forces=[pull], boundaries=[ceiling])
    solver.advance(0.5)
    before = solver.walls.sums.numpy()[0].copy()
    solver.advance(1.0)
    force = (solver.walls.sums.numpy()[0] - before)[IMPULSE + 2] / 0.5
    assert force == pytest.approx(64 * 2.0, rel=0.01)
    sunk = (solver.model.rest - solver.state.x.numpy())[:, 2].mean()
    assert sunk == pytest.approx(1000 * 2.0 * 0.4**2 / 3 / DAMPED.E, abs=0.01 * DX)


def test_sticky_floor_holds_no_more_of_a_ball_than_the_ball_touches():
    """Otherwise, the ball would sink much less."""
    low, high, soft = np.array([-0.6, -0.6, 0]), np.array([0.6, 0.6, 1.2]), DAMPED
    ball = fill_solid(lambda x: np.linalg.norm(x - [0, 0, 0.6], axis=-1) - 0.6, low, high, DX / 2)
    pull, sunk = Gravity(g=(0, 0, -9.0)), []
    for contact in ("separate", "sticky"):
        solver = make(ball, soft, forces=[pull], boundaries=[HalfSpace(contact=contact)])
        solver.advance(0.2)
        sunk.append((solver.model.rest - solver.state.x.numpy())[:, 2].mean())
    assert sunk[0] > 0.5 * DX
    assert sunk[1] == pytest.approx(sunk[0], rel=0.06)


def test_pressed_block_has_the_exact_force():
    """A block between smooth walls on five sides is pressed by 1 % within 0.2 s."""
    walls = [HalfSpace(normal=tuple(np.eye(3)[axis]), contact="slip") for axis in range(3)]
    walls += [HalfSpace(point=(0.4, 0, 0), normal=(-1, 0, 0), friction=0)]
    walls += [HalfSpace(point=(0, 0.4, 0), normal=(0, -1, 0), friction=0)]
    path = Path(times=(0.0, 0.2), points=((0, 0, 0), (0, 0, -0.004)))
    plate = HalfSpace(point=(0, 0, 0.4), normal=(0, 0, -1), friction=0, motion=path)
    rubber = SOFT.model_copy(update={"damping": 200.0})
    solver = make(block((0.4, 0.4, 0.4)), rubber, boundaries=[plate, *walls])
    solver.advance(0.5)
    before = solver.walls.sums.numpy()[0].copy()
    solver.advance(0.6)
    pressure = (solver.walls.sums.numpy()[0] - before)[IMPULSE + 2] / 0.1 / 0.16
    exact, _ = stress(0.99, 1.0)
    assert -pressure == pytest.approx(-exact * SOFT.E, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "strain"), [(0.0, 0.7), (300.0, 0.05)])
def test_block_comes_back_from_a_fifth_of_its_height(damping, strain):
    path = Path(times=(0.0, 0.6, 1.6), points=((0, 0, 0), (0, 0, -0.8), (0, 0, 0.1)))
    plate = HalfSpace(point=(0, 0, 1), normal=(0, 0, -1), friction=0.3, motion=path)
    rubber = SOFT.model_copy(update={"damping": damping})
    walls = [plate, HalfSpace(friction=0.3)]
    solver = make(block((1, 1, 1)), rubber, boundaries=walls, precision="float32")
    depths = []
    solver.advance(0.6, after=lambda: depths.append(solver.walls.depth()[0]))
    assert max(depths) < 0.2
    solver.advance(2.1)
    stretch = np.linalg.svd(solver.state.F.numpy(), compute_uv=False)
    assert np.abs(stretch - 1).max() < strain


def test_fast_wall_does_not_pass_points_between_two_measurements():
    """In a substep, the wall moves 0.6 cells; points are listed every four substeps."""
    rubber = SOFT.model_copy(update={"damping": 100.0})
    body = block((0.6, 0.6, 0.6))
    dt = make(body, rubber, precision="float32").limits.substep_at_rest
    path = Path(times=(0.0, 1.0), points=((0, 0, 0), (0, 0, -0.6 * DX / dt)), smooth=False)
    plate = HalfSpace(point=(0, 0, 0.6 + 1.5 * DX), normal=(0, 0, -1), motion=path)
    solver = make(body, rubber, boundaries=[plate], precision="float32")
    depths = []
    solver.advance(5 * dt, after=lambda: depths.append(solver.walls.depth()[0]))
    assert max(depths) < 0.1


@pytest.mark.parametrize("contact", ["slip", "sticky"])
def test_wall_that_holds_a_ball_stays_at_its_surface(contact):
    """The plate presses the ball by 0.6 cells, then lifts it at a fifth of its speed of sound."""
    path = {
        "kind": "path",
        "times": [0, 0.1, 0.6],
        "points": [[0, 0, 0], [0, 0, -0.06], [0, 0, 0.5]],
    }
    plate = {"kind": "half_space", "point": [0, 0, 1], "normal": [0, 0, -1], "contact": contact}
    data = {
        "material": {"law": "neo_hookean", "E": 3e4},
        "boundaries": [{"kind": "ground"}, {**plate, "motion": path}],
        "accuracy": {"cells": 10, "solver": "lattice"},
        "time": {"frames": 17},
    }
    run = Simulation(prepare(surface_of_ball(), Scene.from_data(data), RunContext(threads=1)))
    depths = []
    run.run(record=lambda run: depths.append(run.solver.walls.depth()[0]))
    assert run.solver.state.x.numpy()[:, 2].min() > 0.1
    assert max(depths) < 0.12


def test_very_short_substep_throws_no_point_off_a_wall():
    floor = HalfSpace(contact="sticky")
    solver = make(block((0.4, 0.4, 0.4)), forces=[Gravity(g=(0, 0, -9.0))], boundaries=[floor])
    solver.advance(0.05)
    solver.advance(0.05 + 1e-10)
    assert np.abs(solver.state.v.numpy()).max() < 1


def test_slip_wall_holds_a_clamped_beam():
    clamp = Held(lower=(-1, -1, -1), upper=(0.15, 1, 1))
    wall = HalfSpace(normal=(0, 1.0, 0), contact="slip")
    solver = make(
        block((1.0, 0.1, 0.2)), forces=[Gravity(g=(0, 1e-3, 1e-3))], boundaries=[clamp, wall]
    )
    solver.advance(1.0)
    assert np.abs(solver.state.v.numpy()[:, 1]).max() < 1e-4


def test_walls_impulse_and_work_close_the_balance():
    damped = NeoHookean(E=1e5, nu=0.3, density=1000)
    solid = block((0.35, 0.3, 0.3), low=(0, 0, 0.025), per=4)
    solver = make(solid, damped, v=(0.3, 0, -0.5), boundaries=[Ground()])
    totals = LatticeTotals(solver)
    start = totals.read(solver.clock)
    solver.advance(0.2)
    end = totals.read(solver.clock)
    sums = solver.walls.sums.numpy()[0]
    assert np.allclose(
        end.momentum - start.momentum, sums[IMPULSE : IMPULSE + 3], rtol=0, atol=1e-12
    )
    assert sums[WORK] < 0
    assert end.energy - start.energy - sums[WORK] == pytest.approx(0, abs=0.05 * start.energy)


PATH = Path(times=(0.0, 0.2), points=((0, 0, 0), (0.1, 0, -0.03)))
HOLD = [Held(lower=(0.2, -1, -1), upper=(1, 1, 1), motion=PATH), HalfSpace(friction=0.4)]
"""A clamp holds one side of a block that the floor touches, also on held nodes."""


def test_wrenches_and_works_on_held_points_balance():
    """A steel ball also presses the block."""
    steel = FreeBody("ball", "sphere", (0.2,) * 3, (0.2, 0.15, 0.5), velocity=(0, 0, -1))
    solver = make(block((0.3, 0.3, 0.3)), boundaries=HOLD, free=[steel])
    solver.walls.keep_impulses()
    solver.keep_works()
    totals = LatticeTotals(solver)
    before = totals.read(solver.clock)
    solver.advance(0.05)
    after, rows = totals.read(solver.clock), solver.walls.sums.numpy()
    solid, scale = solver.free._total().sum(axis=(0, 1)), 1e-13 * rows[:, MOVED].max()
    gained = rows[:, :3].sum(axis=0) + solid[:3]
    assert np.allclose(gained, after.momentum - before.momentum, rtol=0, atol=scale)
    turned = rows[:, MOMENT : MOMENT + 3].sum(axis=0) + solid[3:6]
    assert np.allclose(turned, after.angular - before.angular, rtol=0, atol=scale)
    velocity = solver.free._bodies[0].numpy()[VELOCITY : VELOCITY + 3]
    stopped = steel.mass * (velocity - steel.velocity)
    assert np.allclose(stopped, -solid[:3], rtol=0, atol=scale)
    each = solver.walls.impulses.sums.numpy().sum(axis=0)
    assert np.allclose(each, rows[:, :3].sum(axis=0), rtol=0, atol=scale)
    works = solver.energies.read()
    assert solid[6] == pytest.approx(works.solids, rel=1e-12)
    of_walls = works.walls + works.held + works.friction + works.impacts
    assert rows[:, WORK].sum() == pytest.approx(of_walls, rel=1e-12)


@pytest.mark.parametrize(("place", "radius"), [(0.4, 0.4), (0.4, 1.3), (0.45, 0.45)])
def test_cylinder_of_about_a_cell_holds_a_block(place, radius):
    """The axis of the clamp is at a corner of cells, or at a node; the radius is in cells."""
    low, high = place - radius * DX, place + radius * DX
    clamp = Held(lower=(low, -1, low), upper=(high, 1, high), cylinder="y")
    thick, pull = SOFT.model_copy(update={"damping": 2000.0}), Gravity(g=(0, 0, -2.0))
    solver = make(block((0.8, 0.4, 0.8)), thick, forces=[pull], boundaries=[clamp])
    solver.advance(0.4)
    before = solver.walls.sums.numpy()[0].copy()
    solver.advance(0.8)
    force = (solver.walls.sums.numpy()[0] - before)[IMPULSE + 2] / 0.4
    assert force == pytest.approx(256 * 2.0, rel=0.02)
    assert np.abs(solver.state.x.numpy() - solver.model.rest).max() < 0.4 * DX


def test_clamp_takes_impulses_between_bodies():
    solids = [block((0.3, 0.3, 0.3)), block((0.2, 0.3, 0.3), low=(-0.1, 0.3, 0))]
    moving = [(0, 0, 0), (0, -0.3, 0)]
    solver = make_bodies(solids, v=moving, boundaries=HOLD, pairs=[Pair(0, 1, 0.3)])
    totals = LatticeTotals(solver)
    before = totals.read(solver.clock).momentum
    solver.advance(0.02)
    assert solver.meetings.of_pairs[0].most
    gained, rows = totals.read(solver.clock).momentum - before, solver.walls.sums.numpy()
    scale = 1e-13 * rows[:, MOVED].max()
    assert np.allclose(rows[:, :3].sum(axis=0), gained, rtol=0, atol=scale)


def test_floor_moves_nodes_that_a_clamp_has_released():
    solver = make(block((0.3, 0.3, 0.3)), v=(0, 0, -0.5), boundaries=HOLD)
    solver.advance(0.01)
    solver.bind(boundaries=HOLD[1:])
    totals = LatticeTotals(solver)
    before = totals.read(solver.clock).momentum
    solver.advance(0.03)
    gained, floor = totals.read(solver.clock).momentum - before, solver.walls.sums.numpy()[0]
    assert np.allclose(floor[:3], gained, rtol=0, atol=1e-13 * floor[MOVED])


def test_clamp_keeps_nodes_that_an_overlapping_clamp_releases():
    """After the release, a rising floor lifts the free side, but not what the first clamp holds."""
    rise = HalfSpace(motion=Path(times=(0.0, 0.1), points=((0, 0, 0), (0, 0, 0.02))))
    side = Held(lower=(-1, -1, -1), upper=(0.2, 1, 1))
    released = Held(lower=(-1, -1, -1), upper=(0.25, 1, 1), end=0.01)
    solver = make(block((0.5, 0.3, 0.3)), boundaries=[side, released, rise])
    solver.advance(0.02)
    before = solver.walls.sums.numpy().copy()
    solver.advance(0.05)
    inside = (solver.lattice.x[:, 0] < 0.1) & (solver.nodes_state.inverse.numpy() > 0)
    assert np.abs(solver.nodes_state.u.numpy()[inside]).max() == 0
    taken = (solver.walls.sums.numpy() - before)[:, IMPULSE + 2]
    assert taken[0] < 0 < taken[2] and taken[1] == 0


@pytest.mark.usefixtures("coarse_solids")
def test_note_names_sides_of_a_container_and_no_contact_that_they_have():
    sides = {"lower": [-0.4, -0.4, -1], "upper": [0.4, 0.4, 2]}
    scene = Scene.from_data(
        {
            "material": {"law": "neo_hookean", "E": 1e5, "damping": 50.0},
            "boundaries": [{"kind": "container", "inside": sides}],
            "forces": [],
            "accuracy": {"cells": 8, "solver": "lattice"},
            "time": {"frames": 2},
        }
    )
    cube = make_shape("box", (1, 1, 1), (0.5, 0.5, 0.5), count=500)
    notes = Simulation(prepare(cube, scene, RunContext(threads=1))).run().report["notes"]
    (note,) = (note for note in notes if "too little space" in note)
    assert note.startswith("The boundaries container_") and " and container_" in note
    assert "separate" not in note


@pytest.mark.parametrize("contact", ["sticky", "separate"])
def test_note_names_walls_between_which_there_is_too_little_space(contact):
    """A plate passes the middle of a sphere, to which the material sticks or not."""
    down = {"kind": "path", "times": [0, 0.04], "points": [[0, 0, 0], [0, 0, -0.4]]}
    along = {"kind": "path", "times": [0, 0.03], "points": [[0, 0, 0], [0, 0.5, 0]]}
    plate = {"kind": "half_space", "point": [0, 0, 1], "normal": [0, 0, -1], "contact": "slip"}
    sphere = {"kind": "sphere", "centre": [0, -0.8, 0.7], "radius": 0.25, "contact": contact}
    scene = Scene.from_data(
        {
            "material": {"law": "neo_hookean", "E": 2e5, "density": 200.0, "damping": 1000.0},
            "boundaries": [{**plate, "motion": down}, {**sphere, "motion": along}],
            "forces": [],
            "accuracy": {"cells": 6},
            "time": {"frames": 4, "fps": 100.0},
        }
    )
    run = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1)))
    report = run.run().report
    depth, inside, touching = run.solver.pinch()
    assert report["complete"]
    messages = [note for note in report["notes"] if "too little space" in note]
    if contact == "separate":
        assert depth < 0.3 and not messages
    else:
        assert (inside, touching) == (0, 1)
        # At the last frame, the sphere has moved by 0.5 m, and the plate has passed three quarters
        # of the time of its smooth path.
        low = 1 - 0.4 * (1 + math.sqrt(0.5)) / 2
        surface, u = run.solver.surface, run.solver.nodes_state.u.numpy()
        x = surface.x + np.einsum("sk,skd->sd", surface.weights, u[surface.nodes])
        held = np.linalg.norm(x - (0, -0.3, 0.7), axis=1) - 0.25 < TOUCHING * surface.dx
        assert depth == pytest.approx((x[held, 2].max() - low) / surface.dx, abs=1e-3)
        assert len(messages) == 1 and f"{depth:.1f} cells inside half_space" in messages[0]
        assert "half_space and sphere" in messages[0]


@pytest.mark.parametrize(("solver", "effect"), [("lattice", "1.5 cells thick"), ("mpm", "no grid")])
def test_note_names_a_clamp_that_is_too_thin_for_the_grid(solver, effect):
    clamp = {"kind": "held", "lower": [-1, -1, 0.45], "upper": [1, 1, 0.55]}
    data = {"material": {"law": "neo_hookean"}, "forces": [], "time": {"frames": 2}}
    grid = {"accuracy": {"cells": 8, "solver": solver}, "boundaries": [clamp]}
    scene = Scene.from_data({**data, **grid})
    report = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1))).run().report
    (note,) = (note for note in report["notes"] if "The held is 0.8 cells thick" in note)
    assert effect in note


@pytest.mark.parametrize("clamped", [True, False])
def test_note_names_a_wall_that_has_passed_through_clamped_material(clamped):
    """A plate moves into the upper half of a ball, which a clamp holds for some time, or not."""
    down = {"kind": "path", "times": [0, 0.04], "points": [[0, 0, 0], [0, 0, -0.4]]}
    plate = {"kind": "half_space", "point": [0, 0, 1], "normal": [0, 0, -1], "motion": down}
    clamp = {"kind": "held", "lower": [-1, -1, 0.55], "upper": [1, 1, 1], "end": 0.035}
    scene = Scene.from_data(
        {
            "material": {"law": "neo_hookean", "E": 2e5, "density": 200.0, "damping": 1000.0},
            "boundaries": [plate, clamp] if clamped else [plate],
            "forces": [],
            "accuracy": {"cells": 6},
            "time": {"frames": 5, "fps": 100.0},
        }
    )
    report = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1))).run().report
    assert report["complete"]
    messages = [note for note in report["notes"] if "inside the boundary half_space" in note]
    assert len(messages) == clamped
