"""Limits of control groups: their files as versions 1 and 2 write them, and real groups."""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import pytest

from phy124.io.ply import write_ply
from phy124.runtime.cgroups import cpu_quota, memory_left
from support.processes import limited, within
from support.shapes import ball

MB = 1_000_000
V2 = "35 31 0:41 {top} /sys/fs/cgroup rw,relatime shared:9 - cgroup2 cgroup2 rw,nsdelegate"
V1 = "35 31 0:32 {top} /sys/fs/cgroup/{name} rw,relatime - cgroup cgroup rw,{name}"
NO_LIMIT = 9223372036854771712


def system(root: Path, groups: str, mounts: list[str], files: Mapping[str, object]) -> Path:
    """A folder with the files of a system."""
    written = {
        "proc/self/cgroup": f"{groups}\n",
        "proc/self/mountinfo": "\n".join(["1 0 8:1 / / rw - ext4 x rw", *mounts, ""]),
        **{f"sys/fs/cgroup/{name}": f"{value}\n" for name, value in files.items()},
    }
    for name, text in written.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


def test_version_2_is_read_from_a_container(tmp_path):
    root = system(
        tmp_path,
        "0::/",
        [V2.format(top="/")],
        {
            "memory.max": 900 * MB,
            "memory.current": 500 * MB,
            "cpu.max": "150000 100000",
            "memory.stat": f"anon {100 * MB}\ninactive_file {40 * MB}\nactive_file {10 * MB}",
        },
    )
    assert memory_left(root) == 450 * MB
    assert cpu_quota(root) == 1.5


def test_version_2_without_limits_has_none(tmp_path):
    root = system(
        tmp_path,
        "0::/user.slice",
        [V2.format(top="/")],
        {
            "user.slice/memory.max": "max",
            "user.slice/memory.current": 5 * MB,
            "user.slice/cpu.max": "max 100000",
            "cgroup.procs": 1,
        },
    )
    assert memory_left(root) == cpu_quota(root) == math.inf


def test_a_group_above_may_be_the_narrowest(tmp_path):
    root = system(
        tmp_path,
        "0::/job/step",
        [V2.format(top="/")],
        {
            "job/memory.max": 300 * MB,
            "job/memory.current": 200 * MB,
            "job/cpu.max": "400000 100000",
            "job/step/memory.max": 900 * MB,
            "job/step/memory.current": 200 * MB,
            "job/step/cpu.max": "800000 100000",
        },
    )
    assert (memory_left(root), cpu_quota(root)) == (100 * MB, 4.0)


def test_version_1_is_read_beside_an_empty_version_2(tmp_path):
    mounts = [V1.format(top="/", name=name) for name in ("memory", "cpu,cpuacct")]
    unified = V2.format(top="/").replace("/sys/fs/cgroup", "/sys/fs/cgroup/unified")
    root = system(
        tmp_path,
        "4:memory:/a\n2:cpu,cpuacct:/a\n0::/",
        [*mounts, unified],
        {
            "memory/a/memory.limit_in_bytes": 900 * MB,
            "memory/a/memory.usage_in_bytes": 600 * MB,
            "memory/a/memory.stat": f"inactive_file {MB}\ntotal_inactive_file {100 * MB}",
            "memory/memory.limit_in_bytes": NO_LIMIT,
            "memory/memory.usage_in_bytes": 999 * MB,
            "cpu,cpuacct/a/cpu.cfs_quota_us": 50000,
            "cpu,cpuacct/a/cpu.cfs_period_us": 100000,
            "cpu,cpuacct/cpu.cfs_quota_us": -1,
            "cpu,cpuacct/cpu.cfs_period_us": 100000,
            "unified/cgroup.procs": 1,
        },
    )
    assert (memory_left(root), cpu_quota(root)) == (400 * MB, 0.5)


@pytest.mark.parametrize("top", ["/docker/c0ffee", "/"], ids=["bound", "name of the host"])
def test_a_container_with_its_host_s_names_is_understood(tmp_path, top):
    root = system(
        tmp_path,
        "4:memory:/docker/c0ffee",
        [V1.format(top=top, name="memory")],
        {"memory/memory.limit_in_bytes": 64 * MB, "memory/memory.usage_in_bytes": 4 * MB},
    )
    assert memory_left(root) == 60 * MB


def test_a_group_that_has_used_too_much_leaves_nothing(tmp_path):
    files = {"memory.max": 50 * MB, "memory.current": 60 * MB}
    assert memory_left(system(tmp_path, "0::/", [V2.format(top="/")], files)) == 0


def test_a_system_without_groups_has_no_limits(tmp_path):
    assert memory_left(tmp_path) == cpu_quota(tmp_path) == math.inf


def test_a_real_group_limits_the_cores():
    say = "from phy124.runtime.cores import cores; print(cores())"
    quota = {"cpu.max": "100000 100000", "cpu.cfs_quota_us": 100000}
    with limited("cpu", quota) as group:
        assert within(group, "-c", say).stdout == "1\n"


def test_a_run_too_large_for_its_group_is_refused(tmp_path):
    """The run is refused before work, as on a machine with so little memory, by the number of
    cells."""
    write_ply(tmp_path / "ball.ply", ball(2000))
    command = ["-m", "phy124", "simulate", tmp_path / "ball.ply", "--scene", "drop", "--json"]
    options = [
        "--set",
        'accuracy={cells=72,solver="mpm"}',
        "--frames",
        "3",
        "--set",
        "time.budget=1e8",
    ]
    limits = {"memory.max": 500 * MB, "memory.limit_in_bytes": 500 * MB}
    with limited("memory", limits) as group:
        done = within(group, *command, *options, "--device", "cpu", "--out", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    sentence = json.loads(done.stdout)["error"]
    assert sentence.startswith("accuracy.cells = 72: the run is estimated to need 0.")
    assert "coarser accuracy" in sentence and not (tmp_path / "out").exists()
