"""The installed package records a clip and lists the contents of the bag; needs no ROS 2."""

import subprocess
import sys

import numpy as np

from phy124.io.clip import Clip

FRAMES, POINTS = 3, 20


def save_clip(folder):
    """Save a small clip that was made without a simulation; return its path."""
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(FRAMES, POINTS, 4))
    Clip(
        means=rng.normal(size=(FRAMES, POINTS, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=2, keepdims=True)).astype(np.float32),
        scales=np.full((FRAMES, POINTS, 3), 0.05, np.float32),
        opacities=np.ones(POINTS, np.float32),
        sh=np.zeros((POINTS, 1, 3), np.float32),
        times=np.arange(FRAMES) / 24,
    ).save(folder / "clip.safetensors")
    return folder / "clip.safetensors"


def run(*arguments):
    """Return the output of a command of the installed package."""
    command = [sys.executable, "-m", "phy124_bridge", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_recorded_bag_holds_all_frames(tmp_path):
    run("record", save_clip(tmp_path), tmp_path / "bag")
    lines = run("info", tmp_path / "bag").splitlines()
    assert f"/phy124/points: {FRAMES} messages" in lines
    assert lines[-1] == "state: complete"


def test_doctor_lists_the_outlets():
    assert "mcap: ready" in run("doctor")
