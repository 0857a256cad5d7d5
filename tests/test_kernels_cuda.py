"""Device code compiles for a GPU on a machine without one, and holds what it should."""

import importlib
import re

import pytest
import warp as wp

from phy124.kernels import collide, forces, grid, measure, timestep, transfer, work
from phy124.kernels.lattice import impulses
from phy124.materials import FixedCorotated, NeoHookean, Sand
from phy124.mpm import free
from phy124.pipeline.warming import HOST
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation, prepare
from support import device_kernels
from support.cubin import ARCHITECTURES, usage
from support.shapes import ball

CPU_ONLY = ("_simd", "_serial", "barrier")
LAWS = [
    NeoHookean(),
    pytest.param(NeoHookean(damping=1.0), marks=pytest.mark.slow),
    pytest.param(Sand(), marks=pytest.mark.slow),
    pytest.param(FixedCorotated(), marks=pytest.mark.slow),
]
"""The first compiles in half the time of the others."""


def ptx(kernel, folder) -> str:
    """The module of a kernel, compiled ahead for Hopper."""
    wp.compile_aot_module(kernel.module, arch=90, module_dir=str(folder), use_ptx=True)
    (path,) = folder.glob("*.ptx")
    return path.read_text()


@pytest.mark.parametrize("material", LAWS, ids=lambda material: material.device_law.name)
def test_transfers_compile_for_cuda(material, tmp_path):
    law = material.device_law
    (tmp_path / "p2g").mkdir()
    (tmp_path / "g2p").mkdir()
    scatter = ptx(transfer.make_p2g(law, wp.float32, "plain"), tmp_path / "p2g")
    gather = ptx(transfer.make_g2p(law, wp.float32, "plain"), tmp_path / "g2p")
    assert ".visible .entry" in gather
    # 27 nodes, the four numbers of each read at once.
    assert len(re.findall(r"ld\S*\.v4\.f32", gather)) == 27
    # NaN would be converted to node 0; the larger of it and -1e9 is -1e9, which is in no window.
    for text in (scatter, gather):
        assert len(re.findall(r"max\.f32\s.*0fCE6E6B28", text)) == 3
    assert ".target sm_90" in scatter
    # 27 nodes, the four numbers of each added at once and without return values.
    assert len(re.findall(r"red\.global\.add\.v4\.f32", scatter)) == 27
    assert not re.findall(r"atom\S*add", scatter)


@pytest.mark.slow
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_free_bodies_compile_for_cuda(real, tmp_path):
    for place, kernel in enumerate(free.kernels_of(["sphere", "box", "capsule"], real)):
        (tmp_path / str(place)).mkdir()
        assert ".visible .entry" in ptx(kernel, tmp_path / str(place))


@pytest.mark.slow
def test_grid_and_pushes_compile_for_cuda(tmp_path):
    kernels = {
        "update": grid.make_update(wp.float32),
        "merge": grid.make_merge(wp.float32),
        "measure": measure.make_measure(NeoHookean().device_law, wp.float32),
        "timestep": timestep.make_timestep(wp.float32),
        "accelerate": forces.make_accelerate(wp.float32, True),
        "contact": collide.make_contact("box", "separate", wp.float32),
    }
    for name, kernel in kernels.items():
        (tmp_path / name).mkdir()
        assert ".visible .entry" in ptx(kernel, tmp_path / name)


@pytest.mark.parametrize(
    ("kernel", "numbers"),
    [
        (measure.make_measure(NeoHookean().device_law, wp.float32), 9),
        (work.make_wall_sums(wp.float32), 2 * work.EXCHANGE),
        # Only the work is summed over a warp, because its threads may have different clamps.
        (impulses.make_pass_on(wp.float32), 2),
    ],
    ids=["measure", "wall sums", "clamps"],
)
def test_a_warp_reduces_before_it_writes(kernel, numbers, tmp_path):
    """Five exchanges for each 32-bit number, so that one of 32 threads writes."""
    assert len(re.findall(r"shfl\.sync\.bfly", ptx(kernel, tmp_path))) == 5 * numbers


FAST = ("sand",)
"""Laws whose measurement is compiled by default."""


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(item, id=name, marks=() if name in FAST else pytest.mark.slow)
        for name, item in device_kernels.laws().items()
    ],
)
def test_the_substep_is_measured_without_float64(law, tmp_path):
    """Most cards compute a 32nd or 64th as many float64 as float32."""
    text = ptx(measure.make_measure(law, wp.float32), tmp_path)
    assert re.findall(r"fma\S*\.f32", text)
    body = text[text.index(".visible .entry") :]
    assert not re.findall(r"\.f64", body)


@pytest.mark.slow
def test_every_module_of_the_presets_compiles_for_cuda(tmp_path):
    """All kernels that run on the CPU here compile, except vectorised forms and set-ups."""
    host = {kernel.module.name for kernel in HOST}
    for name in preset_names():
        scene = Scene.named(name).replaced({"accuracy": {"cells": 8}, "time.frames": 3})
        Simulation(prepare(ball(300), scene)).run()
    for name in ("project", "blend", "stage", "shadow"):
        importlib.import_module(f"phy124.kernels.splat.{name}")
    modules = [
        module
        for name, module in wp._src.context.user_modules.items()
        if name.startswith("phy124")
        and name not in host
        and module.kernels
        and not any(part in name for part in CPU_ONLY)
    ]
    for module in modules:
        (tmp_path / module.name).mkdir()
        wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path / module.name), use_ptx=True)
        assert list((tmp_path / module.name).glob("*.ptx")), module.name
    assert len(modules) >= 15


MOST_REGISTERS = 128
"""Above, fewer than 512 threads share the 65,536 registers of a multiprocessor."""


@pytest.mark.slow
@pytest.mark.parametrize("law", device_kernels.laws())
def test_main_kernels_have_room_for_their_registers(law):
    kernels = device_kernels.main(device_kernels.laws()[law]).values()
    for kernel in (*kernels, grid.make_update(wp.float32)):
        for architecture in ARCHITECTURES:
            for name, taken in usage(kernel, architecture).items():
                assert taken.registers <= MOST_REGISTERS, (name, architecture, taken)
                assert taken.spilled == 0, (name, architecture, taken)


@pytest.mark.slow
def test_spills_are_seen():
    """A kernel that keeps more numbers than there are registers."""

    @wp.kernel(module="phy124_spills", enable_backward=False)
    def greedy(values: wp.array(dtype=float), values_out: wp.array(dtype=float)):
        i = wp.tid()
        a = wp.matrix(shape=(16, 16), dtype=float)
        for row in range(16):
            for column in range(16):
                a[row, column] = values[256 * i + 16 * row + column]
        wp.atomic_add(values_out, 0, 1.0)
        b = a * wp.transpose(a)
        for row in range(16):
            for column in range(16):
                values_out[256 * i + 16 * row + column] = b[row, column]

    (taken,) = usage(greedy, 90).values()
    assert taken.registers > MOST_REGISTERS and taken.spilled > 0
    (modest,) = usage(grid.make_update(wp.float32), 90).values()
    assert 8 <= modest.registers < 64 and modest.stack == modest.spilled == 0
