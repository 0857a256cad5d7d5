"""Matrices of particles written by 32 threads together: what a GPU would do, by threads here."""

import re
import shutil
from pathlib import Path

import pytest
import warp as wp

from phy124.kernels import transfer
from phy124.kernels.native import code
from phy124.materials import NeoHookean
from support.processes import run_program

STORE = code("reduction:store")
WARP = Path(__file__).parent / "races" / "warp_threads.cpp"


def built(folder: Path, code: str) -> Path:
    """The program that runs this code; it ends with status 66 if two threads race."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("g++ is not installed")
    (folder / "store.inc").write_text(code)
    program = folder / "warp"
    order = [compiler, "-std=c++20", "-O1", "-g", "-fsanitize=thread", f"-I{folder}", str(WARP)]
    done = run_program([*order, "-o", str(program)])
    if "tsan" in done.stderr:
        pytest.skip("g++ has no thread sanitizer")
    assert done.returncode == 0, done.stderr
    return program


def run(program: Path, particles: int, *, reversed_: bool = False) -> tuple[int, int, int]:
    """Exit status, wrong numbers, and matrices that their own thread has written."""
    order = [str(program), str(particles), str(int(reversed_))]
    done = run_program(order)
    wrong, alone = map(int, done.stdout.split())
    return done.returncode, wrong, alone


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    return built(tmp_path_factory.mktemp("store"), STORE)


@pytest.mark.parametrize(
    ("particles", "alone"),
    [
        (32, 0),
        pytest.param(256, 0, marks=pytest.mark.slow),
        (300, 2 * 12),
        (31, 2 * 31),
        pytest.param(544, 0, marks=pytest.mark.slow),
    ],
)
def test_whole_warps_write_together_and_the_rest_alone(program, particles, alone):
    assert run(program, particles) == (0, 0, alone)


def test_particles_that_are_no_neighbours_are_written_alone(program):
    assert run(program, 96, reversed_=True) == (0, 0, 2 * 96)


def barriers() -> list[int]:
    return [match.start() for match in re.finditer(r"__syncwarp\(\);", STORE)]


@pytest.mark.slow
@pytest.mark.parametrize("which", range(2))
def test_a_missing_barrier_is_noticed(tmp_path, which):
    start = barriers()[which]
    code = STORE[:start] + STORE[start + len("__syncwarp();") :]
    status, wrong, _ = run(built(tmp_path, code), 256)
    assert status == 66 or wrong


def test_both_barriers_were_taken_out():
    assert len(barriers()) == 2


def test_a_gpu_writes_them_from_shared_memory(tmp_path):
    """C, F, and F in all if a run has it: nine numbers each into shared memory, and from there."""
    kernel = transfer.make_g2p(NeoHookean().device_law, wp.float32, "plain")
    (path,) = wp.compile_aot_module(kernel.module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    text = Path(path).read_text()
    assert len(re.findall(r"ld\.shared\.f32", text)) == 3 * 9
    assert len(re.findall(r"st\.shared\.f32", text)) == 3 * 9
