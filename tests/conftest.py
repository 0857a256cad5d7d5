"""Fixtures that all tests share: golden data, tiny objects, Warp without messages."""

import gc
import os
import signal
import sys
import tempfile

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A background job of a shell ignores Ctrl-C, and so would all that the tests send it to.
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    # The same holds for the end of the terminal, which nohup ignores.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
os.environ.setdefault("OMP_NUM_THREADS", "1")  # two test processes share two cores

from collections.abc import Iterator
from contextlib import nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from phy124.gaussians import Gaussians
from phy124.runtime.startup import start
from support.domains import reserved_domain
from support.gpu_module import GpuModule
from support.solids import coarse

ROOT = Path(__file__).parents[1]
GOLDEN = Path(os.environ.get("PHY124_GOLDEN", ROOT / "../shared/golden"))
OBJECTS = Path(os.environ.get("PHY124_OBJECTS", ROOT / "../shared/objects"))
EXAMPLES = sorted((ROOT / "demo/examples").glob("*.png"))
IMPORTED = pytest.StashKey[frozenset[str]]()


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Collecting imports much and throws nothing away, so there is no garbage to look for."""
    gc.disable()


def pytest_collection_finish(session: pytest.Session) -> None:
    """From here on garbage is collected again, but not looked for among what was imported.

    It is looked for less often than by default, which takes each test process 5 % less time.
    """
    session.config.stash[IMPORTED] = frozenset(sys.modules)
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


def pytest_pycollect_makemodule(module_path: Path, parent: Any) -> pytest.Module | None:
    """Let a run of the GPU tests alone do without the packages of the page and of the bridge.

    Every other run needs all packages, so that none is skipped by mistake.
    """
    if parent.config.getoption("markexpr") != "gpu":
        return None
    return GpuModule.from_parent(parent, path=module_path)


@pytest.fixture(scope="session", autouse=True)
def each_module_is_compiled_once() -> None:
    """Tests that launch kernels themselves wait for other processes' compilations, too."""
    start()


@pytest.fixture(scope="session", autouse=True)
def messages_call_the_program_phy124() -> Iterator[None]:
    """They name the program that was started, which `python -m pytest` is not, either."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["pytest", *sys.argv[1:]])
        yield


@pytest.fixture(scope="session", autouse=True)
def bodies_of_many_tests_are_set_up_once() -> Iterator[None]:
    """Tests simulate few bodies again and again; their set-up takes longer than their motion."""
    from phy124.particles import lattice, solid, thickness

    cached = ((lattice, "_lattices_of"), (thickness, "compliance"), (thickness, "local_thickness"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solid, "MEMORY", 4 * solid.MEMORY)
        for module, name in cached:
            patch.setattr(module, name, lru_cache(16)(getattr(module, name).__wrapped__))
        yield


@pytest.fixture(autouse=True)
def examples_are_left_alone() -> Iterator[None]:
    """Tests do not change the example pictures, not even their times: Chromium sends no file that
    has changed since it was chosen, and the tests of the page run at the same time."""
    before = [path.stat().st_mtime_ns for path in EXAMPLES]
    yield
    assert [path.stat().st_mtime_ns for path in EXAMPLES] == before, "copy the example"


@pytest.fixture
def coarse_solids(request) -> Iterator[None]:
    """Solids of an eighth of the voxels, for quick tests of all but the particles: finding the
    voxels of a solid takes longer than most of these tests."""
    with nullcontext() if request.node.get_closest_marker("slow") else coarse():
        yield


@pytest.fixture(scope="session")
def real_objects() -> Path:
    """Folder of real objects as Gaussians, with their licences; skips where it is absent."""
    if not OBJECTS.is_dir():
        pytest.skip(f"no real objects in {OBJECTS}; PHY124_OBJECTS names their folder")
    return OBJECTS


@pytest.fixture(scope="session")
def golden() -> Path:
    """Folder of outputs of the original programs; skips where it is absent."""
    if not GOLDEN.is_dir():
        pytest.skip(f"no golden data at {GOLDEN} (set PHY124_GOLDEN)")
    return GOLDEN


def pytest_addoption(parser: pytest.Parser) -> None:
    what = "where tests marked gpu run; cpu rehearses them, with the graphs that a GPU uses"
    parser.addoption("--device", default="cuda:0", help=what)


@pytest.fixture
def gpu(request, monkeypatch) -> str:
    """The device of tests marked gpu; skips where it is absent.

    The CPU uses graphs, too, so that both devices take the same substeps.
    """
    name = request.config.getoption("--device")
    if name != "cpu" and not wp.is_cuda_available():
        pytest.skip("this machine has no CUDA device (--device cpu rehearses)")
    monkeypatch.setattr("phy124.mpm.solver.usable", lambda device: True)
    return name


@pytest.fixture(scope="session")
def imported_by_collecting(request) -> frozenset[str]:
    """Names of the modules that are imported before the first test."""
    return request.config.stash[IMPORTED]


@pytest.fixture(scope="session")
def gradio() -> Any:
    """Gradio, imported in a few processes only, as the page does it: in two thirds of the time."""
    from demo.__main__ import import_gradio

    import_gradio()
    return sys.modules["gradio"]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def three_gaussians() -> Gaussians:
    """Three Gaussians of plain red, green and blue, each turned and stretched differently."""
    quats = np.array([[1, 0, 0, 0], [0.5, 0.5, 0.5, 0.5], [0.8, 0.6, 0, 0]])
    scales = np.array([[0.1, 0.05, 0.02], [0.08, 0.08, 0.01], [0.03, 0.06, 0.09]])
    means = np.array([[0, 0, 0], [0.2, 0.1, 0.3], [-0.1, 0.2, -0.2]])
    return Gaussians.from_rgb(means, quats, scales, np.array([0.9, 0.5, 0.7]), np.eye(3))


@pytest.fixture
def every_frame(monkeypatch):
    """A run writes the state from which it can go on after every frame."""
    monkeypatch.setattr("phy124.pipeline.recording.COST", 1e9)


@pytest.fixture
def in_this_process(monkeypatch):
    """Code that would run in a separate process runs in this one: starting another takes longer
    than most of these tests."""
    run = "phy124.runtime.isolated.run"
    monkeypatch.setattr(run, lambda function, *options, **_: function(*options))


@pytest.fixture
def domain(monkeypatch) -> Iterator[int]:
    """The DDS domain of a test, on this machine only."""
    for name in ("CYCLONEDDS_URI", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"):
        monkeypatch.delenv(name, raising=False)
    with reserved_domain() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield number


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """The folder for temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.fixture
def ros(monkeypatch):
    """A double of rclpy; what it has seen."""
    from support import ros_double

    sigterm = signal.getsignal(signal.SIGTERM)
    yield ros_double.install(monkeypatch)
    signal.signal(signal.SIGTERM, sigterm)
