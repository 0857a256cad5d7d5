"""Energy losses of bodies on lattices by cause, compared with known results."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.boundaries import HalfSpace, Held
from phy124.boundaries.motion import Path
from phy124.budget.effects import Effects
from phy124.errors import InputError
from phy124.forces import Acceleration, Grab, Gravity, Wind
from phy124.kernels.work import WORK
from phy124.materials import FixedCorotated, Hencky, NeoHookean
from phy124.monitor.lattice import LatticeTotals
from phy124.monitor.lattice_dissipation import LatticeDissipation
from phy124.mpm import FreeBody, Pair
from phy124.pipeline.report_keys import Energy
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.lattices import choose_solver
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import fill_solid, surface_of_ball
from support.lattices import DAMPED, DX, SOFT, block, fork_at, make_bodies
from support.runs import resumed

pytestmark = pytest.mark.usefixtures("coarse_solids")

G = 9.81
CUBE = (0.3, 0.3, 0.3)


class Balance:
    """The works on a body while it moves, with the change of its energy."""

    def __init__(self, solver, until, *, rounding=1e-12):
        self.divided = LatticeDissipation()
        self.divided.bind(solver)
        self.divided.open()
        totals, mass = LatticeTotals(solver), solver.model.total_mass
        self.first = totals.read(solver.clock)
        start = solver.clock.time - solver.clock.behind
        first = self.first.middle - solver.clock.behind * self.first.momentum
        solver.advance(until)
        self.last = totals.read(solver.clock)
        self.times = np.array([start, solver.clock.time - solver.clock.behind])
        self.way = (self.last.middle - solver.clock.behind * self.last.momentum - first) / mass
        self.works = solver.energies.read()
        for name, value in self.divided.divide(self.first, self.last).items():
            setattr(self, name, value)
        exchanged = sum(map(abs, self.works)) + self.last.kinetic
        assert abs(self.unexplained) < rounding * exchanged

    def nothing_but(self, *names, below=1e-12):
        """Check that no other cause did work."""
        scale = max(map(abs, self.works))
        others = {k: w for k, w in self.works._asdict().items() if k not in names}
        assert max(map(abs, others.values())) <= below * scale, others


@pytest.mark.parametrize(("precision", "rounding"), [("float64", 1e-13), ("float32", 1e-6)])
def test_fall_turns_the_work_of_gravity_into_speed(precision, rounding):
    pull = {"forces": [Gravity()], "precision": precision}
    fall = Balance(make_bodies([block(CUBE)], **pull), 0.2, rounding=rounding)
    assert fall.kinetic == pytest.approx(fall.forces, rel=rounding)
    speed = fall.last.momentum[2] / 27
    assert fall.forces == pytest.approx(27 * speed**2 / 2, rel=10 * rounding)
    fall.nothing_but("forces", below=rounding)


def swing(damping, until):
    """A bar that vibrates along its axis in its lowest mode, with a period of 0.4 s."""
    bar = block((2.0, 0.2, 0.2))
    solver = make_bodies([bar], NeoHookean(E=1e5, nu=0.0, density=1000, damping=damping))
    solver.carry_nodes(lambda x, v: (x, 0.01 * np.outer(np.cos(math.pi / 2 * x[:, 0]), [1, 0, 0])))
    return Balance(solver, until)


def test_undamped_swing_keeps_the_sum_of_both_energies():
    free = swing(0.0, 0.5)
    assert free.works.elastic == pytest.approx(free.kinetic, rel=1e-12)
    assert free.elastic > 0.95 * free.first.kinetic
    assert abs(free.kinetic + free.elastic) < 2e-4 * free.first.kinetic
    assert free.lost == pytest.approx(free.substeps, abs=1e-12 * free.first.kinetic)
    free.nothing_but("elastic")


def test_damped_swing_loses_what_its_mode_loses():
    """rho u'' = E u_xx + 2 eta u'_xx: energies decay with exp(-2 k^2 eta t / rho)."""
    damped = swing(120.0, 0.8)
    rate = 2 * (math.pi / 2) ** 2 * 120.0 / 1000
    expected = damped.first.kinetic * (1 - math.exp(-rate * 0.8))
    assert damped.material == pytest.approx(expected, rel=0.02)
    assert abs(damped.numerical) < 2e-3 * damped.material
    damped.nothing_but("elastic", "viscous")


@pytest.mark.parametrize("law", [Hencky, pytest.param(FixedCorotated, marks=pytest.mark.slow)])
def test_each_law_stores_the_work_of_its_stress(law):
    solver = make_bodies([block(CUBE)], law(E=1e5, nu=0.3, density=1000, damping=20.0))
    solver.carry_nodes(lambda x, v: (x, x * [1.0, -0.5, 0.2]))
    stretched = Balance(solver, 0.02)
    assert stretched.elastic > 0.05 * stretched.first.kinetic
    assert abs(stretched.substeps) < 0.01 * stretched.elastic
    stretched.nothing_but("elastic", "viscous")


@pytest.mark.parametrize(
    "law", [NeoHookean, Hencky, pytest.param(FixedCorotated, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("stretch", [0.7, -0.4])
def test_power_of_the_stress_is_the_rate_of_the_energy(law, stretch, rng):
    """Points inside out, too: the forces of laws without a barrier have the sign of det F."""
    solver = make_bodies([block(CUBE)], law(E=1e5, nu=0.3, density=1000))
    rest, totals = solver.lattice.x, LatticeTotals(solver)
    clock = SimpleNamespace(lag=lambda power, momentum: power)
    way = rest @ rng.normal(size=(3, 3))

    def read(time):
        solver.carry_nodes(lambda x, v: (rest * [1, 1, stretch] + time * way, way))
        return totals.read(clock)

    before, now, after = (read(time) for time in (-1e-5, 0.0, 1e-5))
    assert bool(now.inverted) == (stretch < 0)
    assert now.lag == pytest.approx((after.elastic - before.elastic) / 2e-5, rel=1e-4)


def test_slope_rubs_with_friction_times_weight_times_way():
    angle = math.radians(30)
    pull = Gravity(g=(G * math.sin(angle), 0, -G * math.cos(angle)))
    floor = HalfSpace(friction=0.2)
    solver = make_bodies([block((0.4, 0.3, 0.2))], DAMPED, forces=[pull], boundaries=[floor])
    solver.advance(0.4)
    sliding = Balance(solver, 0.6)
    weight = 24 * G * math.cos(angle)
    assert sliding.friction == pytest.approx(0.2 * weight * sliding.way[0], rel=2e-3)
    assert sliding.contact == pytest.approx(sliding.friction, rel=2e-3)
    sliding.nothing_but("forces", "friction", below=2e-3)


def moved(wall, solver, balance):
    """The part of its path that a wall moved, from the first to the last time of the velocities."""
    way = np.diff(wall.track(solver.model).values(balance.times), axis=0)
    return np.abs(way).sum() / np.abs(wall.motion.points[1]).sum()


def test_rising_floor_does_the_work_of_the_weight():
    floor = HalfSpace(motion=Path(times=(0.0, 1.0), points=((0, 0, 0), (0, 0, 0.2))))
    solver = make_bodies([block(CUBE)], DAMPED, forces=[Gravity()], boundaries=[floor])
    solver.advance(0.3)
    lifted = Balance(solver, 0.6)
    assert lifted.forces == pytest.approx(-27 * G * lifted.way[2], rel=1e-3)
    assert lifted.walls == pytest.approx(27 * G * 0.2 * moved(floor, solver, lifted), rel=0.02)
    assert lifted.walls == pytest.approx(lifted.kinetic - lifted.forces, rel=0.01)
    lifted.nothing_but("walls", "forces", below=0.01)


def test_moving_floor_and_its_slip_add_up():
    """A belt drags a block: the belt's work heats the contact and speeds the block up."""
    belt = HalfSpace(friction=0.3, motion=Path(times=(0.0, 0.8), points=((0, 0, 0), (1.6, 0, 0))))
    solver = make_bodies([block((0.4, 0.3, 0.2))], DAMPED, forces=[Gravity()], boundaries=[belt])
    solver.advance(0.3)
    dragged = Balance(solver, 0.5)
    force, ahead = 0.3 * 24 * G, 1.6 * moved(belt, solver, dragged)
    assert dragged.walls == pytest.approx(force * ahead, rel=5e-3)
    assert dragged.friction == pytest.approx(force * (ahead - dragged.way[0]), rel=5e-3)
    assert dragged.kinetic == pytest.approx(dragged.walls - dragged.friction, rel=5e-3)
    dragged.nothing_but("walls", "friction", below=5e-3)


def test_bounce_loses_at_the_impact_and_by_substeps_alone():
    solver = make_bodies(
        [block(CUBE, low=(0, 0, 0.05))], SOFT, v=[(0, 0, -0.5)], boundaries=[HalfSpace()]
    )
    bounce = Balance(solver, 0.2)
    assert bounce.last.momentum[2] > 0
    assert bounce.impacts > 0 and bounce.material == 0
    parts = bounce.impacts + bounce.friction + bounce.substeps
    assert parts == pytest.approx(bounce.lost, rel=1e-9)
    bounce.nothing_but("elastic", "impacts", "friction")


def test_shock_takes_energy_only_in_fast_compression():
    speed = 0.8 * SOFT.wave_speed()
    solver = make_bodies([block(CUBE)], SOFT, v=[(0, 0, -speed)], boundaries=[HalfSpace()])
    hit = Balance(solver, 0.01)
    assert solver.clock.shocked > 0
    assert hit.shock > 0.05 * hit.first.kinetic
    assert hit.numerical == pytest.approx(hit.shock + hit.substeps, rel=1e-9)


def test_clamp_that_pulls_does_the_work_that_is_stored():
    """A bar without contraction is pulled slowly: E A d^2 / (2 L)."""
    pull = Path(times=(0.0, 0.5), points=((0, 0, 0), (0.02, 0, 0)))
    walls = [Held(lower=(-1, -1, -1), upper=(0.2, 1, 1))]
    walls += [Held(lower=(0.8, -1, -1), upper=(2, 1, 1), motion=pull)]
    material = NeoHookean(E=1e5, nu=0.0, density=1000, damping=500.0)
    drawn = Balance(make_bodies([block((1.0, 0.2, 0.2))], material, boundaries=walls), 0.5)
    assert drawn.held == pytest.approx(1e5 * 0.04 * 0.02**2 / 2 / 0.6, rel=0.02)
    assert drawn.held - drawn.impacts - drawn.material == pytest.approx(drawn.elastic, rel=0.02)
    drawn.nothing_but("held", "elastic", "viscous", "impacts")


@pytest.mark.parametrize(
    "force",
    [
        Acceleration(a=(3, 0, 0), region=Region(lower=(-1, -1, 0.1), upper=(1, 1, 1))),
        Wind(v=(4, 0, 1), rate=5.0),
        Grab(point=(0.1, 0.1, 0.1), radius=0.2, times=(0, 0.1), targets=((0, 0, 0), (0.1, 0, 0))),
    ],
    ids=["region", "wind", "grab"],
)
def test_forces_on_points_do_all_the_work(force):
    pushed = Balance(make_bodies([block((0.275, 0.3, 0.3), per=4)], forces=[force, Gravity()]), 0.1)
    assert pushed.forces > 0.05
    pushed.nothing_but("forces", "elastic", "viscous")


def test_objects_rub_with_friction_times_weight_times_way():
    angle, g = math.radians(20), 0.5
    pull = Gravity(g=(g * math.sin(angle), 0, -g * math.cos(angle)))
    solids = [block((1.0, 0.5, 0.2)), block((0.375, 0.3, 0.3), low=(0.125, 0.125, 0.2), per=4)]
    solver = make_bodies(solids, held=[0], pairs=[Pair(0, 1, 0.2)], forces=[pull])
    solver.advance(0.7)
    sliding = Balance(solver, 1.0)
    weight, mass = 33.75 * g * math.cos(angle), solver.model.total_mass
    assert sliding.pairs == pytest.approx(0.2 * weight * sliding.way[0] * mass / 33.75, rel=0.01)
    sliding.nothing_but("forces", "pairs", below=0.01)


def test_objects_of_two_materials_collide():
    solids = [block(CUBE), block(CUBE, low=(0.32, 0.05, 0.05), per=4)]
    laws = DAMPED, Hencky(E=5e4, nu=0.2, density=1000, damping=20.0)
    solver = make_bodies(solids, *laws, v=[(0.5, 0, 0), (-0.5, 0, 0)])
    hit = Balance(solver, 0.12)
    assert hit.pairs > 0.02 * hit.first.kinetic and hit.material > 0.02 * hit.first.kinetic
    hit.nothing_but("elastic", "viscous", "pairs")


def test_prongs_that_clap_lose_energy_to_self_contact():
    fork = fill_solid(fork_at, (-0.1, -0.1, -0.1), (0.5, 0.3, 0.9), DX / 2)
    solver = make_bodies([fork], boundaries=[Held(lower=(-1, -1, -1), upper=(1, 1, 0.28))])
    solver.carry_nodes(lambda x, v: (x, v - 6 * np.sign(x - [0.2, 0, 0]) * [1, 0, 0]))
    clap = Balance(solver, 0.03)
    assert solver.meetings.of_bodies[0].most > 0
    assert clap.itself > 0.01 * clap.first.kinetic
    clap.nothing_but("elastic", "viscous", "itself", "impacts", "shock")


def test_impulses_on_held_nodes_do_no_work():
    """A moving clamp holds half of a block that a solid and the floor touch."""
    steel = FreeBody("ball", "sphere", (0.2,) * 3, (0.2, 0.15, 0.5), velocity=(0, 0, -3))
    path = Path(times=(0.0, 0.2), points=((0, 0, 0), (0.1, 0, -0.03)))
    walls = [Held(lower=(0.2, -1, -1), upper=(1, 1, 1), motion=path), HalfSpace(friction=0.4)]
    both = Balance(make_bodies([block(CUBE)], DAMPED, free=[steel], boundaries=walls), 0.1)
    assert min(abs(both.solids), abs(both.held), both.friction) > 0.1


def test_clamp_works_on_another_body_that_its_nodes_push():
    """A clamp moves a block whole; the block pushes another one, which only loses energy to it."""
    path = Path(times=(0.0, 0.2), points=((0, 0, 0), (0.4, 0, 0)))
    clamp = Held(lower=(-1, -1, -1), upper=(0.4, 1, 1), motion=path)
    solids = [block(CUBE), block(CUBE, low=(0.55, 0.05, 0.05), per=4)]
    solver = make_bodies(solids, pairs=[Pair(0, 1, 0.2)], boundaries=[clamp])
    before = solver.walls.sums.numpy()[0, WORK]
    pushed = Balance(solver, 0.2)
    assert pushed.held > 5 * pushed.pairs > 0
    assert pushed.kinetic + pushed.elastic == pytest.approx(pushed.held - pushed.lost, rel=1e-9)
    work = solver.walls.sums.numpy()[0, WORK] - before
    assert work == pytest.approx(pushed.held - pushed.impacts, rel=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_clamps_that_overlap_and_part_explain_all_work(order):
    """A clamp at the side is still; one at the top pulls, and has a corner in common with it."""
    path = Path(times=(0.0, 0.2), points=((0, 0, 0), (0.02, 0, 0.02)))
    still = Held(lower=(-1, -1, -1), upper=(0.15, 1, 1))
    pulls = Held(lower=(-1, -1, 0.2), upper=(1, 1, 1), motion=path)
    parted = Balance(make_bodies([block(CUBE)], DAMPED, boundaries=[still, pulls][::order]), 0.05)
    assert parted.held > 0.1
    parted.nothing_but("held", "elastic", "viscous", "impacts")


def test_floor_that_moves_with_a_clamp_has_no_friction():
    path = Path(times=(0.0, 0.2), points=((0, 0, 0), (0.1, 0, 0.05)))
    walls = [Held(lower=(0.2, -1, -1), upper=(1, 1, 1), motion=path)]
    walls += [HalfSpace(friction=2.0, motion=path)]
    both = Balance(make_bodies([block(CUBE)], DAMPED, forces=[Gravity()], boundaries=walls), 0.1)
    assert both.friction < 0.05 * both.walls


def test_free_solid_works_on_a_body():
    steel = FreeBody("ball", "sphere", (0.2,) * 3, (0.65, 0.25, 0.2), velocity=(-1, 0, 0))
    hit = Balance(make_bodies([block((0.4, 0.4, 0.4))], free=[steel]), 0.2)
    assert hit.solids > 0.1
    assert hit.kinetic + hit.elastic == pytest.approx(hit.solids - hit.lost, rel=1e-12)
    hit.nothing_but("solids", "elastic", "viscous")


@pytest.mark.parametrize("vectors", [True, False])
@pytest.mark.parametrize("threads", [1, 2])
def test_frames_are_the_same_with_and_without_sums(vectors, threads):
    """In float32: on vector units, and without them."""
    states = []
    for on in (True, False):
        walls, forces = [HalfSpace(friction=0.3)], [Gravity(), Wind(v=(2, 0, 0), rate=3.0)]
        options = {"precision": "float32", "vectors": vectors, "v": [(1, 0, -9)]}
        options |= {"boundaries": walls, "forces": forces, "threads": threads}
        solver = make_bodies([block((0.375, 0.3, 0.3), low=(0, 0, 0.05), per=4)], DAMPED, **options)
        if on:
            hit = Balance(solver, 0.03, rounding=3e-6)
            assert hit.impacts > 0 and hit.material > 0 and hit.shock > 0
        else:
            solver.advance(0.03)
        assert ("dissipation" in solver.timings) == on
        states.append([solver.state.x.numpy(), solver.state.v.numpy(), solver.state.F.numpy()])
    assert all(map(np.array_equal, *states))


def stacked(**changes):
    """A soft ball that falls on another one, which becomes stiffer; a plate presses both."""
    rubber = {"law": "neo_hookean", "E": 5e4, "damping": 20.0}
    plate = {"kind": "half_space", "point": [0, 0, 2.15], "normal": [0, 0, -1]}
    plate["motion"] = {"kind": "path", "times": [0.0, 0.3], "points": [[0, 0, 0], [0, 0, -0.55]]}
    return Scene.from_data(
        {
            "object": {"name": "base"},
            "material": rubber,
            "objects": [{"name": "ball", "on": "base", "lift": 0.05, "material": rubber}],
            "boundaries": [{"kind": "ground", "friction": 0.3}, plate],
            "stiffness_profile": {"kind": "ramp", "duration": 0.3, "first": 1.0, "last": 2.0},
            "accuracy": {"cells": 6},
            "checks": {"energy": True},
            "time": {"frames": 8},
            **changes,
        }
    )


def simulate(scene, threads=1):
    return Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=threads)))


def test_report_divides_the_loss_of_several_objects(tmp_path):
    paused = simulate(stacked())
    again = resumed(paused, 4, tmp_path / "pause.safetensors")
    report = paused.run().report
    whole = report["energy"]
    assert whole.keys() <= Energy.__annotations__.keys()
    assert whole["pairs"] > 0 and whole["walls"] > 0 and whole["stiffening"] > 0
    assert abs(whole["unexplained"]) < 1e-5 * whole["turnover"]
    assert abs(whole["substeps"]) < 0.02 * whole["turnover"]
    parts = {
        "lost": ("material", "contact", "numerical"),
        "contact": ("friction", "impacts", "pairs", "itself"),
        "numerical": ("shock", "substeps", "unexplained"),
    }
    for name, names in parts.items():
        assert sum(whole[part] for part in names) == pytest.approx(whole[name], abs=1e-12)
    works = sum(whole[name] for name in ("forces", "walls", "held", "solids", "stiffening"))
    assert whole["kinetic"] + whole["elastic"] == pytest.approx(works - whole["lost"], abs=1e-12)
    assert "work of forces, stress and contact" in report["effects"]["ran"]
    assert again.run().report["energy"] == whole
    off = simulate(stacked(checks={"energy": False}, time={"frames": 2})).run()
    assert "energy" not in off.report


def test_changes_in_a_live_run_keep_the_sums():
    """The work of a clamp that a change removes stays in the sums."""
    hold = {"kind": "held", "lower": [-2, -2, 0.6], "upper": [2, 2, 2]}
    hold["motion"] = {"kind": "path", "times": [0.0, 0.3], "points": [[0, 0, 0], [0.3, 0, 0]]}
    before = stacked(boundaries=[hold], objects=[], stiffness_profile=None)
    scene = before.replaced({"boundaries": [{"kind": "ground"}]})
    setup = prepare(surface_of_ball(100), before, RunContext(threads=1))
    run = Simulation(setup)
    for _ in range(3):
        run.step()
    first = run.report()["energy"]
    run.change(scene)
    for _ in range(3):
        run.step()
    last = run.report()["energy"]
    assert last["held"] == pytest.approx(first["held"], rel=1e-12) and first["held"] > 0
    assert abs(last["unexplained"]) < 1e-5 * last["turnover"]


GUST = {"kind": "acceleration", "a": [0.0, 4.5, 0.0], "end": 0.1}
WIND = {"kind": "wind", "v": [0.0, 1.0, 0.0], "rate": 5.0}
UPPER = {**GUST, "region": {"lower": [0.0, 0.0, 0.5], "upper": [1.0, 1.0, 1.0]}}


@pytest.mark.parametrize(
    "forces",
    [[GUST], [UPPER], [WIND], [{**WIND, "v": [0.0, -1.0, 0.0]}, GUST]],
    ids=["uniform", "region", "wind", "wind and gust"],
)
def test_balance_and_works_agree_on_what_a_clamped_body_loses(forces):
    """Forces bend an undamped ball that is held at its foot, so that next to nothing is lost."""
    rubber = {"law": "neo_hookean", "E": 5e4}
    shape = {"objects": [], "stiffness_profile": None, "material": rubber}
    scene = stacked(**shape, boundaries=[{"kind": "foot", "fraction": 0.3}], forces=forces)
    report = simulate(scene, threads=2).run().report
    lost = report["energy"]["lost"] / report["energy"]["turnover"]
    assert report["balance"]["energy_gain"] == pytest.approx(-lost, abs=1e-4)
    assert not any(math.copysign(1, value) < 0 for value in report["energy"].values() if value == 0)


@pytest.mark.parametrize("kind", [{"held": True}, {"motion": {"kind": "free", "density": 3000.0}}])
def test_balance_counts_the_impulses_of_fixed_and_of_free_objects(kind):
    """A ball that is pushed by another object receives no more work of gravity for that."""
    shape = {"material": {"law": "neo_hookean", "E": 1e5}, "stiffness_profile": None}
    other = {"name": "ball", "on": "base", "lift": 0.02, "size": 0.6, "shape": "sphere", **kind}
    other["velocity"] = [0, 0, 0] if "held" in kind else [0, 0, -1.5]
    base = {"name": "base", "velocity": [0, 0, 2.0 if "held" in kind else 0.0]}
    scene = stacked(**shape, object=base, objects=[other], boundaries=[{"kind": "ground"}])
    report = simulate(scene).run().report
    energy = report["energy"]
    inside = energy["lost"] - energy["friction"] - energy["impacts"]
    assert report["balance"]["energy_gain"] == pytest.approx(-inside / energy["turnover"], abs=1e-4)


def test_balance_closes_in_frames_of_two_substeps():
    """A wind against gravity takes a part of the energy before the first frame ends."""
    soft = {"law": "neo_hookean", "E": 1e4, "density": 3000.0}
    shape = {"objects": [], "boundaries": [], "stiffness_profile": None, "material": soft}
    forces = [{"kind": "gravity"}, {"kind": "wind", "v": [0.0, 0.0, 1.0], "rate": 35.0}]
    scene = stacked(**shape, forces=forces, time={"frames": 3}, checks={})
    run = simulate(scene)
    report = run.run().report
    assert report["complete"] and run.scene.on_lattice and run.solver.clock.substeps < 10
    assert abs(report["balance"]["energy_gain"]) < 1e-5


SAND = {"name": "sand", "shape": "box", "sides": [1.0, 1.0, 1.0], "material": {"law": "sand"}}


@pytest.mark.parametrize(
    "changes", [{"objects": [{**SAND, "place": [3.0, 0.0]}]}, {"accuracy": {"solver": "mpm"}}]
)
def test_only_lattices_alone_divide_the_loss_of_objects(changes):
    with pytest.raises(InputError, match=r"checks\.energy = true: it does not support objects"):
        stacked(**changes)


def test_energy_checks_stay_on_lattices_on_a_gpu():
    assert choose_solver(stacked(), "cuda:0").on_lattice
    alone = stacked(objects=[], boundaries=[], stiffness_profile=None)
    assert not choose_solver(alone, "cuda:0").on_lattice
    effects = Effects.of(alone.replaced({"accuracy.precision": "float64"}))
    (row,) = (row for row in effects.left_out if row.name == "rest lattice")
    assert row.why.startswith("accuracy.precision is float64")
