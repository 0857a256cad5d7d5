"""Sweeps on Ray: workers, nodes and the driver die, and the clips are those of a quiet run.

And on an S3 server of this machine, if its packages are there.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from phy124.io.ply import write_ply
from phy124.studies.sweep import Dataset, Plan, Sweep, run
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import Needs, Order
from support.processes import clips_of, killer, made
from support.shapes import ball

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
CLIPS = 24


@pytest.fixture(scope="module")
def sweep(tmp_path_factory) -> Sweep:
    """Some clips of a second each."""
    pytest.importorskip("ray", reason="ray is not installed")
    folder = tmp_path_factory.mktemp("balls")
    for name, count in (("a", 1500), ("b", 1400)):
        write_ply(folder / f"{name}.ply", ball(count))
    spread = {"first": 1e4, "last": 1e5, "count": CLIPS // 2, "spacing": "log"}
    return Sweep.from_data(
        {
            "pictures": str(folder / "*.ply"),
            "scene": "drop",
            "set": {"accuracy.cells": 12, "time.frames": 12, "material.E": spread},
        }
    )


@pytest.fixture(scope="module")
def quiet(sweep, tmp_path_factory) -> dict[str, bytes]:
    """The clips, made one after the other in this process."""
    out = tmp_path_factory.mktemp("quiet")
    assert run(Plan(sweep), str(out), workers=0).ended == {"done": CLIPS}
    return clips_of(out)


def driver(sweep: Sweep, folder: Path, *options: str) -> subprocess.Popen:
    """The command line in a process of its own."""
    declared = json.loads(sweep.model_dump_json(by_alias=True))
    text = Path(folder / "sweep.toml")
    import tomli_w

    plain = {k: v for k, v in declared.items() if v is not None}
    text.write_text(tomli_w.dumps(plain))
    command = [sys.executable, "-m", "phy124", "sweep", str(text), *options]
    return subprocess.Popen([*command, "--out", str(folder / "out")], start_new_session=True)


def wait_for(condition, seconds: float = 600) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.1)


def test_two_workers_make_what_one_process_makes(sweep, quiet, tmp_path):
    counts = run(Plan(sweep), str(tmp_path), workers=2)
    assert counts.ended == {"done": CLIPS} and clips_of(tmp_path) == quiet


def test_workers_that_are_killed_change_nothing(sweep, quiet, tmp_path, capfd):
    with killer(tmp_path, every=2.0) as killed:
        counts = run(Plan(sweep), str(tmp_path), workers=2)
    assert len(killed) >= 2 and counts.ended == {"done": CLIPS}
    assert clips_of(tmp_path) == quiet
    assert "raylet" not in capfd.readouterr().out, "results may go there as JSON"


def test_several_tasks_share_a_gpu(sweep):
    """A GPU that Ray believes in: each task gets its part of it, and its memory."""
    import ray

    from phy124.studies.sweep.on_ray import _Tasks

    ray.init(num_cpus=2, num_gpus=1, include_dashboard=False, log_to_driver=False)
    try:
        tasks = _Tasks(ray, beat=lambda: None)
        tasks.make = ray.remote(num_cpus=1)(lambda order: None)
        tasks.move = ray.remote(num_cpus=1)(
            lambda order, source: ray.get_runtime_context().get_assigned_resources()
        )
        some = Order("k", 0, "a.ply", "relief", {}, {}, None, False, "", Needs(1 << 28, 0.25))
        seen = list(tasks.rows([some] * 3))
    finally:
        ray.shutdown()
    assert [(task["GPU"], task["memory"]) for task in seen] == [(0.25, 1 << 28)] * 3


def test_a_killed_driver_goes_on_where_it_stopped(sweep, quiet, tmp_path):
    process = driver(sweep, tmp_path, "--workers", "2")
    wait_for(lambda: made(tmp_path / "out") >= 4)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    left = made(tmp_path / "out")
    counts = run(Plan(sweep), str(tmp_path / "out"), workers=2)
    assert counts.here >= left >= 4 and counts.here + counts.ended["done"] == CLIPS
    assert clips_of(tmp_path / "out") == quiet


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_and_leaves_a_manifest(sweep, quiet, tmp_path, number):
    process = driver(sweep, tmp_path, "--workers", "2")
    wait_for(lambda: made(tmp_path / "out") >= 2)
    process.send_signal(number)
    assert process.wait(timeout=120) == 130
    rows = read_manifest(Storage(str(tmp_path / "out")))
    assert 2 <= len(rows) < CLIPS
    left = clips_of(tmp_path / "out").items()
    saved = {(name, data) for name, data in left if Path(name).name.startswith("pause")}
    assert set(left) - saved <= set(quiet.items()), "only clips and saved states are left"


def test_a_node_that_is_lost_midway_and_the_head_of_the_cluster(sweep, quiet, tmp_path):
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    node = cluster.add_node(num_cpus=1)
    try:
        process = driver(sweep, tmp_path, "--ray", cluster.address)
        wait_for(lambda: made(tmp_path / "out") >= 4)
        cluster.remove_node(node, allow_graceful=False)
        wait_for(lambda: made(tmp_path / "out") >= 8)
    finally:
        cluster.shutdown()
    # The driver of a cluster without a head gives up by itself.
    assert process.wait(timeout=300) != 0
    assert 8 <= made(tmp_path / "out") < CLIPS
    counts = run(Plan(sweep), str(tmp_path / "out"), workers=2)
    assert counts.here + counts.ended["done"] == CLIPS
    assert clips_of(tmp_path / "out") == quiet


def test_an_object_store_works_as_a_folder_does(sweep, quiet, tmp_path, monkeypatch):
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server = pytest.importorskip("moto.server", reason="moto is not installed")
    running = server.ThreadedMotoServer(port=0)
    running.start()
    try:
        host, port = running.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        monkeypatch.setenv("AWS_ACCESS_KEY_ID", "key")
        monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        import s3fs

        store = s3fs.S3FileSystem()
        store.mkdir("bucket")
        for name in "ab":
            store.put(str(Path(sweep.pictures[0]).parent / f"{name}.ply"), f"bucket/in/{name}.ply")
        there = sweep.model_copy(update={"pictures": ("s3://bucket/in/*.ply",)})
        counts = run(Plan(there), "s3://bucket/out", workers=2)
        assert counts.ended == {"done": CLIPS}
        data = Dataset("s3://bucket/out")
        for number in (0, CLIPS - 1):
            name = f"{data.rows[number]['folder']}/clip.safetensors"
            assert Storage("s3://bucket/out").read(name) == quiet[name]
        assert run(Plan(there), "s3://bucket/out", workers=0).here == CLIPS
    finally:
        running.stop()
