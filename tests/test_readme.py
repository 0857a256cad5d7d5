"""What the README says is so: its code runs, its files exist, its presets are there."""

import re
from pathlib import Path

from phy124.io.ply import write_ply
from support.shapes import ball

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_python_example_runs(tmp_path, monkeypatch, capsys):
    code = re.search(r"```python\n(.*?)```", README, re.S)
    assert code
    (tmp_path / "out/duck-press").mkdir(parents=True)
    write_ply(tmp_path / "out/duck-press/gaussians.ply", ball(500))
    monkeypatch.chdir(tmp_path)
    quick = code[1].replace('Scene.named("press")', 'Scene.named("press").replaced(QUICK)')
    exec(quick, {"QUICK": {"accuracy": {"cells": 8}, "time.frames": 2}})
    printed = capsys.readouterr().out.strip().splitlines()
    assert len(printed) == 2, "one line a frame, and nothing of Warp's"


def test_every_file_it_names_exists():
    table = README[README.index("## Where things are") :]
    names = re.findall(r"`([^`]+)`", table)
    assert len(names) > 30
    for name in names:
        assert (ROOT / name).exists() or (ROOT / "phy124" / name).exists(), name
