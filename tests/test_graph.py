"""A frame without the host takes the very substeps that the host's loop takes."""

import numpy as np
import pytest
import warp as wp

from phy124.accuracy.probe import run_pilot
from phy124.boundaries import Ground, Press
from phy124.forces import Acceleration, Gravity, Wind
from phy124.kernels.timestep import BLOCK
from phy124.materials import NeoHookean, Sand
from phy124.monitor.diagnostics import compute_speeds
from phy124.mpm import MEASURE_EVERY, Solver, Unstable
from phy124.mpm.tracks import Sine
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import make_solver
from support.scenes import OF_ONE
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SWING = Acceleration(a=(0, 3, 0), profile=Sine(frequency=3.0), start=0.05, end=0.4)
PRESS = Press()
FRAMES = np.arange(1, 13) / 24


def block(count: int = 1500) -> np.ndarray:
    x = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3)) + [0, 0, 0.9]
    return x[np.lexsort(np.floor(x * 8).T[::-1])]


def solvers(material, *, v=(0.5, 0, -1), **options) -> list[Solver]:
    """The same run twice: by the host's loop, and by the device alone."""
    x = block()
    options = {"boundaries": [Ground()], "forces": [Gravity()], **options}
    speeds = np.tile(np.array(v, float), (len(x), 1))
    model = (x, np.full(len(x), 1 / len(x)), [material])
    return [
        make_solver(*model, dx=1 / 8, v=speeds, threads=1, graph=g, **options)
        for g in (False, True)
    ]


def assert_same(host: Solver, alone: Solver) -> None:
    assert alone.clock.time == host.clock.time and alone.clock.last_dt == host.clock.last_dt
    assert (
        alone.clock.substeps == host.clock.substeps and alone.clock.limiters == host.clock.limiters
    )
    assert alone.clock.extremes == host.clock.extremes
    for name in ("x", "v", "C", "F", "history", "total"):
        first, other = getattr(host.state, name), getattr(alone.state, name)
        np.testing.assert_array_equal(first.numpy(), other.numpy(), err_msg=name)


@pytest.mark.parametrize(
    "material, options",
    [
        (NeoHookean(E=3e4), {}),
        # Without the ground: a graph's kernel for grid and ground rounds otherwise in float64.
        pytest.param(
            NeoHookean(E=1e5), {"precision": "float64", "boundaries": []}, marks=pytest.mark.slow
        ),
        (NeoHookean(E=3e4), {"ceiling": 1e-3}),
        pytest.param(NeoHookean(E=3e4), {"simd": False}, marks=pytest.mark.slow),
        (NeoHookean(E=3e4), {"boundaries": [Ground(), PRESS]}),
        (NeoHookean(E=3e4), {"forces": [Gravity(), SWING]}),
        (Sand(), {}),
    ],
)
def test_the_device_alone_takes_the_substeps_of_the_host(material, options):
    host, alone = solvers(material, **options)
    for until in FRAMES:
        host.advance(until)
        alone.advance(until)
    assert_same(host, alone)
    assert alone.timings["graph"][1] > 100, "the graph has hardly been used"


def test_graph_leaves_moving_windows_and_violence_to_host():
    host, alone = solvers(NeoHookean(E=3e4), v=(20, 0, 0))
    for until in FRAMES:
        host.advance(until)
        alone.advance(until)
    assert_same(host, alone)
    assert "speed" in host.clock.limiters


def captured_names(monkeypatch, solver: Solver) -> list[list[str]]:
    """Return the launches that a graph captures, in each of its branches."""
    names: list[str] = []
    branches = []

    def note(owner, method, name):
        call = getattr(owner, method)

        def noted(*arguments, **options):
            names.append(name)
            return call(*arguments, **options)

        monkeypatch.setattr(owner, method, noted)

    def capture_if(condition, on_true, on_false=None):
        for take in filter(None, (on_true, on_false)):
            start = len(names)
            take()
            branches.append(names[start:])
            del names[start:]

    note(wp.Launch, "launch", "kernel")
    note(wp.array, "zero_", "fill")
    note(wp.array, "fill_", "fill")
    note(wp, "copy", "copy")
    monkeypatch.setattr(wp, "capture_if", capture_if)
    monkeypatch.setattr(wp, "capture_while", lambda condition, body: body())
    names.clear()
    launches = list(solver._launches())
    assert all(isinstance(launch.__self__, wp.Launch) for launch in launches)
    solver._graph._capture([lambda: names.append("kernel")] * len(launches))
    return [*branches, names]


def test_a_substep_is_four_kernels_without_copies(monkeypatch):
    """Scatter, update with the ground, gather, and the choice of the next substep."""
    _, alone = solvers(NeoHookean(E=3e4))
    alone.advance(FRAMES[0])
    block, measurement, single, others = captured_names(monkeypatch, alone)
    assert measurement == ["fill", "kernel"]
    assert block == (4 * BLOCK - 1) * ["kernel"] + measurement
    assert single == 3 * ["kernel"]
    assert others == 2 * ["kernel"], "the choice before the loop and at the end of its body"


def test_wind_runs_in_the_graph():
    host, alone = solvers(NeoHookean(E=3e4), forces=[Wind(v=(3, 0, 0))])
    host.advance(0.1)
    alone.advance(0.1)
    assert_same(host, alone)
    assert "graph" in alone.timings


def test_a_particle_that_is_no_number_stops_the_graph():
    _, alone = solvers(NeoHookean(E=3e4))
    alone.advance(FRAMES[0])
    v = alone.state.v.numpy()
    v[7] = np.nan
    alone.state.v.assign(v)
    with pytest.raises(Unstable, match="NaN or infinite"):
        alone.advance(FRAMES[1])


def test_callback_after_each_visit_of_the_host():
    _, alone = solvers(NeoHookean(E=3e4))
    calls = []
    alone.advance(0.25, after=lambda: calls.append(alone.clock.time))
    assert calls[-1] == 0.25 and len(calls) < alone.clock.substeps / 5


def test_after_is_called_once_per_substep():
    host, alone = solvers(NeoHookean(E=3e4))
    calls = []
    alone.advance(FRAMES[0], after=lambda: calls.append(alone.clock.substeps), each=True)
    host.advance(FRAMES[0])
    assert calls == [*range(1, alone.clock.substeps + 1)]
    assert "graph" not in alone.timings
    np.testing.assert_array_equal(alone.state.x.numpy(), host.state.x.numpy())


def test_the_host_looks_before_the_strain_of_a_frame_grows_large(monkeypatch):
    looks = []
    for strain in (0.02, np.inf):
        monkeypatch.setattr("phy124.mpm.graph.STRAIN", strain)
        _, alone = solvers(NeoHookean(E=3e4))
        times = []
        alone.advance(0.5, after=lambda alone=alone, times=times: times.append(alone.clock.time))
        looks.append(len(times))
    assert looks[0] > 1.5 * looks[1]


def test_graph_reports_the_fastest_instant():
    """A bounce is over within one visit; sleep and the watchdog must see how fast it was."""
    seen = []
    for solver in solvers(NeoHookean(E=3e4)):
        peaks = []
        solver.advance(0.35, after=lambda s=solver, p=peaks: p.append(s.clock.recent[:2]))
        seen.append(np.max(peaks, axis=0))
    np.testing.assert_array_equal(*seen)
    assert seen[1][0] > 1.5 * compute_speeds(solver.state).max()


def test_the_host_may_stop_a_run_every_few_substeps(monkeypatch):
    monkeypatch.setattr("phy124.mpm.graph.MOST", 7)
    host, alone = solvers(NeoHookean(E=3e4))
    taken = []
    host.advance(0.25)
    alone.advance(0.25, after=lambda: taken.append(alone.clock.substeps))
    assert_same(host, alone)
    assert np.diff([0, *taken]).max() <= 7


def test_particles_that_leave_the_grid_do_not_end_the_graph():
    x = np.concatenate([block(), [[60.0, 0, 40.0]]])
    v = np.tile([0.5, 0, -1.0], (len(x), 1))
    runs = [
        make_solver(
            x,
            np.full(len(x), 1 / len(x)),
            [NeoHookean(E=3e4)],
            dx=1 / 8,
            v=v,
            threads=1,
            graph=graph,
            boundaries=[Ground()],
            forces=[Gravity()],
        )
        for graph in (False, True)
    ]
    for solver in runs:
        for until in FRAMES[:6]:
            solver.advance(until)
    assert runs[1].outliers.count == 1
    assert_same(*runs)
    taken = runs[1].timings["graph"][1]
    assert taken > 5 * runs[1].clock.substeps, "it was left to the host"


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("drop", marks=pytest.mark.slow),
        "press",
        pytest.param("wind", marks=pytest.mark.slow),
    ],
)
def test_a_forecast_counts_the_substeps_of_the_device(name, monkeypatch):
    scene = Scene.named(name).replaced({"accuracy": {"cells": 8}, "time.frames": 5})
    made = []
    for alone in (False, True):
        monkeypatch.setattr("phy124.mpm.solver.usable", lambda device, alone=alone: alone)
        pilot = run_pilot(ball(400), scene)
        made.append(pilot.substeps(8))
        run = Simulation(prepare(ball(400), scene))
        run.run()
        assert made[-1][0] == pytest.approx(run.solver.clock.substeps, rel=0.1)
    assert made[0] == made[1]


def runs_as_graph(solver):
    """Whether a solver ran as a graph, unless the host decides in each of its substeps."""
    # The host tries what may push suddenly substep by substep, and solves for the pressure.
    by_host = solver.projects or solver.rejection.sudden(solver.clock)
    return by_host or "graph" in solver.timings


@pytest.mark.parametrize("name", OF_ONE)
def test_every_preset_moves_the_same_by_the_device_alone(name, monkeypatch):
    # The device measures its limits every four substeps.
    changes = {"time.frames": 2, "checks.measure": MEASURE_EVERY}
    scene = Scene.named(name).replaced({"accuracy": {"cells": 8, "solver": "mpm"}, **changes})
    runs = []
    for alone in (False, True):
        monkeypatch.setattr("phy124.mpm.solver.usable", lambda device, alone=alone: alone)
        runs.append(Simulation(prepare(ball(500), scene)))
        runs[-1].run()
    host, device = (run.solver for run in runs)
    assert_same(host, device)
    assert runs_as_graph(device)
    gains = [run.report()["balance"]["energy_gain"] for run in runs]
    assert gains[0] == gains[1]


@pytest.mark.gpu
@pytest.mark.parametrize("name", OF_ONE)
def test_cuda_moves_as_the_cpu_does(name, gpu):
    accuracy = {"cells": 8, "solver": "mpm"}
    scene = Scene.named(name).replaced({"accuracy": accuracy, "time.frames": 6})
    cpu, cuda = (
        Simulation(prepare(ball(500), scene, RunContext(device=device))) for device in ("cpu", gpu)
    )
    cpu.run()
    cuda.run()
    assert runs_as_graph(cuda.solver)
    apart = cuda.frames[-1].gaussians.means - cpu.frames[-1].gaussians.means
    assert np.abs(apart).max() < 1e-3
