"""Sweeps: predicted cost, workers, and memory of many clips."""

import heapq
import tracemalloc
from pathlib import Path

import pytest

from phy124.__main__ import main
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.studies.sweep import Item, Plan, cost, forecast_sweep, manifest
from phy124.studies.sweep.cost import Expected
from phy124.studies.sweep.keys import Seen
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.storage import Storage
from phy124.studies.sweep.work import needs_of, write_row
from support.sweeps import declared, write_balls

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.fixture(scope="module")
def balls(tmp_path_factory) -> Path:
    return write_balls(tmp_path_factory.mktemp("balls"))


def test_cost_is_predicted_from_a_few_clips(balls):
    answer = forecast_sweep(
        Plan(
            declared(
                balls, set={**declared(balls).model_dump(by_alias=True)["set"], "material.E": [1e4]}
            )
        ),
        RunContext(),
    )
    assert answer.clips == answer.tried == 2 and answer.seconds[0] > 0
    assert "2 clips, each with" in answer.sentence(workers=4) and answer.bytes == 3 * 70 * 40


@pytest.mark.parametrize(
    "asked, said", [("0", "1 worker;"), ("1", "1 worker;"), ("3", "3 workers;")]
)
def test_a_dry_run_counts_the_workers(balls, tmp_path, monkeypatch, capsys, asked, said):
    """With 0 workers, one process does the work."""
    file = tmp_path / "sweep.toml"
    file.write_text(f'pictures = "{balls}/*.ply"\nscene = "drop"\n')
    cost = Expected(2, 2, (3600.0, 0.0), 1e6)
    monkeypatch.setattr("phy124.commands.sweep.forecast_sweep", lambda *_: cost)
    assert main(["sweep", str(file), "--dry-run", "--workers", asked]) == 0
    hours = 2 / max(int(asked), 1)
    assert f"{hours:.2f} h with {said}" in capsys.readouterr().out


def test_a_driver_of_many_clips_remembers_little_of_each():
    """Eight bytes per key for good, four times as much while keys are put in order."""
    tracemalloc.start()
    seen = Seen(f"{number * 2**40:024x}" for number in range(20_000))
    now, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert now < 10 * 20_000 + 500_000 and most < 40 * 20_000 + 500_000
    assert f"{7 * 2**40:024x}" in seen and f"{19_999 * 2**40:024x}" in seen
    assert f"{7 * 2**40 - 1:024x}" not in seen


def test_many_rows_become_one_table_whatever_their_columns(tmp_path, monkeypatch):
    monkeypatch.setattr(manifest, "BATCH", 3)
    storage, soft = Storage(str(tmp_path)), {4: "soft", 5: "soft"}
    clips = [
        (f"{index}" * 24, Item(index, "a", "relief", {"E": soft.get(index, 10.0 * index)}))
        for index in range(8)
    ]
    for key, clip in clips:
        status = "failed" if clip.index == 2 else "done"
        write_row(storage, key, clip, {"status": status})
    assert manifest.write_manifest(storage, clips) == 8
    assert [row["status"] for row in read_manifest(storage)].count("failed") == 1
    write_row(storage, *clips[2], {"status": "done"})
    assert manifest.write_manifest(storage, [*clips, clips[0]]) == 8
    rows = read_manifest(storage)
    assert {row["status"] for row in rows} == {"done"}
    assert [row["index"] for row in rows] == list(range(8))
    assert rows[4]["set.E"] == "soft" and float(rows[1]["set.E"]) == 10
    assert sorted(manifest.keys_in(storage)) == [key for key, _ in clips]


def test_tasks_reserve_what_their_scenes_need():
    scene = Scene.named("press")
    small = needs_of(scene.replaced({"accuracy": "draft"}), None, None)
    large = needs_of(scene.replaced({"accuracy": "fine"}), None, None)
    assert 4e8 < small.memory < large.memory and small.gpus == large.gpus == 0
    shares = [needs_of(scene, None, memory).gpus for memory in (1e8, 2.5e9, 80e9)]
    assert shares[0] == 1 > shares[1] > shares[2] == 1 / 8
    assert all(float(1 / share).is_integer() for share in shares)


@pytest.mark.parametrize("workers", [1, 2, 8])
def test_remaining_time_is_right_within_a_fifth(balls, workers):
    """Clips of a queue, the last ones ten times as long as the first."""
    spread = {"first": 1e4, "last": 1e6, "count": 100, "spacing": "log"}
    axes = {"material.E": spread, "accuracy.cells": 24}
    plan = Plan(declared(balls, pictures=str(balls / "a.ply"), set=axes))
    costs = [0.4 + 3 * cost.work_of(plan.scene_of(item), films=False) for item in plan]
    free, ends = [0.0] * workers, []
    for index, seconds in enumerate(costs):
        heapq.heapreplace(free, end := free[0] + seconds)
        ends.append((end, index))
    now = 0.0
    answer = cost.Remaining(plan, range(100), clock=lambda: now)
    for count, (now, index) in enumerate(sorted(ends), 1):
        answer.note_finished({"index": index, "written": now, "seconds": {"clip": costs[index]}})
        if count in (25, 50, 75):
            left = max(free) - now
            assert answer.left(100 - count) == pytest.approx(left, rel=0.2)
